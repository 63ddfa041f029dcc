"""Stereo rectification and undistortion: maps from raw images to those of an ideal pair of pinhole cameras.

Both cameras are rotated about their centres until the baseline lies along the image rows (Fusiello, Trucco, Verri, A
compact algorithm for rectification of stereo pairs, 2000). The rectified image shows only what both cameras have seen.
Why not OpenCV's `stereoRectify`: docs/decisions/rectification.md.
"""

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import StereoCamera
from slam.datasets.distortion_models import CameraModel

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Size = tuple[int, int]  # width, height

# Baseline of the virtual pair of a dataset with one camera: depths from motion are reported as its disparities.
NOMINAL_BASELINE_M = 0.5

# Images are used as they are if intrinsics and rotations differ by less: remapping would only blur them.
_MAX_INTRINSICS_DIFFERENCE_PX, _MAX_ROTATION_ENTRY = 1e-3, 1e-6
# Between the rows and the baseline, and between the two optical axes: a pair beyond it was described wrongly.
_MAX_ROTATION_RAD = np.radians(45.0)
# Positions along each image border at which the field of view is sampled. Distorted borders are smooth curves.
_BORDER_SAMPLES = np.linspace(0.0, 1.0, 33)
_MIN_RAY_DEPTH = 0.1  # z of a border ray: rays farther to the side cannot be in the image of a pinhole camera


class ImageMap(Protocol):
    """Turns a raw image into a rectified image."""

    def __call__(self, image: Image, /) -> Image:
        """Return the rectified image (H, W) or (H, W, 3) uint8 of a raw image of that form."""
        ...


@dataclass(frozen=True)
class IdentityMap:
    """The map of a camera whose images are rectified already (an ImageMap)."""

    def __call__(self, image: Image) -> Image:
        """Return the image itself."""
        return image


@dataclass(frozen=True)
class UndistortMap:
    """Undistorts and rotates images by a lookup table (an ImageMap).

    Attributes:
        maps: coordinates at which each rectified pixel is read, in OpenCV's packed form (CV_16SC2).
    """

    maps: tuple[Array, Array]

    def __call__(self, image: Image) -> Image:
        """Return the rectified image (H, W) or (H, W, 3) uint8 of a raw image of that form."""
        return np.asarray(cv2.remap(image, *self.maps, cv2.INTER_LINEAR), np.uint8)


@dataclass(frozen=True)
class Rectification:
    """A rectified camera or pair, and the maps that make its images.

    Attributes:
        camera: intrinsics and baseline of the rectified pair.
        left, right: maps from raw to rectified images; `right` is unused in a dataset with one camera.
        T_camera_view: (4, 4) pose of the rectified left camera in the raw left camera: a pure rotation.
    """

    camera: StereoCamera
    left: ImageMap
    right: ImageMap
    T_camera_view: Array


def identity_rectification(camera: StereoCamera) -> Rectification:
    """Return the rectification of images that are rectified already."""
    return Rectification(camera, IdentityMap(), IdentityMap(), np.eye(4))


def rectify_parallel(model: CameraModel, size: Size, baseline_m: float = NOMINAL_BASELINE_M) -> Rectification:
    """Undistort one camera, or a pair of equal, parallel cameras side by side.

    Args:
        model: intrinsics and distortion of either camera.
        size: width and height of the images.
        baseline_m: distance between the two cameras.

    Raises:
        ValueError: the distortion cannot be inverted, or the baseline is not positive.
    """
    if model.is_pinhole:
        return identity_rectification(StereoCamera(model.fx, model.fy, model.cx, model.cy, baseline_m, *size))
    camera = _common_camera([(model, np.eye(3))], size, baseline_m)
    image_map = UndistortMap(model.undistort_maps(np.eye(3), camera.K, size))
    return Rectification(camera, image_map, image_map, np.eye(4))


