"""What can be driven on: a grid in the plane of the ground, as ROS's map_server reads it.

The map frame is that of the poses in the plane: x is the world's z (forward at the start), y its -x (left). White cells
are free: road or pavement was seen there. Black ones are occupied: something stands there at the height of a car. Of
grey ones nothing is known. The convention: http://wiki.ros.org/map_server, "trinary".
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.errors import OutputError
from slam.mapping.submaps import Submap, SubmapStore
from slam.storage.atomic import atomic_writer

Array = NDArray[np.float64]
Cells = NDArray[np.int64]

FREE, OCCUPIED, UNKNOWN = 254, 0, 205  # the grey levels that map_saver writes
_LANE_M, _ROAD_M = 1.5, 4.0  # to either side of the way: surely road, and mostly
_MIN_ROAD_POINTS = 50
_OUTLIER_M = (0.3, 0.15, 0.1)  # of the road's plane, in one fit after the other


@dataclass(frozen=True)
class GridConfig:
    """What counts as free and as occupied.

    Attributes:
        resolution_m: edge of a cell, metres.
        reach_m: points farther from every camera of their submap are left out, metres: there a hill passes for a wall.
        kerb_m: what is less than this above or below the road can be driven on, metres.
        low_m, high_m: heights above the road, metres, between which something is in the way.
        min_points: points in the way that make a cell occupied; fewer may be a mistake of the stereo matching.
    """

    resolution_m: float = 0.2
    reach_m: float = 15.0
    kerb_m: float = 0.25
    low_m: float = 0.3
    high_m: float = 2.0
    min_points: int = 3


@dataclass(frozen=True)
class Grid:
    """Cells of the plane.

    Attributes:
        cells: (H, W) uint8 FREE, OCCUPIED or UNKNOWN; the first row is the one with the largest y.
        resolution_m: edge of a cell, metres.
        origin: (2,) metres, x and y of the lower left corner in the map frame.
    """

    cells: NDArray[np.uint8]
    resolution_m: float
    origin: Array


def draw_grid(store: SubmapStore, T_world_camera: Array, config: GridConfig | None = None) -> Grid:
    """The grid of all submaps on a trajectory (F, 4, 4), metres."""
    config = config or GridConfig()
    free, blocked = [np.zeros((0, 2), np.int64)], [np.zeros((0, 2), np.int64)]
    for submap in store:
        height = _heights(submap, config.reach_m)  # NaN: not known, and neither free nor blocked
        world = submap.surface.moved(T_world_camera[submap.anchor]).points
        cells = np.floor(np.stack([world[:, 2], -world[:, 0]], axis=1) / config.resolution_m).astype(np.int64)
        free.append(np.unique(cells[np.abs(height) < config.kerb_m], axis=0))
        in_the_way = cells[(height > config.low_m) & (height < config.high_m)]
        found, count = np.unique(in_the_way, axis=0, return_counts=True)
        blocked.append(found[count >= config.min_points])
    return _draw(np.concatenate(free), np.concatenate(blocked), config.resolution_m)


def _draw(free: Cells, blocked: Cells, resolution: float) -> Grid:
    """Paint cells (N, 2) with numbers along x and y; what is both free and blocked is blocked."""
    known = np.concatenate([free, blocked])
    low, high = (known.min(axis=0), known.max(axis=0)) if len(known) else (np.zeros(2, int), np.zeros(2, int))
    image = np.full((high - low + 1)[::-1], UNKNOWN, dtype=np.uint8)
    for cells, value in ((free, FREE), (blocked, OCCUPIED)):
        image[high[1] - cells[:, 1], cells[:, 0] - low[0]] = value
    return Grid(image, resolution, low * resolution)


def _heights(submap: Submap, reach: float) -> Array:
    """Height (N,), metres, of a submap's points above the road; NaN where they or the road are too far to tell."""
    points = _seen_from_nearest(submap, reach)
    across, down, ahead = points.T
    lane = np.abs(across) < _LANE_M
    if lane.sum() < _MIN_ROAD_POINTS:
        return np.full(len(points), np.nan)
    plane = np.array([0.0, 0.0, np.nanmedian(down[lane])])
    terms = np.stack([across, ahead, np.ones(len(points))], axis=1)
    for limit in _OUTLIER_M:
        road = (np.abs(across) < _ROAD_M) & (np.abs(down - terms @ plane) < limit)
        plane = np.linalg.lstsq(terms[road], down[road], rcond=None)[0]
    return terms @ plane - down


def _seen_from_nearest(submap: Submap, reach: float) -> Array:
    """Points (N, 3), metres, each in the frame of the camera nearest to it; NaN where none is within reach.

    The road has the same height in all these frames, whatever way it climbs.
    """
    points = submap.surface.points.astype(np.float64)
    nearest, best = np.full_like(points, np.nan), np.full(len(points), reach)
    for T_anchor_camera in submap.T_anchor_camera:
        distance = np.linalg.norm(points - T_anchor_camera[:3, 3], axis=1)
        closer = distance < best
        nearest[closer] = se3.transform(se3.inverse(T_anchor_camera), points[closer])
        best[closer] = distance[closer]
    return nearest


def write_grid(path: Path, grid: Grid) -> None:
    """Write a grid as YAML, and beside it the PNG of the same name.

    Raises:
        OutputError: one of them cannot be written.
    """
    written, png = cv2.imencode(".png", grid.cells)
    if not written:
        raise OutputError(f"{path.with_suffix('.png')}: a grid of {grid.cells.shape} cells is too large for a PNG")
    with atomic_writer(path.with_suffix(".png"), "wb") as image:
        image.write(png.tobytes())
    with atomic_writer(path) as text:
        text.writelines(f"{line}\n" for line in _description(path.with_suffix(".png").name, grid))


def _description(image: str, grid: Grid) -> Iterator[str]:
    x, y = np.round(grid.origin, 6).tolist()
    yield f"image: {image}"
    yield "mode: trinary"
    yield f"resolution: {grid.resolution_m!r}"
    yield f"origin: [{x!r}, {y!r}, 0.0]"
    yield "negate: 0"
    yield "occupied_thresh: 0.65"
    yield "free_thresh: 0.196"
