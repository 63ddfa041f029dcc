"""Result of an odometry: the camera's motion from the previous image to the current one."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


FIRST_VARIANCE = 1e-12  # rad², m²: the pose of the first image is exact by definition


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
