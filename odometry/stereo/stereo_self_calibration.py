"""Remaining calibration error of a stereo pair, learned while driving.

Recorded pairs are never calibrated perfectly. Two errors matter and both are seen without ground truth:

* Rectification: rows of a pair differ by up to a pixel on KITTI and disparities are wrong by as much, which
  makes every distance estimated from far points too long (Kreso and Segvic, Improving the Egomotion Estimation by
  Correcting the Calibration Bias, VISAPP 2015, learned it from ground truth). Rows that differ are seen in each
  pair; an offset in disparity makes near and far points disagree about one motion. Modelled as one quadratic
  polynomial of the viewing ray for each axis of the right image.
* Lens: distortion that undistortion has left, the same in both images of a pair, is seen by points that move
  through the image and turns into drift of direction. Modelled as radial and decentering distortion (Brown,
  Decentering Distortion of Lenses, 1966). On the KITTI clips 10 to 12 pixels at 45 degrees are found.

All coefficients are estimated with the motion and filtered like a Kalman state: docs/math.md, section
"Self-calibration"; why: docs/decisions/self_calibration.md.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry import distortion
from odometry.camera import StereoCamera

Array = NDArray[np.float64]

NUM_DISTORTION = distortion.NUM_COEFFICIENTS  # of both cameras
NUM_RECTIFICATION = 6  # 1, x, y, x², xy, y² of the ray (x, y, 1), for each of the two axes of the rectification
NUM_COEFFICIENTS = NUM_DISTORTION + 2 * NUM_RECTIFICATION
_PRIOR_FOCAL_LENGTH_PX = 700.0
_ITERATIONS = 15  # of a fixed point whose error falls tenfold or more in each: distortion changes slowly over the image


@dataclass(frozen=True)
class CalibrationConfig:
    """Prior of the calibration error before the first image, and how fast it may change.

    Errors of a calibration grow with the resolution: the prior is that of a camera with a focal length of 700 pixels.

    Attributes:
        radial_px: standard deviation of the radial distortion, pixels at 45 degrees.
        decentering_px: standard deviation of the decentering distortion, pixels at 45 degrees.
        offset_px: standard deviation of a constant rectification error, pixels.
        slope_px: standard deviation of a rectification error that grows with the ray, pixels at 45 degrees.
        curvature_px: standard deviation of one that grows with the square of the ray, pixels at 45 degrees.
        frames_per_track: frames in which one track is seen, so that its error is not counted anew in each.
        drift_px: growth of the standard deviation of each coefficient, pixels per square root of a frame.
    """

    radial_px: float = 10.0
    decentering_px: float = 5.0
    offset_px: float = 1.0
    slope_px: float = 3.0
    curvature_px: float = 10.0
    frames_per_track: int = 4
    drift_px: float = 0.003

    def prior(self, camera: StereoCamera) -> Array:
        """Covariance (15, 15) before any image of a camera, pixels squared."""
        distortion = [self.radial_px] + [self.decentering_px] * 2
        axis = [self.offset_px] + [self.slope_px] * 2 + [self.curvature_px] * 3
        scale = camera.fx / _PRIOR_FOCAL_LENGTH_PX
        return np.diag(np.square(scale * np.array(distortion + axis * 2, dtype=np.float64)))


@dataclass(frozen=True)
class Calibration:
    """Calibration error of a pair: displacement of its pixels from those of a perfectly calibrated pair.

    Attributes:
        camera: the pair.
        coefficients: (15,) pixels: 3 of the distortion, 6 of the rectification error along columns and 6 along rows.
        covariance: (15, 15) pixels squared.
    """

    camera: StereoCamera
    coefficients: Array
    covariance: Array

    @classmethod
    def unknown(cls, camera: StereoCamera, config: CalibrationConfig) -> "Calibration":
        """Prior before the first image."""
        return cls(camera, np.zeros(NUM_COEFFICIENTS), config.prior(camera))

    def undistort(self, pixels: Array) -> Array:
        """Remove the lens distortion of pixels (N, 2) of either image."""
        return distortion.undistort(self.camera, self.coefficients[:NUM_DISTORTION], pixels)

    def rectify(self, pixels_left: Array, pixels_right: Array) -> tuple[Array, Array]:
        """Move matches (N, 2), pixels left and right, to where a perfect pair would show them."""
        return self.undistort(pixels_left), self.undistort(pixels_right) - self._field(pixels_left)

    def unrectify(self, pixels: Array) -> tuple[Array, Array]:
        """Move pixels (N, 2) of far points in a perfect pair to where this pair shows them, left and right (N, 2).

        The inverse of `rectify` where there is no disparity.
        """
        left = self._distort(pixels)
        return left, self._distort(pixels + self._field(left))

    def correct_disparity(self, pixels_left: Array, disparity: Array) -> Array:
        """Correct disparities (N,), pixels, at pixels (N, 2) of the left image to those of a perfect pair."""
        pixels_right = np.stack([pixels_left[:, 0] - disparity, pixels_left[:, 1]], axis=1)
        left, right = self.rectify(pixels_left, pixels_right)
        return left[:, 0] - right[:, 0]

    def update(self, coefficients: Array, information: Array, config: CalibrationConfig) -> "Calibration":
        """Take over coefficients (15,) with the information (15, 15) of one frame about them."""
        known = np.linalg.inv(self.covariance) + information / config.frames_per_track
        covariance = np.linalg.inv(known) + config.drift_px**2 * np.eye(NUM_COEFFICIENTS)
        return Calibration(self.camera, coefficients, 0.5 * (covariance + covariance.T))

    def _distort(self, pixels: Array) -> Array:
        """Add the lens distortion to pixels (N, 2) without it: the inverse of `undistort`."""
        distorted = pixels
        for _ in range(_ITERATIONS):
            distorted = distorted + pixels - self.undistort(distorted)
        return distorted

    def _field(self, pixels_left: Array) -> Array:
        """Rectification errors (N, 2), column and row, pixels, of the matches of pixels (N, 2) of the left image."""
        x, y = self._rays(pixels_left)
        terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
        return terms @ self.coefficients[NUM_DISTORTION:].reshape(2, NUM_RECTIFICATION).T

    def _rays(self, pixels: Array) -> tuple[Array, Array]:
        """Slopes (N,), (N,) of the rays of pixels (N, 2)."""
        camera = self.camera
        return (pixels[:, 0] - camera.cx) / camera.fx, (pixels[:, 1] - camera.cy) / camera.fy


_EXACT_PX = 1e-6  # standard deviation of what is known: small enough that an adjustment leaves it where it is


class ExactCalibration(Calibration):
    """A calibration without any error, as that of a depth image, which was registered before: nothing is learned."""

    @classmethod
    def of(cls, camera: StereoCamera) -> "ExactCalibration":
        """Calibration of a camera."""
        return cls(camera, np.zeros(NUM_COEFFICIENTS), _EXACT_PX**2 * np.eye(NUM_COEFFICIENTS))

    def update(self, coefficients: Array, information: Array, config: CalibrationConfig) -> "Calibration":
        """Return the same calibration."""
        return self
