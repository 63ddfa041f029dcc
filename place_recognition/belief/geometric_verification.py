"""Whether two images can be two views of one rigid scene: a fundamental matrix that enough matches agree with."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


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


def epipolar_inliers(first: Floats, second: Floats, config: VerificationConfig) -> NDArray[np.bool_] | None:
    """Which of the matched pixels (N, 2) and (N, 2) agree with one fundamental matrix.

    Returns:
        Mask (N,), or None where fewer than the least number agree. The same for the same input.
    """
    if len(first) < max(config.least_inliers, 8):
        return None
    mask = _search(np.asarray(first, np.float64), np.asarray(second, np.float64), config)
    if mask is None or np.count_nonzero(mask) < config.least_inliers:
        return None
    return mask


def _search(
    first: NDArray[np.float64], second: NDArray[np.float64], config: VerificationConfig
) -> NDArray[np.bool_] | None:
    """Mask (N,) of the inliers of the best matrix by MAGSAC (Barath et al., CVPR 2019), or None."""
    parameters = cv2.UsacParams()
    parameters.score = cv2.SCORE_METHOD_MAGSAC
    parameters.loMethod = cv2.LOCAL_OPTIM_SIGMA
    parameters.threshold = config.distance
    parameters.maxIterations = config.iterations
    parameters.confidence = config.confidence
    parameters.randomGeneratorState = 0
    parameters.isParallel = False
    try:
        _, mask = cv2.findFundamentalMat(first, second, parameters)
    except cv2.error:  # degenerate matches leave OpenCV without a model, which some versions throw about
        return None
    return None if mask is None else mask.ravel().astype(bool)
