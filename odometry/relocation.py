"""Matching of descriptors, for pairs too far apart to follow points: after a gap, in a sharp turn.

SIFT (Lowe, IJCV 2004) withstands the change of scale that a few seconds of driving bring. It takes several
times as long as following and is less accurate, so it is used only when following has failed.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry.stereo_matching import StereoMatchingConfig, match_right
from odometry.two_views import StereoTracks

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Pair = tuple[Image, Image]

_FEATURES = 3000  # SIFT features of each image
_RATIO = 0.8  # best over second best distance (Lowe, section 7.1)


def match_descriptors(first: Pair, second: Pair, matching: StereoMatchingConfig) -> StereoTracks:
    """Match points of two pairs of images (H, W) uint8, anywhere in them; there may be none."""
    sift = cv2.SIFT.create(_FEATURES)
    pixels, descriptors = zip(*(_describe(sift, pair[0]) for pair in (first, second)), strict=True)
    if min(len(pixels[0]), len(pixels[1])) < 2:
        return _tracks(*(np.zeros((0, 2)) for _ in range(4)))
    index = _mutual(*descriptors)
    left = [pixels[0][index[:, 0]], pixels[1][index[:, 1]]]
    right = [match_right(*pair, places, matching) for pair, places in zip((first, second), left, strict=True)]
    seen = np.isfinite(right[0][:, 0]) & np.isfinite(right[1][:, 0])
    return _tracks(left[0][seen], right[0][seen], left[1][seen], right[1][seen])


def _tracks(first_left: Array, first_right: Array, second_left: Array, second_right: Array) -> StereoTracks:
    """Points that belong to no track."""
    return StereoTracks(first_left, first_right, second_left, second_right, np.full(len(first_left), -1))


def _describe(sift: cv2.SIFT, image: Image) -> tuple[Array, NDArray[np.float32]]:
    keypoints, descriptors = sift.detectAndCompute(image, None)
    pixels = np.array([point.pt for point in keypoints], dtype=np.float64).reshape(-1, 2)
    return pixels, np.zeros((0, 128), np.float32) if descriptors is None else descriptors


def _mutual(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.int64]:
    """Pairs of indices (M, 2) of descriptors that are each other's nearest neighbour and pass the ratio test."""
    forward = cv2.BFMatcher(cv2.NORM_L2).knnMatch(first, second, k=2)
    back = {match.queryIdx: match.trainIdx for match in cv2.BFMatcher(cv2.NORM_L2).match(second, first)}
    chosen = [
        (best.queryIdx, best.trainIdx)
        for best, other in forward
        if best.distance < _RATIO * other.distance and back[best.trainIdx] == best.queryIdx
    ]
    return np.array(chosen, dtype=np.int64).reshape(-1, 2)
