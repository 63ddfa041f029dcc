"""Clouds as binary PLY, which every point cloud viewer opens."""

import re
from pathlib import Path

import numpy as np

from slam.errors import DataError
from slam.record import PointCloud
from slam.storage.atomic import replacing

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
    """Write points (metres, world frame) with their grey as colour.

    Open3D writes it. Where Open3D cannot be loaded (on a bare server its wheel misses libusb), refuses (no
    points at all) or fails, the same bytes are written here: no run loses its map to that.

    Raises:
        OutputError: the file cannot be written.
    """
    with replacing(path) as temporary:
        if not _write_with_open3d(temporary, cloud):
            _write_plain(temporary, cloud)


def read_cloud(path: Path) -> PointCloud:
    """Read points (metres) and their brightness, the mean of red, green and blue, from a file of `write_cloud`.

    Open3D, which would read it too, trusts the header, and ends the process where that is damaged.

    Raises:
        DataError: missing file, or no point cloud as a run writes it.
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


def _write_with_open3d(path: Path, cloud: PointCloud) -> bool:
    if len(cloud.points) == 0:
        return False
    try:
        import open3d
    except (ImportError, OSError):
        return False
    out = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(cloud.points))
    out.colors = open3d.utility.Vector3dVector(np.repeat(cloud.grey[:, None] / 255.0, 3, axis=1))
    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        done = open3d.io.write_point_cloud(path, out)
    # On a full disk Open3D reports success for half a file.
    return bool(done) and path.stat().st_size > len(cloud.points) * _VERTEX.itemsize


def _write_plain(path: Path, cloud: PointCloud) -> None:
    vertices = np.empty(len(cloud.points), dtype=_VERTEX)
    vertices["point"], vertices["colour"] = cloud.points, cloud.grey[:, None]
    path.write_bytes(_HEADER.format(count=len(vertices)).encode() + vertices.tobytes())
