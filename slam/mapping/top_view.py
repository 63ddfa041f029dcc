"""A map as it is seen from above: of each cell of the plane the highest point."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from slam.mapping.fusion import Surface

Array = NDArray[np.float64]

_LONGER_SIDE = 1200  # cells at most


@dataclass(frozen=True)
class Window:
    """A part of the plane, x to the right and z up.

    Attributes:
        left, top: metres, x of its left edge and z of its upper one.
        cell_m: edge of a cell, metres.
        shape: rows and columns of cells.
    """

    left: float
    top: float
    cell_m: float
    shape: tuple[int, int]

    @classmethod
    def around(cls, positions: Array, margin_m: float, cell_m: float) -> Self:
        """What is within a margin of positions (N, 3), metres; in larger cells where there would be too many."""
        plan = positions[:, [0, 2]]
        low, high = plan.min(axis=0) - margin_m, plan.max(axis=0) + margin_m
        cell = max(cell_m, float((high - low).max()) / _LONGER_SIDE)
        columns, rows = np.ceil((high - low) / cell).astype(int).tolist()
        return cls(float(low[0]), float(high[1]), cell, (rows, columns))

    def cells(self, points: Array) -> NDArray[np.int64]:
        """Row and column (N, 2) of points (N, 3), metres; those of other parts of the plane are out of `shape`."""
        below, right = self.top - points[:, 2], points[:, 0] - self.left
        return np.floor(np.stack([below, right], axis=1) / self.cell_m).astype(np.int64)

    def contains(self, cells: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Which cells (N, 2) are in the window (N,)."""
        return np.asarray(((cells >= 0) & (cells < self.shape)).all(axis=1))


@dataclass(frozen=True)
class TopView:
    """What a bird sees.

    Attributes:
        height: (H, W) metres above the first camera; NaN where there is nothing.
        grey: (H, W) uint8.
    """

    height: NDArray[np.float32]
    grey: NDArray[np.uint8]


def seen_from_above(surfaces: Iterable[Surface], window: Window) -> TopView:
    """Look down on surfaces (metres, world frame), one after the other."""
    height, grey = np.full(window.shape, -np.inf, np.float32), np.zeros(window.shape, np.uint8)
    for surface in surfaces:
        cells, up = window.cells(surface.points.astype(np.float64)), -surface.points[:, 1].astype(np.float32)
        seen = np.flatnonzero(window.contains(cells))
        seen = seen[up[seen] > height[tuple(cells[seen].T)]]
        seen = seen[np.argsort(up[seen], kind="stable")]  # of those in one cell the highest is written last, and stays
        height[tuple(cells[seen].T)], grey[tuple(cells[seen].T)] = up[seen], surface.grey[seen]
    return TopView(np.where(np.isfinite(height), height, np.float32(np.nan)), grey)
