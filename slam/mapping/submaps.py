"""Finished submaps on disk, each in the frame of its anchor: a corrected graph moves anchors, no file is rewritten."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.io.files import atomic_writer
from slam.mapping.tsdf import Surface

Array = NDArray[np.float64]


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
                grey=surface.grey,
                triangles=surface.triangles,
            )
        self._count += 1

    def __iter__(self) -> Iterator[Submap]:
        for index in range(self._count):
            with np.load(self._path(index)) as file:
                surface = Surface(file["points"], file["grey"], file["triangles"])
                yield Submap(int(file["anchor"]), file["frames"], file["T_anchor_camera"], surface)

    def surfaces_in_world(self, T_world_camera: Array) -> Iterator[Surface]:
        """Yield each surface in the world frame, given the poses (F, 4, 4), metres, of all frames."""
        for submap in self:
            yield submap.surface.transform(T_world_camera[submap.anchor])

    def _path(self, index: int) -> Path:
        return self._folder / f"{index:06d}.npz"
