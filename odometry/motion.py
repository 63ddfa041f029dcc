"""Result of an odometry: the camera's motion between two consecutive images, and the count of missing images."""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FIRST_VARIANCE = 1e-12  # rad², m²: the pose of the first image is exact by definition
# Standard deviation of the change of an unmeasured motion from one image to the next.
EXTRAPOLATION_SIGMA_RAD, EXTRAPOLATION_SIGMA_M = 0.02, 0.2
_MAX_INTERVALS = 15  # intervals whose median is the camera's
_DEFAULT_INTERVAL_S = 0.1  # that of most recordings


def extrapolation_covariance(sigma_rad: float, sigma_m: float, images: int) -> Array:
    """Covariance (6, 6) of a motion that was not measured, which grows with the time since the last measurement.

    Args:
        sigma_rad: standard deviation of the change of rotation from one image to the next, radians.
        sigma_m: standard deviation of the change of translation from one image to the next, metres.
        images: images since the last measurement.
    """
    deviation = np.repeat([sigma_rad, sigma_m], 3) * images
    return np.diag(deviation**2)


def _no_pixels() -> Array:
    return np.zeros((0, 2))


def _none() -> NDArray[np.bool_]:
    return np.zeros(0, dtype=bool)


@dataclass(frozen=True)
class Motion:
    """The camera's motion between two consecutive images.

    Attributes:
        T_previous_current: (4, 4) current camera in the previous one's frame, metres; first image: identity.
        covariance: (6, 6) of the right perturbation `T_previous_current @ exp(xi)`, rotation first (rad, m).
        predicted: True where the images did not allow a measurement and the motion is an extrapolation.
        reason: why it was predicted; empty when measured.
        pixels_previous, pixels_current: (N, 2) tracked points in the left images, pixels.
        inliers: (N,) bool, the tracks that agree with the motion.
        residual_px: root mean square reprojection error of the inliers, pixels; NaN when predicted.
    """

    T_previous_current: Array
    covariance: Array
    predicted: bool
    reason: str
    pixels_previous: Array = field(default_factory=_no_pixels)
    pixels_current: Array = field(default_factory=_no_pixels)
    inliers: NDArray[np.bool_] = field(default_factory=_none)
    residual_px: float = float("nan")


class FrameCounter:
    """Counts the images that a camera took between two that arrived; without time stamps no image is missing."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._intervals: deque[float] = deque(maxlen=_MAX_INTERVALS)

    @property
    def interval_s(self) -> float:
        """Median time between two images, seconds; 0.1 s while there are no time stamps."""
        return float(np.median(self._intervals)) if self._intervals else _DEFAULT_INTERVAL_S

    def frames_since_last(self, timestamp: float | None) -> int:
        """Number of images, at least 1, from the last one to the one taken at a time in seconds."""
        if timestamp is None or not np.isfinite(timestamp):
            return 1
        interval = 0.0 if self._last is None else timestamp - self._last
        self._last = timestamp
        if interval <= 0.0:
            return 1
        usual = self.interval_s if self._intervals else interval
        frames = max(round(interval / usual), 1)
        self._intervals.append(interval / frames)
        return frames

    def state(self) -> dict[str, Any]:
        """The latest time and intervals, for a checkpoint."""
        return {"last_timestamp": self._last, "intervals_s": list(self._intervals)}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._last = state["last_timestamp"]
        self._intervals = deque(state["intervals_s"], maxlen=self._intervals.maxlen)
