"""Builds the ground: carriageway, kerbs, pavements and verges along every street, and lawn between streets."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from slam.simulation.scenario.vehicle_path import LANE, STEP, Polyline, SimulatedTrajectory
from slam.simulation.world import materials as m
from slam.simulation.world.mesh import Mesh, merge_meshes, quads

Array = NDArray[np.float64]

ROAD_HALF = 4.0  # metres from the middle of the street to the kerb
PAVEMENT_END = 6.3  # metres to the garden fences
_VERGE_END = 14.0
_SEGMENT = 24.0  # metres that one texture of the carriageway covers, and length of one mesh
_QUAD = 2.0  # metres of street in one flat piece
# Two passes of the path closer than this, metres, and within 35 degrees of parallel are on one street.
_SAME_STREET = 5.0
_MAX_STREET_ANGLE_RAD = np.radians(35)
_MIN_PATH_GAP = 30.0  # metres along the path: points closer along the path are never two passes of one street
# Lateral bands of one side: from, to (m from the middle), height at both, material, texture tiles per metre.
_BANDS = (
    (ROAD_HALF, ROAD_HALF + 0.02, 0.0, 0.11, m.KERB, 0.5),
    (ROAD_HALF + 0.02, ROAD_HALF + 0.2, 0.11, 0.12, m.KERB, 0.5),
    (ROAD_HALF + 0.2, PAVEMENT_END, 0.12, 0.12, m.PAVEMENT, 0.4),
    (PAVEMENT_END, _VERGE_END, 0.1, 0.1, m.GRASS, 0.35),
)


@dataclass(frozen=True)
class Streets:
    """The street network around a trajectory.

    Attributes:
        points: (S, 2) metres, about `_QUAD` apart, middle of the street.
        headings: (S,) radians.
        joined: (S,) bool, a piece of street runs from this point to the next row.
        route: tree of all points of the camera's path, which must stay free.
    """

    points: Array
    headings: Array
    joined: NDArray[np.bool_]
    route: cKDTree

    def is_clear(self, points: Array, distance: float) -> bool:
        """Whether the path keeps more than `distance`, metres, from all points (N, 2)."""
        return bool(np.min(self.route.query(points)[0]) > distance)


def lay_streets(base: Polyline, trajectory: SimulatedTrajectory) -> Streets:
    """Lay a street along the path of the first lap; where the path passes twice, one street."""
    middle = base.offset(LANE)
    step = round(_QUAD / STEP)
    rows = np.arange(0, len(middle.points), step)
    points, headings = middle.points[rows], middle.headings[rows]
    if middle.closed:
        points, headings = np.vstack([points, points[:1]]), np.append(headings, headings[0])
    new = _first_visits(points, headings)
    joined = new & np.append(new[1:] | True, False)
    joined[-1] = False
    return Streets(points, headings, joined, cKDTree(trajectory.path.points[::2]))


def _first_visits(points: Array, headings: Array) -> NDArray[np.bool_]:
    """Whether each row (N,) is the first on its street."""
    gap = int(_MIN_PATH_GAP / _QUAD)
    pairs = cKDTree(points).query_pairs(_SAME_STREET, output_type="ndarray")
    late = pairs[:, 1] - pairs[:, 0] > gap
    parallel = np.abs(np.cos(headings[pairs[:, 1]] - headings[pairs[:, 0]])) > np.cos(_MAX_STREET_ANGLE_RAD)
    closing = pairs[:, 1] == len(points) - 1
    new = np.ones(len(points), dtype=bool)
    new[pairs[late & parallel & ~closing, 1]] = False
    return new


def ground(streets: Streets, rng: np.random.Generator) -> list[Mesh]:
    """Build all ground: pieces of about one road texture's length, then lawn and turning places."""
    per = int(_SEGMENT / _QUAD)
    pieces = []
    everything = cKDTree(streets.points)
    for first in range(0, len(streets.points) - 1, per):
        rows = np.arange(first, min(first + per, len(streets.points) - 1))
        rows = rows[streets.joined[rows]]
        if len(rows):
            pieces.append(_piece(streets, rows, first, everything, rng))
    return pieces + _lawn(streets) + _turning_places(streets)


def _side(streets: Streets, rows: NDArray[np.int64], lateral: float, height: float) -> Array:
    """Points (N, 3) beside street rows, `lateral` metres to the left."""
    h = streets.headings[rows]
    left = np.stack([-np.sin(h), np.cos(h)], axis=1)
    return np.column_stack([streets.points[rows] + lateral * left, np.full(len(rows), height)])


