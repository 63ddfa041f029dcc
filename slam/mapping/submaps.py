"""Finished submaps on disk, and their surfaces as one binary PLY file, with one submap in memory at a time.

Each submap is in the frame of its anchor: a corrected graph moves anchors, no file is rewritten.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.io.files import atomic_writer
from slam.mapping.tsdf import Surface

Array = NDArray[np.float64]

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


@dataclass(frozen=True)
class Submap:
    """The surface that a short part of the recording has seen.

    Attributes:
        anchor: index of the frame whose camera frame the submap is in.
        frames: indices of the fused frames, (K,).
        T_anchor_camera: poses of their cameras, (K, 4, 4), metres.
        surface: fused surface, in the frame of the anchor.
    """

    anchor: int
    frames: NDArray[np.int64]
    T_anchor_camera: Array
    surface: Surface


class SubmapStore:
    """Submaps in a folder, one file each; only one is in memory at a time."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, submap: Submap) -> None:
        """Write one more submap.

        Raises:
            OutputError: the folder cannot be written.
        """
        surface = submap.surface
        with atomic_writer(self._path(self._count), "wb") as file:
            np.savez(
                file,
                anchor=submap.anchor,
                frames=submap.frames,
                T_anchor_camera=submap.T_anchor_camera,
                points=surface.points.astype(np.float32),
                color=surface.color,
                triangles=surface.triangles,
            )
        self._count += 1

    def __iter__(self) -> Iterator[Submap]:
        for index in range(self._count):
            with np.load(self._path(index)) as file:
                surface = Surface(file["points"], file["color"], file["triangles"])
                yield Submap(int(file["anchor"]), file["frames"], file["T_anchor_camera"], surface)

    def surfaces_in_world(self, T_world_camera: Array) -> Iterator[Surface]:
        """Yield each surface in the world frame, given the poses (F, 4, 4), metres, of all frames."""
        for submap in self:
            yield submap.surface.transform(T_world_camera[submap.anchor])

    def _path(self, index: int) -> Path:
        return self._folder / f"{index:06d}.npz"


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
    vertices["point"], vertices["colour"] = surface.points, surface.color
    return vertices.tobytes()


def _faces(surface: Surface, start: int) -> bytes:
    faces = np.empty(len(surface.triangles), dtype=_FACE)
    faces["corners"], faces["triangle"] = 3, surface.triangles + start
    return faces.tobytes()
