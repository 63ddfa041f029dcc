"""COLMAP's text model: `cameras.txt`, `images.txt` and `points3D.txt`.

As its page "Output Format" defines: poses map world to camera, quaternions have w first, and the centre of the first
pixel is (0.5, 0.5). Everywhere else in this product it is (0, 0).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from odometry import se3
from slam.io.files import atomic_writer
from slam.io.landmarks import LandmarkObservers
from slam.run_result import PointCloud

Array = NDArray[np.float64]

_FIRST_PIXEL_CENTRE = 0.5
_UNKNOWN_ERROR = -1  # reprojection error of a point that is no result of bundle adjustment


def image_name(frame: int) -> str:
    """Return the file name of the image of a frame, as in KITTI's folders."""
    return f"{frame:06d}.png"


@dataclass(frozen=True)
class Model:
    """Poses and landmarks of a run.

    Attributes:
        T_world_camera: poses of all frames, (N, 4, 4), metres.
        cloud: M landmarks, world frame.
        observers: the frame that observed each landmark, and the camera.
    """

    T_world_camera: Array
    cloud: PointCloud
    observers: LandmarkObservers

    def pixels(self) -> Array:
        """Return the pixel (M, 2) of each landmark in its image; (0, 0) is the centre of the first pixel."""
        T_camera_world = se3.inverse(self.T_world_camera)[self.observers.frames]
        x, y, z = np.einsum("mij,mj->im", T_camera_world[:, :3, :3], self.cloud.points) + T_camera_world[:, :3, 3].T
        fx, fy, cx, cy = self.observers.intrinsics
        return np.stack([fx * x / z + cx, fy * y / z + cy], axis=1)


def write_colmap(folder: Path, model: Model) -> None:
    """Write the three files. Each landmark was observed once, so its track has one image.

    Raises:
        OutputError: they cannot be written.
    """
    _write(folder / "cameras.txt", _cameras(model.observers))
    _write(folder / "images.txt", _images(model))
    _write(folder / "points3D.txt", _points(model))


def _write(path: Path, lines: Iterator[str]) -> None:
    with atomic_writer(path) as file:
        file.writelines(line + "\n" for line in lines)


def _cameras(observers: LandmarkObservers) -> Iterator[str]:
    yield "# CAMERA_ID, MODEL, WIDTH, HEIGHT, fx, fy, cx, cy"
    fx, fy, cx, cy = observers.intrinsics
    width, height = observers.size
    yield _line(1, "PINHOLE", width, height, fx, fy, cx + _FIRST_PIXEL_CENTRE, cy + _FIRST_PIXEL_CENTRE)


def _images(model: Model) -> Iterator[str]:
    yield "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME"
    yield "# X, Y, POINT3D_ID of each landmark in the image"
    T_camera_world, pixels = se3.inverse(model.T_world_camera), model.pixels() + _FIRST_PIXEL_CENTRE
    quaternions = Rotation.from_matrix(T_camera_world[:, :3, :3]).as_quat(scalar_first=True, canonical=True)
    order, starts = _group_by_frame(model.observers.frames, len(quaternions))
    for frame, (T, quaternion) in enumerate(zip(T_camera_world, quaternions, strict=True)):
        yield _line(frame + 1, *quaternion, *T[:3, 3], 1, image_name(frame))
        seen = order[starts[frame] : starts[frame + 1]]
        yield " ".join(_line(*pixels[point], point + 1) for point in seen)


def _points(model: Model) -> Iterator[str]:
    yield "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, (IMAGE_ID, POINT2D_IDX)"
    frames = model.observers.frames
    order, starts = _group_by_frame(frames, len(model.T_world_camera))
    places = np.empty(len(frames), np.int64)  # of each point in the list of its image
    places[order] = np.arange(len(frames)) - starts[frames[order]]
    for point, (position, grey) in enumerate(zip(model.cloud.points, model.cloud.grey, strict=True)):
        yield _line(point + 1, *position, grey, grey, grey, _UNKNOWN_ERROR, frames[point] + 1, places[point])


def _group_by_frame(frames: NDArray[np.int32], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the points (M,) sorted by frame, and the first index of each frame, (count + 1,)."""
    order = np.argsort(frames, kind="stable")
    return order, np.searchsorted(frames[order], np.arange(count + 1))


def _line(*values: object) -> str:
    return " ".join(repr(float(value)) if isinstance(value, float) else str(value) for value in values)
