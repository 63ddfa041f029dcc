"""Point clouds as binary PLY files, which every point cloud viewer opens.

Both directions are written here, not by Open3D: docs/decisions/ply.md.
"""

import re
from pathlib import Path

import numpy as np

from slam.errors import DataError
from slam.io.files import atomic_writer
from slam.run_result import PointCloud

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