def _strip(
    streets: Streets, rows: NDArray[np.int64], edges: tuple[float, float], heights: tuple[float, float]
) -> Array:
    """Quads (N, 4, 3) between two lateral offsets, along rows."""
    (a, b), (za, zb) = edges, heights
    corners = (
        _side(streets, rows, a, za), _side(streets, rows, b, zb),
        _side(streets, rows + 1, b, zb), _side(streets, rows + 1, a, za),
    )  # fmt: skip
    return np.stack(corners, axis=1)


def _piece(
    streets: Streets, rows: NDArray[np.int64], first: int, everything: cKDTree, rng: np.random.Generator
) -> Mesh:
    """Build carriageway and both sides of some rows."""
    # Mirrored, and started at any of its three dashes, one texture gives six different pieces.
    v = (rows - first) * _QUAD / _SEGMENT + rng.integers(3) / 3
    step, edge = _QUAD / _SEGMENT, int(rng.integers(2))
    carriageway = _strip(streets, rows, (-ROAD_HALF, ROAD_HALF), (0.0, 0.0))
    carriageway[:, :, 2] -= _sunk(streets, rows)[:, None]
    uv = np.stack(
        [
            np.stack([np.full_like(v, u), v + dv], 1)
            for u, dv in ((edge, 0), (1 - edge, 0), (1 - edge, step), (edge, step))
        ],
        1,
    )
    parts = [quads(carriageway, uv, m.ROAD + int(rng.integers(m.ROADS)), float(rng.uniform(0.75, 1.25)))]
    for band in _BANDS:
        for side in (-1, 1):
            parts.append(_band(streets, rows, band, side, everything))
    return merge_meshes(parts)


def _sunk(streets: Streets, rows: NDArray[np.int64]) -> Array:
    """Depth (N,), metres, by which rows are lowered where they cross an earlier street, which then covers them."""
    gap = int(_MIN_PATH_GAP / _QUAD)
    tree = cKDTree(streets.points)
    near = [tree.query_ball_point(streets.points[row], 2 * ROAD_HALF) for row in rows]
    return np.array([0.012 * any(j < row - gap for j in found) for row, found in zip(rows, near, strict=True)])


def _band(
    streets: Streets,
    rows: NDArray[np.int64],
    band: tuple[float, float, float, float, int, float],
    side: int,
    everything: cKDTree,
) -> Mesh:
    """Build one lateral band on one side, left out where a carriageway or the camera's path runs."""
    a, b, za, zb, material, tiles = band
    corners = _strip(streets, rows, (side * a, side * b), (za, zb))
    # Wide bands are tested at several offsets, narrow ones at their middle.
    probes = np.linspace(0.0, 1.0, max(1, round((b - a) / 2)) + 2)[1:-1]
    at = corners[:, 0, None, :2] + probes[:, None] * (corners[:, 1, None, :2] - corners[:, 0, None, :2])
    street, path = (np.reshape(t.query(at.reshape(-1, 2))[0], (len(rows), -1)) for t in (everything, streets.route))
    keep = (street.min(axis=1) > min(a, ROAD_HALF) - 0.15) & (path.min(axis=1) > 1.6)
    along = rows * _QUAD * tiles
    uv = np.stack(
        [np.stack([np.full(len(rows), u * tiles), along + dv], 1) for u, dv in
         ((a, 0), (b + zb - za, 0), (b + zb - za, _QUAD * tiles), (a, _QUAD * tiles))], axis=1)  # fmt: skip
    return quads(corners[keep], uv[keep], material)


def _tiles_around(points: Array, cell: float, reach: float) -> Array:
    """Lower corners (N, 2) of all cells of a square grid within `reach` of points, metres."""
    own = np.unique(np.floor(points / cell).astype(int), axis=0)
    k = int(np.ceil(reach / cell))
    offsets = np.stack(np.meshgrid(np.arange(-k, k + 1), np.arange(-k, k + 1)), -1).reshape(-1, 2)
    return np.unique((own[:, None] + offsets).reshape(-1, 2), axis=0).astype(np.float64) * cell


def _square(corner: Array, side: float, height: float) -> Array:
    x, y = corner
    return np.array([[x, y, height], [x + side, y, height], [x + side, y + side, height], [x, y + side, height]])


def _lawn(streets: Streets) -> list[Mesh]:
    """Build grass squares under and around everything."""
    side = 40.0
    out = []
    for corner in _tiles_around(streets.points, side, 120.0):
        q = _square(corner, side, -0.04)
        out.append(quads(q[None], q[None, :, :2] * 0.31, m.GRASS, 0.9))
    return out


def _turning_places(streets: Streets) -> list[Mesh]:
    """Build asphalt where the path leaves the street."""
    path = streets.route.data
    off = path[cKDTree(streets.points).query(path)[0] > 2.6]
    if not len(off):
        return []
    squares = np.stack([_square(corner, 2.0, -0.02) for corner in _tiles_around(off, 2.0, 4.0)])
    return [quads(squares, squares[:, :, :2], m.ASPHALT)]
