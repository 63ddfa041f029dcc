"""The local map around a key frame, and 2D-3D matches of an image with it."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import StereoCamera
from place_recognition.belief.matching import mutual_matches
from place_recognition.image_processing.features import LocalFeatures
from slam.localisation.pose import MapMatches
from slam.localisation.saved_map import SavedMap

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LocalMapConfig:
    """Settings of the matching of an image with the landmarks of key frames.

    Attributes:
        ratio: maximum ratio of nearest to second nearest descriptor distance.
        sigma_px: standard deviation of a landmark's pixel and of its disparity, pixels.
    """

    ratio: float = 0.8
    sigma_px: float = 0.5


def match_local_map(
    saved: SavedMap, base: int, images: Iterable[int], features: LocalFeatures, config: LocalMapConfig
) -> MapMatches:
    """Match the features of an image with the landmarks of some key frames, in the frame of image `base`."""
    parts = [_match(saved, base, image, features, config) for image in images]
    return MapMatches(
        np.concatenate([part.pixels for part in parts]),
        np.concatenate([part.points_base for part in parts]),
        np.concatenate([part.noise_base for part in parts]),
        np.concatenate([part.features for part in parts]),
    )


def _match(saved: SavedMap, base: int, image: int, features: LocalFeatures, config: LocalMapConfig) -> MapMatches:
    seen = saved.landmarks(image)
    pairs = mutual_matches(features.descriptors, seen.descriptors.astype(np.float32), config.ratio)
    points_there = seen.points[pairs[:, 1]].astype(np.float64)
    T_base_there, unit = saved.pose_between(base, image), saved.units[image]
    R = T_base_there[:3, :3]
    noise = unit**2 * _point_noise(saved.camera, points_there, config.sigma_px)
    return MapMatches(
        features.pixels[pairs[:, 0]].astype(np.float64),
        se3.transform(T_base_there, unit * points_there),
        R @ noise @ R.T,
        pairs[:, 0].astype(np.int64),
    )


def _point_noise(camera: StereoCamera, points: Array, sigma_px: float) -> Array:
    """Covariance (K, 3, 3) of triangulated points (K, 3): of the ray across, of the disparity along it."""
    depth = points[:, 2]
    across = np.stack([depth / camera.fx * sigma_px, depth / camera.fy * sigma_px, np.zeros_like(depth)], axis=1)
    along = points * (depth / (camera.fx * camera.baseline) * sigma_px)[:, None]
    return np.einsum("ki,ij->kij", across**2, np.eye(3)) + along[:, :, None] * along[:, None, :]
