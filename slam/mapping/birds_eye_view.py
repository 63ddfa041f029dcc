"""Bird's eye view of a map: the height and colour of the highest point in each cell of the ground plane."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from slam.mapping.tsdf import Surface

Array = NDArray[np.float64]

_MAX_SIDE_CELLS = 1200


@dataclass(frozen=True)
class PlaneWindow:
    """A rectangle of the ground plane, divided into cells; x points right and z up.

    Attributes:
        left, top: x of its left edge and z of its upper edge, metres.
        cell_m: edge of a cell, metres.
        shape: numbers of rows and columns.
    """

    left: float
    top: float
    cell_m: float
    shape: tuple[int, int]

    @classmethod
    def around(cls, positions: Array, margin_m: float, cell_m: float) -> Self:
        """Return the window around positions (N, 3), metres, with a margin; large ones have larger cells."""
        plan = positions[:, [0, 2]]
        low, high = plan.min(axis=0) - margin_m, plan.max(axis=0) + margin_m
        cell = max(cell_m, float((high - low).max()) / _MAX_SIDE_CELLS)
        columns, rows = np.ceil((high - low) / cell).astype(int).tolist()
        return cls(float(low[0]), float(high[1]), cell, (rows, columns))

    def cells(self, points: Array) -> NDArray[np.int64]:
        """Return row and column (N, 2) of points (N, 3), metres; outside of `shape` for points outside the window."""
        below, right = self.top - points[:, 2], points[:, 0] - self.left
        return np.floor(np.stack([below, right], axis=1) / self.cell_m).astype(np.int64)

    def contains(self, cells: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which cells (N, 2) are in the window, (N,) bool."""
        return np.asarray(((cells >= 0) & (cells < self.shape)).all(axis=1))


@dataclass(frozen=True)
class BirdsEyeView:
    """A map seen from above.

    Attributes:
        height: height above the first camera, (H, W), metres; NaN in empty cells.
        color: (H, W, 3) uint8, red first; three equal values where the images are grey.
    """

    height: NDArray[np.float32]
    color: NDArray[np.uint8]


def render_birds_eye_view(
    surfaces: Iterable[Surface], window: PlaneWindow, max_height_m: float = np.inf
) -> BirdsEyeView:
    """Render surfaces (metres, world frame) from above, one after the other, without what is above a height."""
    height, color = np.full(window.shape, -np.inf, np.float32), np.zeros((*window.shape, 3), np.uint8)
    for surface in surfaces:
        cells, up = window.cells(surface.points.astype(np.float64)), -surface.points[:, 1].astype(np.float32)
        seen = np.flatnonzero(window.contains(cells) & (up <= max_height_m))
        seen = seen[up[seen] > height[tuple(cells[seen].T)]]
        seen = seen[np.argsort(up[seen], kind="stable")]  # within a cell the highest is written last
        height[tuple(cells[seen].T)], color[tuple(cells[seen].T)] = up[seen], surface.color[seen]
    return BirdsEyeView(np.where(np.isfinite(height), height, np.float32(np.nan)), color)
