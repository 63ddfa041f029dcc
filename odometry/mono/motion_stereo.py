"""Motion stereo: depth of any pixels of one camera's image, from an earlier image of known pose."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from odometry import se3
from odometry.camera import triangulate
from odometry.distortion import LensDistortion
from odometry.klt_tracking import TrackingConfig, is_inside, track_points

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_NEIGHBORS = 3  # nearest points of known depth whose median is a pixel's first guess


@dataclass(frozen=True)
class MotionStereoConfig:
    """Choice of the earlier image and matching in it.

    Attributes:
        max_distance_ratio: largest distance of the earlier camera, in median depths.
        max_rotation_rad: largest rotation since the earlier image, radians.
        max_epipolar_error_px: largest distance of a match from its epipolar line, pixels.
        tracking: settings of the tracker that finds the pixels.
    """

    max_distance_ratio: float = 0.2
    max_rotation_rad: float = 0.35
    max_epipolar_error_px: float = 1.0
    tracking: TrackingConfig = field(default_factory=lambda: TrackingConfig(window_px=13))


@dataclass(frozen=True)
class PosedImage:
    """An image and its pose.

    Attributes:
        image: (H, W) uint8.
        T_map_camera: (4, 4).
    """

    image: Image
    T_map_camera: Array


@dataclass(frozen=True)
class Depths:
    """Depth of pixels.

    Attributes:
        inverse: (N,) inverse depth, NaN where it is not known.
        baseline: (N,) baseline of the stereo pair that would have seen it as well, in the map's unit.
    """

    inverse: Array
    baseline: Array

    @classmethod
    def unknown(cls, count: int) -> "Depths":
        """No depth for any pixel."""
        return cls(np.full(count, np.nan), np.zeros(count))


def select_earlier_image(
    images: list[PosedImage], now: PosedImage, median_depth: float, config: MotionStereoConfig
) -> PosedImage | None:
    """Find the image taken farthest away that still shows much the same, or None."""
    best, farthest = None, 0.0
    for candidate in images:
        T = se3.inverse(candidate.T_map_camera) @ now.T_map_camera
        distance = float(np.linalg.norm(T[:3, 3]))
        if farthest < distance <= config.max_distance_ratio * median_depth and se3.angle(T) <= config.max_rotation_rad:
            best, farthest = candidate, distance
    return best


def estimate_depths(
    images: tuple[PosedImage, PosedImage],
    pixels: Array,
    known: tuple[Array, Array],
    lens: LensDistortion,
    config: MotionStereoConfig,
) -> Depths:
    """Depth of pixels (N, 2) of an image from an earlier one.

    Args:
        images: the earlier image and the present one.
        pixels: (N, 2) whose depth is wanted.
        known: pixels (M, 2), M > 0, with known inverse depths (M,), for the first guess.
        lens: lens of the camera.
        config: settings.
    """
    then, now = images
    T_then_now = se3.inverse(then.T_map_camera) @ now.T_map_camera
    rays = lens.rays(pixels)
    count = min(_NEIGHBORS, len(known[1]))
    _, near = cKDTree(known[0]).query(pixels, k=count)
    guess = np.median(known[1][near.reshape(len(pixels), count)], axis=1)
    ahead = lens.pixels(rays @ T_then_now[:3, :3].T + guess[:, None] * T_then_now[:3, 3])
    visible = np.isfinite(ahead[:, 0]) & is_inside(np.nan_to_num(ahead), then.image)
    places = track_points((now.image, then.image), pixels, np.where(visible[:, None], ahead, pixels), config.tracking)
    found = np.flatnonzero(visible & np.isfinite(places[:, 0]))
    depths = Depths.unknown(len(pixels))
    inverse, strength = triangulate(rays[found], lens.rays(places[found]), T_then_now)
    expected = lens.pixels(rays[found] @ T_then_now[:3, :3].T + inverse[:, None] * T_then_now[:3, 3])
    good = (inverse > 0) & (np.linalg.norm(expected - places[found], axis=1) < config.max_epipolar_error_px)
    depths.inverse[found[good]] = inverse[good]
    depths.baseline[found[good]] = np.sqrt(strength[good])
    return depths