def rectify_pair(left: CameraModel, right: CameraModel, T_left_right: Array, size: Size) -> Rectification:
    """Rectify a calibrated stereo pair.

    Args:
        left: intrinsics and distortion of the left camera.
        right: intrinsics and distortion of the right camera.
        T_left_right: (4, 4) pose of the right camera in the left camera's frame, metres.
        size: width and height of the images of both cameras.

    Raises:
        ValueError: the right camera is not to the right of the left one, the two look in different directions, or a
            distortion cannot be inverted.
    """
    baseline = float(np.linalg.norm(T_left_right[:3, 3]))
    R_left_view = _rectifying_rotation(T_left_right, baseline)
    R_view_left = R_left_view.T
    R_view_right = R_view_left @ T_left_right[:3, :3]
    if _is_rectified(left, right, R_left_view, R_view_right):
        return identity_rectification(StereoCamera(left.fx, left.fy, left.cx, left.cy, baseline, *size))
    camera = _common_camera([(left, R_view_left), (right, R_view_right)], size, baseline)
    return Rectification(
        camera,
        UndistortMap(left.undistort_maps(R_view_left, camera.K, size)),
        UndistortMap(right.undistort_maps(R_view_right, camera.K, size)),
        se3.pose(R_left_view, np.zeros(3)),
    )


def _rectifying_rotation(T_left_right: Array, baseline: float) -> Array:
    """R_left_view (3, 3): x along the baseline, z as close as possible to the mean of the two optical axes."""
    to_right = T_left_right[:3, 3]
    if baseline == 0 or to_right[0] < np.cos(_MAX_ROTATION_RAD) * baseline:
        raise ValueError(
            f"expected the right camera to the right of the left one, found it at {np.round(to_right, 4).tolist()} m"
            " (x right, y down, z ahead)"
        )
    x = to_right / baseline
    ahead = np.array([0.0, 0.0, 1.0]) + T_left_right[:3, 2]
    if T_left_right[2, 2] < np.cos(_MAX_ROTATION_RAD):
        raise ValueError("expected two cameras that look in one direction, found more than 45 degrees between them")
    y = np.cross(ahead, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _is_rectified(left: CameraModel, right: CameraModel, *rotations: Array) -> bool:
    same = np.allclose(left.K, right.K, rtol=0, atol=_MAX_INTRINSICS_DIFFERENCE_PX)
    rotation = max(np.abs(R - np.eye(3)).max() for R in rotations)
    return bool(left.is_pinhole and right.is_pinhole and same and rotation < _MAX_ROTATION_ENTRY)


def _common_camera(cameras: list[tuple[CameraModel, Array]], size: Size, baseline: float) -> StereoCamera:
    """Return the pinhole camera whose image shows only directions that all cameras have seen.

    Args:
        cameras: model and R_view_camera (3, 3) of each camera.
        size: width and height of raw and rectified images.
        baseline: of the pair, metres.
    """
    low, high = (np.array(ends) for ends in zip(*(_inner_rectangle(m, R, size) for m, R in cameras), strict=True))
    low, high = low.max(axis=0), high.min(axis=0)
    if (high <= low).any():
        raise ValueError("expected cameras with a common field of view, found none")
    last = np.array(size) - 1.0
    # Pixels are square, so one axis decides: the larger focal length shows less, and stays inside on both axes.
    f = float((last / (high - low)).max())
    cx, cy = last / 2 - f * (low + high) / 2
    return StereoCamera(f, f, float(cx), float(cy), baseline, *size)


def _inner_rectangle(model: CameraModel, R_view_camera: Array, size: Size) -> tuple[Array, Array]:
    """Lower and upper corner (2,) of a rectangle at depth 1 of the view, inside the raw image's border."""
    right, bottom = size[0] - 1.0, size[1] - 1.0
    along, zeros, ones = _BORDER_SAMPLES, np.zeros_like(_BORDER_SAMPLES), np.ones_like(_BORDER_SAMPLES)
    sides = [(zeros, along), (ones, along), (along, zeros), (along, ones)]  # left, right, top, bottom
    pixels = np.concatenate([np.stack(side, axis=1) for side in sides]) * [right, bottom]
    rays = model.unproject(pixels) @ R_view_camera.T
    if (rays[:, 2] < _MIN_RAY_DEPTH).any():
        raise ValueError("expected cameras that look in one direction, found an image border behind the other camera")
    x, y = (rays[:, :2] / rays[:, 2:]).T.reshape(2, 4, -1)
    return np.array([x[0].max(), y[2].max()]), np.array([x[1].min(), y[3].min()])
