"""Guided tracking: optical flow predicts where a feature moves, and the detected feature there continues its track.

Guided feature selection of Tsintotas, Bampis, Gasteratos, 'Probabilistic Appearance-Based Place Recognition Through
Bag of Tracked Words', RA-L 4(2) 2019, section III-A: a track always sits on a detected feature, so it cannot drift.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import LocalFeatures

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class GuidedTrackingConfig:
    """Optical flow, and the conditions under which a feature continues a track.

    Attributes:
        max_distance_px: maximum distance of the detected feature from the position predicted by the flow.
        max_descriptor_distance: maximum distance of the feature's descriptor from the track's last one.
        window_px: side of the flow's window in the halved images.
        pyramid_levels: number of further halvings for the flow; each doubles the motion that can be followed.
        max_round_trip_px: maximum error of the flow forth and back.
    """

    max_distance_px: float = 5.0
    max_descriptor_distance: float = 0.6
    window_px: int = 13
    pyramid_levels: int = 2
    max_round_trip_px: float = 3.0


def optical_flow(
    previous: NDArray[np.uint8], image: NDArray[np.uint8], pixels: Floats, config: GuidedTrackingConfig
) -> Floats:
    """Track points (N, 2) of the previous image by optical flow.

    Args:
        previous: (H, W) uint8 image of the points.
        image: (H, W) uint8 image that follows; where its size is another one, all points are lost.
        pixels: (N, 2) positions in the previous image.
        config: settings of the flow.

    Returns:
        (N, 2) positions in the image; NaN for lost points.
    """
    if len(pixels) == 0 or previous.shape != image.shape:
        return np.full_like(pixels, np.nan)
    # A detected feature determines the position afterwards, so halved images suffice, in a third of the time.
    before, after, points = cv2.pyrDown(previous), cv2.pyrDown(image), pixels / 2
    size = (config.window_px, config.window_px)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        before, after, points, None, winSize=size, maxLevel=config.pyramid_levels
    )
    # The flow back starts from the result, so two levels suffice; a full pyramid costs five times as much.
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(
        after, before, moved, points.copy(), winSize=size, maxLevel=1, flags=cv2.OPTFLOW_USE_INITIAL_FLOW
    )
    error = 2 * np.linalg.norm(back - points, axis=1)
    kept = (found[:, 0] == 1) & (found_back[:, 0] == 1) & (error <= config.max_round_trip_px)
    moved[~kept] = np.nan
    return np.asarray(2 * moved, np.float32)


def select_guided(
    positions: Floats, descriptors: Floats, features: LocalFeatures, config: GuidedTrackingConfig
) -> NDArray[np.int64]:
    """Choose the feature (N,) that continues each track, -1 for none; no feature continues two tracks.

    Args:
        positions: (N, 2) pixels predicted by the flow, NaN for lost tracks.
        descriptors: (N, D) last descriptor of each track.
        features: features of the new image.
        config: limits of the distances.
    """
    limits = (config.max_distance_px, config.max_descriptor_distance)
    return _select(positions, descriptors, features.pixels, features.descriptors, limits)


@njit(cache=True)
def _select(
    positions: Floats, descriptors: Floats, pixels: Floats, candidates: Floats, limits: tuple[float, float]
) -> NDArray[np.int64]:
    chosen = np.full(len(positions), -1, np.int64)
    free = np.ones(len(pixels), np.bool_)
    for track in range(len(positions)):
        nearest, smallest = -1, limits[0] ** 2
        for k in range(len(pixels)):
            dx, dy = pixels[k, 0] - positions[track, 0], pixels[k, 1] - positions[track, 1]
            distance = dx * dx + dy * dy  # NaN is never less
            if free[k] and distance < smallest:
                nearest, smallest = k, distance
        if nearest >= 0:
            difference = descriptors[track] - candidates[nearest]
            if np.sum(difference * difference) < limits[1] ** 2:
                chosen[track] = nearest
                free[nearest] = False
    return chosen
