"""Pinhole cameras and rectified stereo pairs: projection, and triangulation from a disparity or from two views.

Camera frame: x right, y down, z forward, metres, origin at the left camera. Pixel (0, 0) is the centre of the
top left pixel. Rectified: both cameras share intrinsics and rows; the right camera sits at (+baseline, 0, 0).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MIN_DEPTH_M = 0.3  # no point is seen closer to the camera
_MAX_DEPTH_M = 1e6  # as good as infinity


class PinholeCamera(Protocol):
    """Intrinsics of one camera, pixels; a stereo pair has them, and so has a single camera."""

    @property
    def fx(self) -> float:
        """Focal length along x, pixels."""
        ...

    @property
    def fy(self) -> float:
        """Focal length along y, pixels."""
        ...

    @property
    def cx(self) -> float:
        """Column of the principal point, pixels."""
        ...

    @property
    def cy(self) -> float:
        """Row of the principal point, pixels."""
        ...

    @property
    def width(self) -> int:
        """Width of the image, pixels."""
        ...

    @property
    def height(self) -> int:
        """Height of the image, pixels."""
        ...

    @property
    def K(self) -> Array:
        """Calibration matrix (3, 3), pixels."""
        ...


@dataclass(frozen=True)
class StereoCamera:
    """Intrinsics of a rectified stereo pair.

    Attributes:
        fx, fy: focal lengths, pixels.
        cx, cy: principal point, pixels.
        baseline: distance from the left to the right camera, metres, positive.
        width, height: image size, pixels.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    baseline: float
    width: int
    height: int

    def __post_init__(self) -> None:
        numbers = np.array([self.fx, self.fy, self.cx, self.cy, self.baseline])
        if not np.isfinite(numbers).all() or min(self.fx, self.fy, self.baseline) <= 0:
            raise ValueError(f"expected finite intrinsics with positive focal lengths and baseline, got {self}")

    @property
    def K(self) -> Array:
        """Calibration matrix (3, 3) of either camera, pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def project(self, points_camera: Array) -> Array:
        """Project points (N, 3), metres, left camera frame, to stereo pixels (N, 3): u left, u right, v.

        Points at or behind the image plane come back as NaN.
        """
        x, y, z = np.asarray(points_camera, dtype=np.float64).T
        z = np.where(z > 0, z, np.nan)
        u_left = self.fx * x / z + self.cx
        return np.stack([u_left, u_left - self.fx * self.baseline / z, self.fy * y / z + self.cy], axis=1)

    def triangulate(self, pixels_left: Array, disparity: Array) -> Array:
        """Points (N, 3), metres, left camera frame, of left pixels (N, 2) with disparity (N,), pixels.

        Disparity is u_left - u_right. Where it is not positive the point comes back as NaN.
        """
        pixels, disparity = np.asarray(pixels_left, dtype=np.float64), np.asarray(disparity, dtype=np.float64)
        z = self.fx * self.baseline / np.where(disparity > 0, disparity, np.nan)
        return np.stack([(pixels[:, 0] - self.cx) * z / self.fx, (pixels[:, 1] - self.cy) * z / self.fy, z], axis=1)


def clamp_inverse_depth(inverse_depth: Array) -> Array:
    """Clamp inverse depths, 1/m, to what a camera can see: in front of it, and not too close."""
    return np.clip(inverse_depth, 1.0 / _MAX_DEPTH_M, 1.0 / _MIN_DEPTH_M)


def triangulate(rays: Array, seen: Array, T_second_first: Array) -> tuple[Array, Array]:
    """Triangulate points from two views.

    Args:
        rays: (N, 3) directions of the points with z = 1 in the first camera.
        seen: (N, 3) directions of the same points with z = 1 in the second camera.
        T_second_first: (4, 4), or (N, 4, 4) with one for each point.

    Returns:
        Inverse depth (N,) in the first camera, negative behind it; and the squared shift (N,) of `seen` by a unit
        of inverse depth, a measure of parallax, zero where there is none.
    """
    R, t = T_second_first[..., :3, :3], T_second_first[..., :3, 3]
    turned = np.einsum("...ij,...j->...i", R, rays)
    shift = t[..., :2] - seen[:, :2] * t[..., 2:]
    rest = seen[:, :2] * turned[:, 2:] - turned[:, :2]
    strength = np.sum(shift * shift, axis=1)
    depth = np.sum(shift * rest, axis=1) / np.maximum(strength, 1e-12)
    # the shift is that of X over its depth before the division by the new depth
    return depth, strength / np.maximum(turned[:, 2], 0.1) ** 2
