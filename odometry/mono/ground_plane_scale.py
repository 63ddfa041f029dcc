"""Metric scale of a monocular map from the camera's height above the ground plane.

The road is the plane, nearly level, below the camera on which most points ahead lie. Planes are
tried by samples of three points (RANSAC: Fischler and Bolles, CACM 1981). Formulas: docs/math.md, section
"Ground-plane scale".
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BELOW_ROAD = 3.0  # multiple of `max_distance_ratio` by which a point must be below the road to be no error
_INITIAL_VARIANCE = 10.0  # of the logarithm of an unknown scale
_CLIP_SIGMAS = 2.0  # standard deviations at which the deviation of a single measurement is clipped


@dataclass(frozen=True)
class GroundPlaneConfig:
    """How the ground plane is found and filtered.

    Attributes:
        min_slope: smallest downward slope of a ray to the road: farther away depths are uncertain.
        max_lateral_slope: largest slope of a ray to the side.
        max_tilt_rad: largest angle between the road and the camera's horizontal plane, radians.
        max_distance_ratio: largest distance of an inlier from the plane, as a share of the camera's height.
        min_points: smallest number of inliers.
        min_inlier_ratio: smallest share of inliers among the candidate points.
        max_ratio_below: largest share of candidate points below the plane: there is nothing under a road.
        samples: planes that are tried.
        log_height_sigma: standard deviation of the logarithm of one measured height.
        frames_per_stretch: reference frames that see the same stretch of road, with the same error.
        log_scale_drift: growth of the standard deviation of the logarithm of scale, per square root of a frame.
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
    frames_per_stretch: int = 10
    log_scale_drift: float = 0.003


def estimate_camera_height(points_camera: Array, config: GroundPlaneConfig) -> float | None:
    """Height of the camera above the road in the unit of its points (N, 3); None where no road is found."""
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
    below = float(np.mean(road @ normal > 1.0 + _BELOW_ROAD * config.max_distance_ratio))
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
    """Corrects the scale of a map by what its newest camera sees."""

    def update(self, points_camera: Array) -> float:
        """Take in points (N, 3) in the camera frame; return the factor by which to make the map larger."""
        ...

    def state(self) -> dict[str, Any]:
        """Everything that changes from reference frame to reference frame, for a checkpoint."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        ...


class NullScaleCorrection:
    """No correction, for a camera of unknown height: the unit stays as it is."""

    def update(self, points_camera: Array) -> float:
        """Leave the scale as it is."""
        return 1.0

    def state(self) -> dict[str, Any]:
        """Nothing changes."""
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        """Nothing changes."""


class GroundPlaneScale:
    """Correction by the known height of the camera above the road.

    A filter of the logarithm of scale, in the manner of Kalman: the first road sets it, the next ones agree on it,
    and then it follows slowly, since single roads are neither flat nor level.
    """

    def __init__(self, height_m: float, config: GroundPlaneConfig) -> None:
        self._height_m, self._config = height_m, config
        self._variance = _INITIAL_VARIANCE

    def update(self, points_camera: Array) -> float:
        """Take in points (N, 3) in the camera frame; return the factor by which to make the map larger."""
        self._variance += self._config.log_scale_drift**2
        seen = estimate_camera_height(points_camera, self._config)
        if seen is None:
            return 1.0
        off = float(np.log(self._height_m / seen))
        limit = _CLIP_SIGMAS * float(np.sqrt(self._variance + self._config.log_height_sigma**2))
        gain = self._variance / (self._variance + self._config.frames_per_stretch * self._config.log_height_sigma**2)
        self._variance *= 1.0 - gain
        return float(np.exp(gain * np.clip(off, -limit, limit)))

    def state(self) -> dict[str, Any]:
        """Variance of the filter, for a checkpoint."""
        return {"variance": self._variance}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._variance = state["variance"]
