"""Intrinsics and distortion models of cameras, and the maps that undistort their images.

The models are OpenCV's: `radtan` (Brown 1966: k1 k2 p1 p2 [k3]), `rational` (k1 k2 p1 p2 k3 .. k6, then four of a thin
prism and two of a tilted sensor), and `equidistant` (Kannala, Brandt 2006: k1 .. k4) for fisheye lenses. The first two
are one model: coefficients that are not given are zero.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_OPENCV_COUNTS = (4, 5, 8, 12, 14)  # of coefficients that OpenCV takes

# Names that calibration tools and ROS give to the models, with the numbers of coefficients that they may have.
DISTORTION_MODELS = {
    "none": (0,),
    "radtan": _OPENCV_COUNTS,
    "plumb_bob": _OPENCV_COUNTS,
    "radial-tangential": _OPENCV_COUNTS,
    "brown_conrady": _OPENCV_COUNTS,
    "rational": _OPENCV_COUNTS,
    "rational_polynomial": _OPENCV_COUNTS,
    "thin_prism": _OPENCV_COUNTS,
    "equidistant": (4,),
    "fisheye": (4,),
}
FISHEYE_MODELS = ("equidistant", "fisheye")

_MAX_ANGLE_RAD = np.radians(70.0)  # from the optical axis: beyond it a pinhole image is mostly stretched corner
# OpenCV's iterative inverse converges to a wrong ray where a polynomial folds over inside the image. Such rays do not
# project back to their pixel; half a pixel separates them from rounding.
_MAX_ROUND_TRIP_PX = 0.5


@dataclass(frozen=True)
class CameraModel:
    """Intrinsics and distortion of one unrectified camera.

    Attributes:
        fx, fy: focal lengths, pixels.
        cx, cy: principal point, pixels.
        distortion_model: a name in DISTORTION_MODELS.
        coefficients: of the distortion model, in OpenCV's order.

    Raises:
        ValueError: a number that no camera has, an unknown model, or a wrong number of coefficients.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    distortion_model: str = "none"
    coefficients: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        model, found = self.distortion_model, len(self.coefficients)
        if not np.isfinite([self.fx, self.fy, self.cx, self.cy, *self.coefficients]).all():
            raise ValueError("expected finite numbers")
        if min(self.fx, self.fy) <= 0:
            raise ValueError(f"expected positive focal lengths, found {self.fx:g} and {self.fy:g}")
        if model not in DISTORTION_MODELS:
            raise ValueError(f"expected one of the models {', '.join(DISTORTION_MODELS)}, found {model!r}")
        if found not in DISTORTION_MODELS[model]:
            *others, last = map(str, DISTORTION_MODELS[model])
            counts = f"{', '.join(others)} or {last}" if others else last
            raise ValueError(f"expected {counts} coefficients of {model}, found {found}")

    @property
    def K(self) -> Array:
        """Calibration matrix (3, 3), pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def is_fisheye(self) -> bool:
        """Whether the model describes a fisheye lens."""
        return self.distortion_model in FISHEYE_MODELS

    @property
    def is_pinhole(self) -> bool:
        """Whether the image has no distortion."""
        return not any(self.coefficients) and not self.is_fisheye

    def unproject(self, pixels: Array) -> Array:
        """Directions (N, 3), with depth 1, of pixels (N, 2).

        Directions of a fisheye lens farther than 70 degrees from the optical axis are moved to 70 degrees.

        Raises:
            ValueError: the distortion cannot be inverted there.
        """
        normalized = self._undistort_fisheye(pixels) if self.is_fisheye else self._undistort(pixels)
        return np.hstack([normalized, np.ones((len(pixels), 1))])

    def _undistort(self, pixels: Array) -> Array:
        D, stop = np.array(self.coefficients), (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
        if not D.any():
            return (pixels - [self.cx, self.cy]) / [self.fx, self.fy]
        normalized = cv2.undistortPoints(pixels.reshape(-1, 1, 2), self.K, D, criteria=stop).reshape(-1, 2)
        rays = np.hstack([normalized, np.ones((len(normalized), 1))])
        again = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), self.K, D)[0].reshape(-1, 2)
        if not np.abs(again - pixels).max() < _MAX_ROUND_TRIP_PX:
            raise ValueError(
                f"expected {self.distortion_model} coefficients that hold to the border, found {self.coefficients}"
            )
        return np.asarray(normalized)

    def _undistort_fisheye(self, pixels: Array) -> Array:
        # Inverts the polynomial by a table over the angle: the table shows whether the polynomial is monotonic, and
        # clamps directions at a known angle.
        theta = np.linspace(0.0, _MAX_ANGLE_RAD, 2000)
        distorted = theta * (1.0 + theta[:, None] ** np.arange(2, 10, 2) @ np.array(self.coefficients))
        if (np.diff(distorted) <= 0).any():
            raise ValueError(
                f"expected {self.distortion_model} coefficients that grow with the angle, found {self.coefficients}"
            )
        normalized = (pixels - [self.cx, self.cy]) / [self.fx, self.fy]
        radius = np.maximum(np.linalg.norm(normalized, axis=1, keepdims=True), 1e-12)
        return np.asarray(normalized * np.tan(np.interp(radius, distorted, theta)) / radius)

    def undistort_maps(self, R_view_camera: Array, K_view: Array, size: tuple[int, int]) -> tuple[Array, Array]:
        """Maps for `cv2.remap` that turn images of this camera into those of a pinhole camera, in packed form.

        Args:
            R_view_camera: (3, 3) rotation of directions from this camera to the pinhole camera.
            K_view: (3, 3) calibration matrix of the pinhole camera.
            size: width and height of the pinhole image.
        """
        D = np.array(self.coefficients or (0.0,) * 4)
        opencv = cv2.fisheye if self.is_fisheye else cv2
        first, second = opencv.initUndistortRectifyMap(self.K, D, R_view_camera, K_view, size, cv2.CV_16SC2)
        return first, second
