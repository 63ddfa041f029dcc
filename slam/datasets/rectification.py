"""From the images of real cameras to those of an ideal pair: straight lines, equal intrinsics, common rows.

The pair is turned about its two centres until the line between them lies along the rows (Fusiello, Trucco, Verri, A
compact algorithm for rectification of stereo pairs, 2000), and then looks as far to each side as both cameras have
seen: no black margin, whose edge would pass for a corner of the world.
"""

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import StereoCamera
from slam.datasets.lens import Lens

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Size = tuple[int, int]  # width, height

NOMINAL_BASELINE = 0.5  # m, of a camera that is alone: depth from motion is told as the disparities of such a pair

_SAME_PX, _SAME_RAD = 1e-3, 1e-6  # closer than that, cameras are a rectified pair already
_MOST_TURN = np.radians(45.0)  # between the rows and the line to the right camera
_ALONG = np.linspace(0.0, 1.0, 33)  # places looked at along each border


class View(Protocol):
    """Turns the image of a camera into the one of the ideal pair."""

    def __call__(self, image: Image, /) -> Image:
        """The view (H, W) uint8 of an image (H, W) uint8."""
        ...


@dataclass(frozen=True)
class AsItIs:
    """The view of a camera that is ideal already."""

    def __call__(self, image: Image) -> Image:
        """The image itself."""
        return image


@dataclass(frozen=True)
class Straightened:
    """A view that is read from the image at other places.

    Attributes:
        maps: where, in OpenCV's packed form.
    """

    maps: tuple[Array, Array]

    def __call__(self, image: Image) -> Image:
        """The view (H, W) uint8 of an image."""
        return np.asarray(cv2.remap(image, *self.maps, cv2.INTER_LINEAR), np.uint8)


@dataclass(frozen=True)
class Rectification:
    """An ideal camera or pair, and how its images are made.

    Attributes:
        camera: the ideal one.
        left, right: views; `right` serves nobody where there is one camera.
        T_camera_view: (4, 4) pose of the left view in the real left camera: a rotation.
    """

    camera: StereoCamera
    left: View
    right: View
    T_camera_view: Array


def ideal(camera: StereoCamera) -> Rectification:
    """Nothing to do."""
    return Rectification(camera, AsItIs(), AsItIs(), np.eye(4))


def rectify_alike(lens: Lens, size: Size, baseline: float = NOMINAL_BASELINE) -> Rectification:
    """Straighten the images of one camera, or of two that are alike and side by side.

    Args:
        lens: of either camera.
        size: width and height of its images.
        baseline: between the two, metres.

    Raises:
        ValueError: the distortion cannot be undone, or the baseline is not positive.
    """
    if lens.straight:
        return ideal(StereoCamera(lens.fx, lens.fy, lens.cx, lens.cy, baseline, *size))
    camera = _camera([(lens, np.eye(3))], size, baseline)
    view = Straightened(lens.maps(np.eye(3), camera.K, size))
    return Rectification(camera, view, view, np.eye(4))


def rectify_pair(left: Lens, right: Lens, T_left_right: Array, size: Size) -> Rectification:
    """Make an ideal pair of two cameras.

    Args:
        left: lens of the left camera.
        right: of the right one.
        T_left_right: (4, 4) pose of the right camera in the left one, metres.
        size: width and height of the images of both.

    Raises:
        ValueError: the right camera is not to the right of the left one, the two look elsewhere, or a distortion
            cannot be undone.
    """
    baseline = float(np.linalg.norm(T_left_right[:3, 3]))
    R_left_view = _turned(T_left_right, baseline)
    R_view_left = R_left_view.T
    R_view_right = R_view_left @ T_left_right[:3, :3]
    if _is_ideal(left, right, R_left_view, R_view_right):
        return ideal(StereoCamera(left.fx, left.fy, left.cx, left.cy, baseline, *size))
    camera = _camera([(left, R_view_left), (right, R_view_right)], size, baseline)
    return Rectification(
        camera,
        Straightened(left.maps(R_view_left, camera.K, size)),
        Straightened(right.maps(R_view_right, camera.K, size)),
        se3.pose(R_left_view, np.zeros(3)),
    )


def _turned(T_left_right: Array, baseline: float) -> Array:
    """R_left_view (3, 3): x towards the right camera, z between the two axes as far as that allows."""
    to_right = T_left_right[:3, 3]
    if baseline == 0 or to_right[0] < np.cos(_MOST_TURN) * baseline:
        raise ValueError(
            f"expected the right camera to the right of the left one, found it at {np.round(to_right, 4).tolist()} m"
            " (x right, y down, z ahead)"
        )
    x = to_right / baseline
    ahead = np.array([0.0, 0.0, 1.0]) + T_left_right[:3, 2]
    if T_left_right[2, 2] < np.cos(_MOST_TURN):
        raise ValueError("expected two cameras that look the same way, found more than 45 degrees between them")
    y = np.cross(ahead, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _is_ideal(left: Lens, right: Lens, *rotations: Array) -> bool:
    same = np.allclose(left.K, right.K, rtol=0, atol=_SAME_PX)
    turned = max(np.abs(R - np.eye(3)).max() for R in rotations)
    return bool(left.straight and right.straight and same and turned < _SAME_RAD)


def _camera(eyes: list[tuple[Lens, Array]], size: Size, baseline: float) -> StereoCamera:
    """The ideal camera of a size that shows only what every eye, a lens and its R_view_camera, has seen."""
    low, high = (np.array(ends) for ends in zip(*(_seen(lens, R, size) for lens, R in eyes), strict=True))
    low, high = low.max(axis=0), high.min(axis=0)
    if (high <= low).any():
        raise ValueError("expected a straight view that all cameras share, found none")
    last = np.array(size) - 1.0
    f = float((last / (high - low)).max())
    cx, cy = last / 2 - f * (low + high) / 2
    return StereoCamera(f, f, float(cx), float(cy), baseline, *size)


def _seen(lens: Lens, R_view_camera: Array, size: Size) -> tuple[Array, Array]:
    """Lower and upper corner (2,), at depth 1, of a rectangle in the view inside the image's border."""
    right, bottom = size[0] - 1.0, size[1] - 1.0
    zeros, ones = np.zeros_like(_ALONG), np.ones_like(_ALONG)
    sides = [(zeros, _ALONG), (ones, _ALONG), (_ALONG, zeros), (_ALONG, ones)]
    pixels = np.concatenate([np.stack(side, axis=1) for side in sides]) * [right, bottom]
    rays = lens.rays(pixels) @ R_view_camera.T
    if (rays[:, 2] < 0.1).any():
        raise ValueError("expected cameras that look the same way, found a border behind the view")
    x, y = (rays[:, :2] / rays[:, 2:]).T.reshape(2, 4, -1)
    return np.array([x[0].max(), y[2].max()]), np.array([x[1].min(), y[3].min()])
