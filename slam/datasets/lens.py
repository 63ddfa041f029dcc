"""A camera as it is, with the distortion of its lens, and the straight view that it is turned into.

The models are OpenCV's: `radtan` (Brown 1966: k1 k2 p1 p2 [k3]), `rational` (k1 k2 p1 p2 k3 .. k6), and `equidistant`
(Kannala, Brandt 2006: k1 .. k4) for fish eyes.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

# Names that calibration tools and ROS give to the models, with the numbers of coefficients that they may have.
MODELS = {
    "none": (0,),
    "radtan": (4, 5),
    "plumb_bob": (4, 5),
    "radial-tangential": (4, 5),
    "rational": (8,),
    "rational_polynomial": (8,),
    "equidistant": (4,),
    "fisheye": (4,),
}
FISH_EYES = ("equidistant", "fisheye")

_WIDEST = np.radians(70.0)  # from the axis: beyond it a straight view is mostly stretched corner
_UNDONE_PX = 0.5  # off by so much, a distortion folds over instead of bending


@dataclass(frozen=True)
class Lens:
    """One camera of a rig.

    Attributes:
        fx, fy: focal lengths, pixels.
        cx, cy: principal point, pixels.
        model: of the distortion, in MODELS.
        coefficients: of the distortion.

    Raises:
        ValueError: numbers that no lens has, an unknown model, or another number of coefficients than it takes.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    model: str = "none"
    coefficients: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not np.isfinite([self.fx, self.fy, self.cx, self.cy, *self.coefficients]).all():
            raise ValueError("expected finite numbers")
        if min(self.fx, self.fy) <= 0:
            raise ValueError(f"expected positive focal lengths, found {self.fx:g} and {self.fy:g}")
        if self.model not in MODELS:
            raise ValueError(f"expected one of the models {', '.join(MODELS)}, found {self.model!r}")
        if len(self.coefficients) not in MODELS[self.model]:
            counts = " or ".join(map(str, MODELS[self.model]))
            raise ValueError(f"expected {counts} coefficients of {self.model}, found {len(self.coefficients)}")

    @property
    def K(self) -> Array:
        """Calibration matrix (3, 3), pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def straight(self) -> bool:
        """Whether straight lines stay straight."""
        return not any(self.coefficients) and self.model not in FISH_EYES

    def rays(self, pixels: Array) -> Array:
        """Directions (N, 3), depth 1, of pixels (N, 2); a fish eye's are bent inwards to 70 degrees from the axis.

        Raises:
            ValueError: the distortion cannot be undone there.
        """
        flat = self._fish_eye_undone(pixels) if self.model in FISH_EYES else self._undone(pixels)
        return np.hstack([flat, np.ones((len(pixels), 1))])

    def _undone(self, pixels: Array) -> Array:
        D, stop = np.array(self.coefficients), (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
        if not D.any():
            return (pixels - [self.cx, self.cy]) / [self.fx, self.fy]
        flat = cv2.undistortPoints(pixels.reshape(-1, 1, 2), self.K, D, criteria=stop).reshape(-1, 2)
        rays = np.hstack([flat, np.ones((len(flat), 1))])
        again = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), self.K, D)[0].reshape(-1, 2)
        if not np.abs(again - pixels).max() < _UNDONE_PX:
            raise ValueError(f"expected {self.model} coefficients that hold to the border, found {self.coefficients}")
        return np.asarray(flat)

    def _fish_eye_undone(self, pixels: Array) -> Array:
        theta = np.linspace(0.0, _WIDEST, 2000)
        bent = theta * (1.0 + theta[:, None] ** np.arange(2, 10, 2) @ np.array(self.coefficients))
        if (np.diff(bent) <= 0).any():
            raise ValueError(f"expected {self.model} coefficients that grow with the angle, found {self.coefficients}")
        flat = (pixels - [self.cx, self.cy]) / [self.fx, self.fy]
        radius = np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-12)
        return np.asarray(flat * np.tan(np.interp(radius, bent, theta)) / radius)

    def maps(self, R_view_camera: Array, K_view: Array, size: tuple[int, int]) -> tuple[Array, Array]:
        """Where each pixel of a straight view of a size (width, height) is read, in OpenCV's packed form.

        Args:
            R_view_camera: (3, 3) rotation of directions from the camera to the view.
            K_view: (3, 3) calibration matrix of the view.
            size: of the view, width and height.
        """
        D = np.array(self.coefficients or (0.0,) * 4)
        maps = cv2.fisheye if self.model in FISH_EYES else cv2
        first, second = maps.initUndistortRectifyMap(self.K, D, R_view_camera, K_view, size, cv2.CV_16SC2)
        return first, second
