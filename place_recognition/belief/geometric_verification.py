"""Whether two images can be two views of one rigid scene: an epipolar geometry that enough matches agree with.

Of uncalibrated cameras it is a fundamental matrix, of a calibrated one an essential matrix. Both find the same inliers
of true pairs of real images, within three of a hundred. Of 60 random matches at most 9 agree with an essential matrix,
and 9 to 11 with a fundamental one: a difference far from what decides. But false pairs cost six to ten times as much
with it, so the paradigms use the fundamental matrix.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Points = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class VerificationConfig:
    """What counts as proof.

    Attributes:
        least_inliers: matches that must agree, phi in the paper of the tracked words.
        distance: of an inlier from its epipolar line, pixels.
        iterations: samples drawn at most.
        confidence: probability of having drawn a clean sample when the search stops early.
    """

    least_inliers: int = 9
    distance: float = 2.0
    iterations: int = 1000
    confidence: float = 0.999


def epipolar_inliers(first: Floats, second: Floats, config: VerificationConfig) -> Mask | None:
    """Which of the matched pixels (N, 2) and (N, 2) agree with one fundamental matrix.

    Returns:
        Mask (N,), or None where fewer than the least number agree. The same for the same input.
    """
    return _agreeing(first, second, config, cv2.findFundamentalMat)


def calibrated_inliers(first: Floats, second: Floats, K: Points, config: VerificationConfig) -> Mask | None:
    """Which of the matched pixels (N, 2) and (N, 2) agree with one essential matrix.

    Args:
        first: pixels of one image, without distortion.
        second: of the other image of the same camera.
        K: (3, 3) its calibration matrix.
        config: distance is in pixels here too.

    Returns:
        As `epipolar_inliers`.

    Raises:
        ValueError: K is no calibration matrix.
    """
    K = np.asarray(K, np.float64)
    if K.shape != (3, 3) or not np.isfinite(K).all() or K[0, 0] <= 0 or K[1, 1] <= 0:
        raise ValueError(f"expected a calibration matrix (3, 3) with positive focal lengths, got {K.tolist()}")

    def find(one: Points, other: Points, parameters: Any) -> Any:
        return cv2.findEssentialMat(one, other, K, K, None, None, parameters)

    return _agreeing(first, second, config, find)


def _agreeing(first: Floats, second: Floats, config: VerificationConfig, find: Callable[..., Any]) -> Mask | None:
    """Mask (N,) of the inliers of the best matrix by MAGSAC (Barath et al., CVPR 2019), or None of too few."""
    if len(first) < max(config.least_inliers, 8):
        return None
    try:
        _, mask = find(np.asarray(first, np.float64), np.asarray(second, np.float64), _parameters(config))
    except cv2.error:  # degenerate matches leave OpenCV without a model, which some versions throw about
        return None
    if mask is None or np.count_nonzero(mask) < config.least_inliers:
        return None
    return np.asarray(mask.ravel(), np.bool_)


def _parameters(config: VerificationConfig) -> Any:
    parameters = cv2.UsacParams()
    parameters.score = cv2.SCORE_METHOD_MAGSAC
    parameters.loMethod = cv2.LOCAL_OPTIM_SIGMA
    parameters.threshold = config.distance
    parameters.maxIterations = config.iterations
    parameters.confidence = config.confidence
    parameters.randomGeneratorState = 0
    parameters.isParallel = False
    return parameters
