"""Writing of the surfaces of submaps as one binary PLY file, with one submap in memory at a time."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from slam.io.files import atomic_writer
from slam.mapping.tsdf import Surface

_POINTS = """ply
format binary_little_endian 1.0
element vertex {points}
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
"""
_TRIANGLES = """element face {triangles}
property list uchar int vertex_indices
"""
_VERTEX = np.dtype([("point", "<f4", 3), ("colour", "u1", 3)])
_FACE = np.dtype([("corners", "u1"), ("triangle", "<i4", 3)])


def write_mesh(path: Path, surfaces: Callable[[], Iterator[Surface]], with_triangles: bool) -> None:
    """Write many surfaces (metres, one frame) as one mesh, or as one point cloud.

    Args:
        path: the file to write.
        surfaces: returns an iterator over all surfaces; called once for their sizes and once for each PLY element.
        with_triangles: whether a mesh is written; else a point cloud.

    Raises:
        OutputError: the file cannot be written.
    """
    sizes = np.array([[len(surface.points), len(surface.triangles)] for surface in surfaces()], dtype=np.int64)
    sizes = sizes.reshape(-1, 2)
    points, triangles = sizes.sum(axis=0).tolist()
    header = _POINTS.format(points=points) + (_TRIANGLES.format(triangles=triangles) if with_triangles else "")
    with atomic_writer(path, "wb") as file:
        file.write(f"{header}end_header\n".encode())
        for surface in surfaces():
            file.write(_vertices(surface))
        if with_triangles:
            starts = np.cumsum(sizes[:, 0]) - sizes[:, 0]
            file.writelines(_faces(surface, start) for start, surface in zip(starts, surfaces(), strict=True))


def _vertices(surface: Surface) -> bytes:
    vertices = np.empty(len(surface.points), dtype=_VERTEX)
    vertices["point"], vertices["colour"] = surface.points, surface.grey[:, None]
    return vertices.tobytes()


def _faces(surface: Surface, start: int) -> bytes:
    faces = np.empty(len(surface.triangles), dtype=_FACE)
    faces["corners"], faces["triangle"] = 3, surface.triangles + start
    return faces.tobytes()
