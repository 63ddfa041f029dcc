"""Conversion of OpenCV's key points to local features."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.features import LocalFeatures
from place_recognition.image_processing.spread import SpreadConfig, select_strongest

Floats = NDArray[np.float32]


def convert_keypoints(points: Sequence[cv2.KeyPoint], descriptors: Floats, sigmas_per_size: float) -> LocalFeatures:
    """Convert key points with their descriptors.

    Args:
        points: N key points.
        descriptors: (N, D) descriptors of unit length.
        sigmas_per_size: factor from the size of a key point to the sigma of a Gaussian.
    """
    pixels = np.array([point.pt for point in points], np.float32).reshape(-1, 2)
    sizes = np.array([point.size for point in points], np.float32)
    responses = np.array([point.response for point in points], np.float32)
    return LocalFeatures(pixels, np.float32(sigmas_per_size) * sizes, responses, descriptors)


def select_spread(features: LocalFeatures, shape: tuple[int, ...], count: int, config: SpreadConfig) -> LocalFeatures:
    """Keep at most `count` of the strongest features of an image (H, W), evenly spread, strongest first."""
    kept = select_strongest(features.pixels, features.responses, (shape[0], shape[1]), count, config)
    return LocalFeatures(
        features.pixels[kept], features.scales[kept], features.responses[kept], features.descriptors[kept]
    )
