"""What is left of a stereo pair's calibration error, learned while driving.

Recorded pairs are never rectified perfectly: on KITTI rows differ by up to a pixel and disparities are
wrong by as much, which makes every way estimated from far points too long (Kreso and Segvic, Improving the
Egomotion Estimation by Correcting the Calibration Bias, VISAPP 2015, found the same and learned it from
ground truth). No ground truth is needed: rows that differ are seen in each pair, and an offset in disparity
makes near and far points disagree about the same motion. The error is modelled as a smooth field over the
right image, one quadratic polynomial of the viewing ray for each axis, and estimated with the motion, frame
by frame, in the manner of a Kalman filter.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera

Array = NDArray[np.float64]

TERMS = 6  # 1, x, y, x², xy, y² of the ray (x, y, 1), for each of the two axes


@dataclass(frozen=True)
class RectificationConfig:
    """What is thought of the calibration before the first image, and how fast it is believed to change.

    Attributes:
        offset_px: standard deviation of a constant error, pixels.
        slope_px: standard deviation of an error that grows with the ray, pixels at 45 degrees.
        curvature_px: the same for one that grows with its square.
        repeats: frames in which one track is seen, so that its error is not counted anew in each.
        drift_px: growth of the standard deviation of each coefficient, pixels per square root of a frame.

    """

    offset_px: float = 1.0
    slope_px: float = 3.0
    curvature_px: float = 10.0
    repeats: float = 4.0
    drift_px: float = 0.003

    def prior(self) -> Array:
        """Covariance (12, 12) before any image, pixels squared."""
        axis = [self.offset_px] + [self.slope_px] * 2 + [self.curvature_px] * 3
        return np.diag(np.square(np.array(axis * 2, dtype=np.float64)))


@dataclass(frozen=True)
class Rectification:
    """The error field of a pair: what the right image shows minus what a perfect pair would show.

    Attributes:
        camera: the pair.
        coefficients: (12,) pixels, TERMS for the column and TERMS for the row.
        covariance: (12, 12) pixels squared.

    """

    camera: StereoCamera
    coefficients: Array
    covariance: Array

    @classmethod
    def unknown(cls, camera: StereoCamera, config: RectificationConfig) -> "Rectification":
        """Nothing learned yet."""
        return cls(camera, np.zeros(2 * TERMS), config.prior())

    def errors(self, pixels_left: Array) -> Array:
        """Errors (N, 2), column and row, pixels, of the matches of pixels (N, 2) of the left image."""
        x = (pixels_left[:, 0] - self.camera.cx) / self.camera.fx
        y = (pixels_left[:, 1] - self.camera.cy) / self.camera.fy
        terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
        return terms @ self.coefficients.reshape(2, TERMS).T

    def correct(self, pixels_left: Array, disparity: Array) -> Array:
        """Disparity (N,), pixels, that a perfect pair would have shown at pixels (N, 2) of the left image."""
        return disparity + self.errors(pixels_left)[:, 0]

    def learned(self, coefficients: Array, information: Array, config: RectificationConfig) -> "Rectification":
        """Take over coefficients (12,) with the information (12, 12) that one frame gave about them."""
        known = np.linalg.inv(self.covariance) + information / config.repeats
        covariance = np.linalg.inv(known) + config.drift_px**2 * np.eye(2 * TERMS)
        return Rectification(self.camera, coefficients, 0.5 * (covariance + covariance.T))
