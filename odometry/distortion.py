"""Remaining lens distortion of one camera, learned while driving.

Radial and decentering distortion (Brown, Decentering Distortion of Lenses, 1966), which
`odometry.stereo.stereo_self_calibration` learns for a pair as well. Points that move through the image
show it. Formulas: docs/math.md, section "Self-calibration".
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry.camera import PinholeCamera

Array = NDArray[np.float64]

NUM_COEFFICIENTS = 3  # radial, decentering along x, decentering along y


@dataclass(frozen=True)
class LensDistortionConfig:
    """Prior of the lens distortion before the first image, and how fast it may change.

    Attributes:
        radial_px: standard deviation of the radial distortion, pixels at 45 degrees.
        decentering_px: standard deviation of the decentering distortion, pixels at 45 degrees.
        drift_px: growth of the standard deviations, pixels per square root of a reference frame.
    """

    radial_px: float = 10.0
    decentering_px: float = 5.0
    drift_px: float = 0.001


@dataclass(frozen=True)
class LensDistortion:
    """A camera and its distortion: displacement of its pixels from those of a perfect lens.

    Attributes:
        camera: the intrinsics.
        coefficients: (3,) pixels at 45 degrees.
        covariance: (3, 3) pixels squared.
    """

    camera: PinholeCamera
    coefficients: Array
    covariance: Array

    @classmethod
    def unknown(cls, camera: PinholeCamera, config: LensDistortionConfig) -> "LensDistortion":
        """Prior before the first image."""
        deviation = np.array([config.radial_px, config.decentering_px, config.decentering_px])
        return cls(camera, np.zeros(NUM_COEFFICIENTS), np.diag(deviation**2))

    def rays(self, pixels: Array) -> Array:
        """Directions (N, 3) with z = 1, camera frame, of pixels (N, 2)."""
        c = self.camera
        straight = undistort(c, self.coefficients, pixels)
        x, y = (straight[:, 0] - c.cx) / c.fx, (straight[:, 1] - c.cy) / c.fy
        return np.stack([x, y, np.ones_like(x)], axis=1)

    def pixels(self, points: Array) -> Array:
        """Pixels (N, 2) of points (N, 3), camera frame; NaN at or behind the image plane.

        The distortion is that at the pixel of a perfect lens: exact to a tenth of a pixel.
        """
        c = self.camera
        x, y, z = points.T
        z = np.where(z > 0, z, np.nan)
        straight = np.stack([c.fx * x / z + c.cx, c.fy * y / z + c.cy], axis=1)
        return 2 * straight - undistort(c, self.coefficients, straight)

    def update(self, coefficients: Array, information: Array, config: LensDistortionConfig) -> "LensDistortion":
        """Take over coefficients (3,) with the new information (3, 3) about them."""
        covariance = np.linalg.inv(np.linalg.inv(self.covariance) + information)
        covariance = covariance + config.drift_px**2 * np.eye(NUM_COEFFICIENTS)
        return LensDistortion(self.camera, coefficients, 0.5 * (covariance + covariance.T))


def undistort(camera: PinholeCamera, coefficients: Array, pixels: Array) -> Array:
    """Remove the distortion of pixels (N, 2), given its coefficients (3,) in pixels at 45 degrees."""
    x, y = (pixels[:, 0] - camera.cx) / camera.fx, (pixels[:, 1] - camera.cy) / camera.fy
    radial, across, down = coefficients
    squared = x * x + y * y
    return pixels + np.stack(
        [
            radial * squared * x + across * (squared + 2 * x * x) + down * 2 * x * y,
            radial * squared * y + across * 2 * x * y + down * (squared + 2 * y * y),
        ],
        axis=1,
    )
