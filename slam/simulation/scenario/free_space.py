"""Where a camera may move in a room: clearance from everything, and paths that keep away from it.

Grids have cells of `CELL_M`; index 0 is y, index 1 is x.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter1d, map_coordinates
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

Array = NDArray[np.float64]

CELL_M = 0.05
STEP_M = 0.02  # between the points of a smoothed path
_SMOOTHING_M = (0.3, 0.2, 0.12, 0.06, 0.0)  # of paths, the first that keeps the clearance
_NEIGHBOURS = ((0, 1), (1, 0), (1, 1), (1, -1))


@dataclass(frozen=True)
class FreeSpace:
    """Floor of a room on which a camera may move.

    Attributes:
        origin: (2,) middle of the first cell, metres.
        clearance_m: (Y, X) distance from each cell to the nearest obstacle or wall, to a cell's width.
        is_floor: (Y, X) whether there is floor, with or without furniture.
    """

    origin: Array
    clearance_m: Array
    is_floor: NDArray[np.bool_]

    def clearance_at(self, points: Array) -> Array:
        """Clearance (N,) at points (N, 2), metres, between cells by interpolation."""
        index = ((points - self.origin) / CELL_M)[:, ::-1].T
        return np.asarray(map_coordinates(self.clearance_m, index, order=1, mode="nearest"))

    def sees(self, a: Array, b: Array) -> bool:
        """Whether no wall stands between two points (2,) on the floor."""
        count = int(np.linalg.norm(b - a) / CELL_M) + 2
        points = a + np.linspace(0.0, 0.97, count)[:, None] * (b - a)
        index = np.rint((points - self.origin) / CELL_M).astype(int)
        index = index.clip(0, np.array(self.is_floor.shape)[::-1] - 1)
        return bool(self.is_floor[index[:, 1], index[:, 0]].all())

    def cells(self, min_clearance_m: float, start: Array) -> Array:
        """Points (M, 2) of the cells with a clearance that can be reached from `start` (2,)."""
        usable = self.clearance_m >= min_clearance_m
        _, label = connected_components(self._graph(usable, min_clearance_m), directed=False)
        usable_at = np.flatnonzero(usable)
        points = self._points(usable_at)
        nearest = usable_at[np.argmin(((points - start) ** 2).sum(axis=1))]
        return points[label[usable_at] == label[nearest]]

    def route(self, stops: Array, min_clearance_m: float) -> list[Array]:
        """Paths (P, 2), metres, from each of the stops (S, 2) to the next, and from the last to the first.

        They keep a clearance. Each ends before the next one begins.
        """
        usable = self.clearance_m >= min_clearance_m
        graph = self._graph(usable, min_clearance_m)
        index = [self._nearest(stop, usable) for stop in stops]
        _, before = dijkstra(graph, directed=False, indices=index, return_predecessors=True)
        legs = []
        for k, end in enumerate(np.roll(index, -1)):
            leg = [int(end)]
            while leg[-1] != index[k]:
                leg.append(int(before[k, leg[-1]]))
            legs.append(self._points(np.array(leg[:0:-1], dtype=np.int64)))
        return legs

    def smooth(self, path: Array, min_clearance_m: float) -> Array:
        """Return a closed path (P, 2), resampled to about 2 cm and rounded as far as its clearance allows."""
        loop = np.vstack([path, path[:1]])
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(loop, axis=0), axis=1))])
        at = np.arange(0.0, s[-1], STEP_M)
        fine = np.stack([np.interp(at, s, loop[:, k]) for k in (0, 1)], axis=1)
        for sigma in _SMOOTHING_M:
            smooth = gaussian_filter1d(fine, sigma / STEP_M, axis=0, mode="wrap") if sigma else fine
            if self.clearance_at(smooth).min() >= min_clearance_m - 0.02:
                break
        return np.asarray(smooth)

    def _graph(self, usable: NDArray[np.bool_], min_clearance_m: float) -> coo_matrix:
        """Edges between neighbouring usable cells; steps near obstacles are longer, so that paths keep away."""
        number = np.arange(usable.size).reshape(usable.shape)
        cost = CELL_M * (1.0 + 0.15 / (self.clearance_m - min_clearance_m + 0.05))
        rows, columns, values = [], [], []
        height, width = usable.shape
        for dy, dx in _NEIGHBOURS:
            a = (slice(0, height - dy), slice(max(0, -dx), width - max(0, dx)))
            b = (slice(dy, height), slice(max(0, dx), width - max(0, -dx)))
            both = usable[a] & usable[b]
            rows.append(number[a][both])
            columns.append(number[b][both])
            values.append(np.hypot(dx, dy) * (cost[a][both] + cost[b][both]) / 2)
        return coo_matrix(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (usable.size, usable.size)
        ).tocsr()

    def _points(self, index: NDArray[np.int64]) -> Array:
        y, x = np.unravel_index(index, self.clearance_m.shape)
        return np.asarray(self.origin + CELL_M * np.stack([x, y], axis=1))

    def _nearest(self, point: Array, usable: NDArray[np.bool_]) -> int:
        candidates = np.flatnonzero(usable)
        return int(candidates[np.argmin(((self._points(candidates) - point) ** 2).sum(axis=1))])


def find_free_space(floors: Array, obstacles: Array, low_z: float, high_z: float) -> FreeSpace:
    """Find where a camera may move.

    Args:
        floors: (F, 4) rectangles of floor: low x, low y, high x, high y, metres.
        obstacles: (N, 2, 3) low and high corners of boxes, metres.
        low_z: height, metres, below which nothing is in the way.
        high_z: height, metres, above which nothing is in the way.
    """
    origin = floors[:, :2].min(axis=0) - CELL_M
    shape = (np.ceil((floors[:, 2:].max(axis=0) + CELL_M - origin) / CELL_M).astype(int) + 1)[::-1]
    x, y = origin[0] + CELL_M * np.arange(shape[1]), origin[1] + CELL_M * np.arange(shape[0])
    is_floor = np.zeros(shape, bool)
    for x0, y0, x1, y1 in floors:
        is_floor |= ((y >= y0) & (y <= y1))[:, None] & ((x >= x0) & (x <= x1))[None, :]
    free = is_floor.copy()
    for (x0, y0, z0), (x1, y1, z1) in obstacles:
        if z0 < high_z and z1 > low_z:
            free &= ~(
                ((y >= y0 - CELL_M) & (y <= y1 + CELL_M))[:, None] & ((x >= x0 - CELL_M) & (x <= x1 + CELL_M))[None, :]
            )
    return FreeSpace(origin, distance_transform_edt(free, CELL_M) - CELL_M / 2, is_floor)
