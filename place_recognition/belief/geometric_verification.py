"""Epipolar verification: do enough feature matches of two images agree with one fundamental matrix?

Why a fundamental and not an essential matrix: docs/decisions/candidate_verification.md.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

_TRIANGLE_STEPS = 5  # as many triangles for each match
_MIN_MATCHES = 8  # below, any matches agree with a fundamental matrix: it has 7 degrees of freedom


@dataclass(frozen=True)
class EpipolarConfig:
    """When matches agree with a fundamental matrix, and when enough of them do.

    Attributes:
        min_inliers: smallest number of inliers for which a pair counts as agreeing at all. Unrelated images reach
            eleven, and to fit as few matches takes the longest.
        max_distance_px: largest distance of an inlier from its epipolar line, pixels.
        max_iterations: largest number of samples drawn.
        confidence: probability of having drawn a sample without outliers at which the search stops early.
        seed: seed of the samples.
    """

    min_inliers: int = 12
    max_distance_px: float = 2.0
    max_iterations: int = 500
    confidence: float = 0.999
    seed: int = 0


def epipolar_inliers(first: Floats, second: Floats, config: EpipolarConfig) -> Mask | None:
    """Find the matches that agree with one fundamental matrix, by MAGSAC (Barath et al., CVPR 2019).

    Args:
        first: (N, 2) pixels of the matches in one image.
        second: (N, 2) pixels of the matches in the other image.
        config: inlier distance, number of inliers and iterations.

    Returns:
        Mask (N,) of the inliers, or None where fewer than `min_inliers` agree. The same for the same input.
    """
    if len(first) < max(config.min_inliers, _MIN_MATCHES):
        return None
    pixels = np.asarray(first, np.float64), np.asarray(second, np.float64)
    try:
        _, mask = cv2.findFundamentalMat(*pixels, _usac_parameters(config))
    except cv2.error:  # degenerate matches leave OpenCV without a model, and some versions raise an error then
        return None
    if mask is None or np.count_nonzero(mask) < config.min_inliers:
        return None
    return np.asarray(mask.ravel(), np.bool_)


def keeps_orientation(pixels: Floats) -> bool:
    """Decide whether most triangles of matches turn the same way in both images: a mirrored street is another street.

    No fundamental matrix can tell: mirroring one image turns a valid matrix into another valid one. Of true pairs up to
    30 m and 45 degrees apart, 99 in 100 keep 0.58 of the triangles or more; of mirrored ones 95 keep less than 0.25.

    Args:
        pixels: (N, 4) x and y of each match in one image, then in the other, in an order that follows no direction.
    """
    count, kept = len(pixels), 0
    for step in range(1, _TRIANGLE_STEPS + 1):
        side = np.roll(pixels, -step, axis=0) - pixels
        other = np.roll(pixels, -2 * step, axis=0) - pixels
        areas = side[:, 0::2] * other[:, 1::2] - side[:, 1::2] * other[:, 0::2]
        kept += int(np.count_nonzero(areas[:, 0] * areas[:, 1] >= 0))
    return 2 * kept >= _TRIANGLE_STEPS * count


def _usac_parameters(config: EpipolarConfig) -> Any:
    parameters = cv2.UsacParams()
    parameters.score = cv2.SCORE_METHOD_MAGSAC
    parameters.loMethod = cv2.LOCAL_OPTIM_SIGMA
    parameters.threshold = config.max_distance_px
    parameters.maxIterations = config.max_iterations
    parameters.confidence = config.confidence
    parameters.randomGeneratorState = config.seed  # with isParallel off: the same inliers in every run
    parameters.isParallel = False
    return parameters
