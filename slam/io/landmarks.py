"""Landmarks of a run: its maps as point clouds in binary PLY files, and `landmarks.npz`, the observers of their points.

Every point cloud viewer opens the PLY files. Both directions are written here, not by Open3D: docs/decisions/ply.md.

Arrays of `landmarks.npz`: `frames`, (M,) int32, one for each of the M points of map_before.ply and map_after.ply, in
their order; `intrinsics`, (4,), fx, fy, cx, cy, pixels; `size`, (2,), width and height, pixels.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from odometry.camera import PinholeCamera
from place_recognition.evaluation.ground_truth_files import read_array
from slam.errors import DataError
from slam.io.files import atomic_writer
from slam.run_result import PointCloud

_REMEDY = "make the run again with: revisit run SOURCE --out DIR"
# Name, data type and number of dimensions of each array.
_ARRAYS = {"frames": ("<i4", 1), "intrinsics": ("<f8", 1), "size": ("<i4", 1)}
_HEADER = """ply
format binary_little_endian 1.0
element vertex {count}
property double x
property double y
property double z
property uchar red
property uchar green
property uchar blue
end_header
"""
_VERTEX = np.dtype([("point", "<f8", 3), ("colour", "u1", 3)])


def write_cloud(path: Path, cloud: PointCloud) -> None:
    """Write points (metres, world frame) with their brightness as grey colour.

    Raises:
        OutputError: the file cannot be written.
    """
    vertices = np.empty(len(cloud.points), dtype=_VERTEX)
    vertices["point"], vertices["colour"] = cloud.points, cloud.grey[:, None]
    with atomic_writer(path, "wb") as file:
        file.write(_HEADER.format(count=len(vertices)).encode() + vertices.tobytes())


def read_cloud(path: Path) -> PointCloud:
    """Read points (metres) and their brightness, the mean of red, green and blue, from a file of `write_cloud`.

    Open3D could read it as well, but it trusts the header, and ends the process if that is damaged.

    Raises:
        DataError: the file is missing, or not a point cloud as a run writes it.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: expected a PLY file, found none: {error.strerror}; check the path") from None
    head, _, body = data.partition(b"end_header\n")
    lines = [line for line in head.split(b"\n") if not line.startswith(b"comment ")]
    count = re.fullmatch(rb"element vertex (\d{1,12})", lines[2]) if len(lines) > 2 else None
    if count is None or b"\n".join(lines) + b"end_header\n" != _HEADER.format(count=int(count[1])).encode():
        raise DataError(f"{path}: expected a PLY file of a run, found another header; export the map again")
    if len(body) != int(count[1]) * _VERTEX.itemsize:
        raise DataError(
            f"{path}: expected {int(count[1])} points of {_VERTEX.itemsize} bytes, found {len(body)} bytes; export the"
            " map again"
        )
    vertices = np.frombuffer(body, _VERTEX)
    if not np.isfinite(vertices["point"]).all():
        raise DataError(f"{path}: expected finite points, found others; export the map again")
    return PointCloud(vertices["point"].copy(), np.rint(vertices["colour"].mean(axis=1)).astype(np.uint8))


@dataclass(frozen=True)
class LandmarkObservers:
    """The frame that observed each landmark, and the camera.

    Attributes:
        frames: index of the frame, (M,).
        intrinsics: fx, fy, cx, cy, (4,), pixels; (0, 0) is the centre of the first pixel.
        size: width and height, (2,), pixels.
    """

    frames: NDArray[np.int32]
    intrinsics: NDArray[np.float64]
    size: NDArray[np.int32]


def write_landmark_observers(path: Path, frames: NDArray[np.int32], camera: PinholeCamera) -> None:
    """Write landmarks.npz.

    Raises:
        OutputError: the file cannot be written.
    """
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float64)
    size = np.array([camera.width, camera.height], np.int32)
    with atomic_writer(path, "wb") as file:
        np.savez_compressed(file, frames=frames, intrinsics=intrinsics, size=size)


def read_landmark_observers(path: Path) -> LandmarkObservers:
    """Read landmarks.npz.

    Raises:
        DataError: the file is missing or damaged.
    """
    try:
        arrays = {name: read_array(path, name) for name in _ARRAYS}
    except ValueError as error:
        raise DataError(f"{path}: expected the observers of a run's landmarks, found {error}; {_REMEDY}") from None
    found = {name: array for name, array in arrays.items() if array is not None}
    if {name: (array.dtype.str, array.ndim) for name, array in found.items()} != _ARRAYS:
        raise DataError(f"{path}: expected the arrays {', '.join(_ARRAYS)}, found others; {_REMEDY}")
    observers = LandmarkObservers(**found)
    if not _is_camera(observers.intrinsics, observers.size) or (observers.frames < 0).any():
        raise DataError(f"{path}: expected a camera, and frames from 0 on, found others; {_REMEDY}")
    return observers


def _is_camera(intrinsics: NDArray[np.float64], size: NDArray[np.int32]) -> bool:
    if intrinsics.shape != (4,) or size.shape != (2,):
        return False
    return bool(np.isfinite(intrinsics).all() and (intrinsics[:2] > 0).all() and (size > 0).all())
