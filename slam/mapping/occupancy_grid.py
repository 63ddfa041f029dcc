"""Occupancy grid of the ground plane, in the file format of ROS's map_server (http://wiki.ros.org/map_server, trinary).

The map frame: x is the world's z (forward at the start), y is the world's -x (left). White cells are free: road or
pavement was seen there. Black cells are occupied: there is an obstacle at the height of a car. Grey cells are unknown.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.errors import OutputError
from slam.io.files import atomic_writer
from slam.mapping.submaps import Submap, SubmapStore

Array = NDArray[np.float64]
Cells = NDArray[np.int64]

FREE, OCCUPIED, UNKNOWN = 254, 0, 205  # the grey levels that map_saver writes
# Points within the half width of a lane around the path are road, those within the half width of a road mostly are.
_LANE_HALF_WIDTH_M, _ROAD_HALF_WIDTH_M = 1.5, 4.0
_MIN_ROAD_POINTS = 50
_MAX_RESIDUALS_M = (0.3, 0.15, 0.1)  # of inliers of the road plane, in successive fits


@dataclass(frozen=True)
class OccupancyGridConfig:
    """Rules for free and occupied cells.

    Attributes:
        resolution_m: edge of a cell, metres.
        max_range_m: maximum distance of a point from the nearest camera of its submap, metres; farther away a hill
            would look like a wall.
        max_step_m: maximum height above or depth below the road of a surface that can be driven on, metres.
        min_obstacle_m, max_obstacle_m: range of heights above the road of obstacles, metres.
        min_points: minimum number of obstacle points of an occupied cell; fewer may be errors of stereo matching.
    """

    resolution_m: float = 0.2
    max_range_m: float = 15.0
    max_step_m: float = 0.25
    min_obstacle_m: float = 0.3
    max_obstacle_m: float = 2.0
    min_points: int = 3


@dataclass(frozen=True)
class OccupancyGrid:
    """An occupancy grid.

    Attributes:
        cells: FREE, OCCUPIED or UNKNOWN, (H, W) uint8; the first row has the largest y.
        resolution_m: edge of a cell, metres.
        origin: x and y of the lower left corner in the map frame, (2,), metres.
    """

    cells: NDArray[np.uint8]
    resolution_m: float
    origin: Array


def build_occupancy_grid(
    store: SubmapStore, T_world_camera: Array, config: OccupancyGridConfig | None = None
) -> OccupancyGrid:
    """Build the grid of all submaps on a trajectory (F, 4, 4), metres."""
    config = config or OccupancyGridConfig()
    free, occupied = [np.zeros((0, 2), np.int64)], [np.zeros((0, 2), np.int64)]
    for submap in store:
        height = _heights(submap, config.max_range_m)  # NaN: unknown, neither free nor occupied
        world = submap.surface.transform(T_world_camera[submap.anchor]).points
        cells = np.floor(np.stack([world[:, 2], -world[:, 0]], axis=1) / config.resolution_m).astype(np.int64)
        free.append(np.unique(cells[np.abs(height) < config.max_step_m], axis=0))
        obstacles = cells[(height > config.min_obstacle_m) & (height < config.max_obstacle_m)]
        found, count = np.unique(obstacles, axis=0, return_counts=True)
        occupied.append(found[count >= config.min_points])
    return _paint_cells(np.concatenate(free), np.concatenate(occupied), config.resolution_m)


def _paint_cells(free: Cells, occupied: Cells, resolution: float) -> OccupancyGrid:
    """Make a grid of cells (N, 2), indices along x and y; cells that are both free and occupied are occupied."""
    known = np.concatenate([free, occupied])
    low, high = (known.min(axis=0), known.max(axis=0)) if len(known) else (np.zeros(2, int), np.zeros(2, int))
    image = np.full((high - low + 1)[::-1], UNKNOWN, dtype=np.uint8)
    for cells, value in ((free, FREE), (occupied, OCCUPIED)):
        image[high[1] - cells[:, 1], cells[:, 0] - low[0]] = value
    return OccupancyGrid(image, resolution, low * resolution)


def _heights(submap: Submap, max_range_m: float) -> Array:
    """Return the height (N,), metres, of a submap's points above the road; NaN for far points, or without a road."""
    points = _points_in_nearest_camera(submap, max_range_m)
    across, down, ahead = points.T
    lane = np.abs(across) < _LANE_HALF_WIDTH_M
    if lane.sum() < _MIN_ROAD_POINTS:
        return np.full(len(points), np.nan)
    plane = np.array([0.0, 0.0, np.nanmedian(down[lane])])
    terms = np.stack([across, ahead, np.ones(len(points))], axis=1)
    for limit in _MAX_RESIDUALS_M:
        road = (np.abs(across) < _ROAD_HALF_WIDTH_M) & (np.abs(down - terms @ plane) < limit)
        plane = np.linalg.lstsq(terms[road], down[road], rcond=None)[0]
    return terms @ plane - down


def _points_in_nearest_camera(submap: Submap, max_range_m: float) -> Array:
    """Return the points (N, 3), metres, each in the frame of its nearest camera; NaN if that is too far away.

    The road has the same height in all camera frames, even where it climbs.
    """
    points = submap.surface.points.astype(np.float64)
    nearest, best = np.full_like(points, np.nan), np.full(len(points), max_range_m)
    for T_anchor_camera in submap.T_anchor_camera:
        distance = np.linalg.norm(points - T_anchor_camera[:3, 3], axis=1)
        closer = distance < best
        nearest[closer] = se3.transform(se3.inverse(T_anchor_camera), points[closer])
        best[closer] = distance[closer]
    return nearest


def write_occupancy_grid(path: Path, grid: OccupancyGrid) -> None:
    """Write a grid as a YAML file and a PNG of the same name beside it.

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


def _description(image: str, grid: OccupancyGrid) -> Iterator[str]:
    x, y = np.round(grid.origin, 6).tolist()
    yield f"image: {image}"
    yield "mode: trinary"
    yield f"resolution: {grid.resolution_m!r}"
    yield f"origin: [{x!r}, {y!r}, 0.0]"
    yield "negate: 0"
    yield "occupied_thresh: 0.65"
    yield "free_thresh: 0.196"
