"""Depth of any pixels of one camera's image, from an earlier image whose place is known: stereo by moving."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from odometry import se3
from odometry.lens import LensDistortion
from odometry.tracking import TrackingConfig, is_inside, track_points
from odometry.triangulation import triangulate

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_NEIGHBOURS = 3  # known points whose median depth is a pixel's first guess


@dataclass(frozen=True)
class MotionStereoConfig:
    """How pixels are found in an earlier image.

    Attributes:
        way: farthest that the earlier image may have been taken, in usual depths.
        turn_rad: largest turn since, radians.
        epipolar_px: farthest that a match may lie from where the motion allows it, pixels.
        tracking: how pixels are followed.

    """

    max_distance_ratio: float = 0.2
    max_rotation_rad: float = 0.35
    max_epipolar_error_px: float = 1.0
    tracking: TrackingConfig = field(default_factory=lambda: TrackingConfig(window_px=13))


@dataclass(frozen=True)
class PosedImage:
    """An image and where it was taken.

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
        """No depth at all."""
        return cls(np.full(count, np.nan), np.zeros(count))


def select_earlier_image(
    shots: list[PosedImage], now: PosedImage, median_depth: float, config: MotionStereoConfig
) -> PosedImage | None:
    """Find the shot farthest back that still shows much the same, or None."""
    best, farthest = None, 0.0
    for shot in shots:
        T = se3.inverse(shot.T_map_camera) @ now.T_map_camera
        way = float(np.linalg.norm(T[:3, 3]))
        if farthest < way <= config.max_distance_ratio * median_depth and se3.angle(T) <= config.max_rotation_rad:
            best, farthest = shot, way
    return best


def estimate_depths(
    shots: tuple[PosedImage, PosedImage],
    pixels: Array,
    known: tuple[Array, Array],
    lens: LensDistortion,
    config: MotionStereoConfig,
) -> Depths:
    """Depth of pixels (N, 2) of an image from an earlier one.

    Args:
        shots: the earlier image and the present one.
        pixels: where depth is wanted.
        known: pixels (M, 2), M > 0, with inverse depths (M,), to look first.
        lens: of the camera.
        config: how to look.

    """
    then, now = shots
    T_then_now = se3.inverse(then.T_map_camera) @ now.T_map_camera
    rays = lens.rays(pixels)
    count = min(_NEIGHBOURS, len(known[1]))
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
