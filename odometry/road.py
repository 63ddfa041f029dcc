"""How high the camera hangs above the road, by the points of a map: a ruler for what one camera cannot measure.

The road is the plane, nearly level, below the camera on which most points near the way ahead lie. Planes are
tried by samples of three points (Fischler and Bolles, CACM 1981) and weighed by their inliers.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_CLEARLY = 3.0  # times `flat` that a point must be below the road to be no error
_UNKNOWN = 10.0  # variance of the logarithm of a scale that nothing is known of
_WIDTH = 2.0  # standard deviations that a single look may be off and count in full


@dataclass(frozen=True)
class GroundPlaneConfig:
    """What a road looks like.

    Attributes:
        slope: least slope of a ray to the road, downwards, at the camera: farther away depths are unsure.
        aside: largest slope of a ray to the side.
        tilt_rad: largest angle between the road and the camera's horizontal plane.
        flat: farthest that a point may lie from the plane, as a share of the camera's height.
        points: fewest points on it.
        share: least share of the points that were looked at.
        below: largest share of them below it: under a road there is nothing.
        samples: planes that are tried.
        sigma: standard deviation of the logarithm of one height.
        repeats: key frames that see the same stretch of road, with the same error.
        drift: growth of the standard deviation of the logarithm of scale, per square root of a key frame.

    """

    min_slope: float = 0.08
    max_lateral_slope: float = 0.7
    max_tilt_rad: float = 0.07
    max_distance_ratio: float = 0.03
    min_points: int = 20
    min_inlier_ratio: float = 0.25
    max_ratio_below: float = 0.2
    samples: int = 200
    log_height_sigma: float = 0.08
    frames_per_stretch: float = 10.0
    log_scale_drift: float = 0.003


def estimate_camera_height(points_camera: Array, config: GroundPlaneConfig) -> float | None:
    """Height of the camera above the road in the unit of the points (N, 3) that it sees; None where none is seen."""
    x, y, z = points_camera.T
    road = points_camera[(z > 0) & (y > config.min_slope * z) & (np.abs(x) < config.max_lateral_slope * z)]
    if len(road) < config.min_points:
        return None
    planes = _planes(road, config)
    if not len(planes):
        return None
    distance = np.abs(1.0 - road @ planes.T)  # of each point from each plane, in heights
    inliers = distance < config.max_distance_ratio
    best = inliers[:, int(np.argmax(inliers.sum(axis=0)))]
    if best.sum() < max(config.min_points, config.min_inlier_ratio * len(road)):
        return None
    normal = np.linalg.lstsq(road[best], np.ones(int(best.sum())), rcond=None)[0]
    below = float(np.mean(road @ normal > 1.0 + _CLEARLY * config.max_distance_ratio))
    return float(1.0 / np.linalg.norm(normal)) if below <= config.max_ratio_below else None


def _planes(points: Array, config: GroundPlaneConfig) -> Array:
    """Planes (M, 3) through three points each, n with n . X = 1, below the camera and nearly level."""
    rng = np.random.default_rng(0)
    corners = points[rng.integers(0, len(points), (config.samples, 3))]
    regular = np.abs(np.linalg.det(corners)) > 1e-9
    planes = np.linalg.solve(corners[regular], np.ones((int(regular.sum()), 3, 1)))[:, :, 0]
    upright = planes[:, 1] / np.linalg.norm(planes, axis=1)
    return np.asarray(planes[upright > np.cos(config.max_tilt_rad)])


class ScaleCorrection(Protocol):
    """Says how a map should be resized."""

    def factor(self, points_camera: Array) -> float:
        """Factor by which the points (N, 3) that a camera sees, and their map, are to be made larger."""
        ...


class NullScaleCorrection:
    """Of a camera whose height is not known: the unit stays what it is."""

    def factor(self, points_camera: Array) -> float:
        """Leave everything as it is."""
        return 1.0


class GroundPlaneScale:
    """Of a camera whose height above the road is known.

    A filter of the logarithm of scale, in the manner of Kalman: the first road sets it, the next ones agree on it,
    and then it follows slowly, since single roads are neither flat nor level.
    """

    def __init__(self, height: float, config: GroundPlaneConfig) -> None:
        self._height, self._config = height, config
        self._variance = _UNKNOWN

    def factor(self, points_camera: Array) -> float:
        """Factor by which to make the map larger, after one more look at the road."""
        self._variance += self._config.log_scale_drift**2
        seen = estimate_camera_height(points_camera, self._config)
        if seen is None:
            return 1.0
        off = float(np.log(self._height / seen))
        limit = _WIDTH * float(np.sqrt(self._variance + self._config.log_height_sigma**2))
        gain = self._variance / (self._variance + self._config.frames_per_stretch * self._config.log_height_sigma**2)
        self._variance *= 1.0 - gain
        return float(np.exp(gain * np.clip(off, -limit, limit)))
