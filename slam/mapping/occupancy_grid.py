"""Occupancy grid of the ground plane, in the file format of ROS's map_server (http://wiki.ros.org/map_server, trinary).

The map frame: x is the world's z (forward at the start), y is the world's -x (left). White cells are free: ground was
seen there. Black cells are occupied: there is an obstacle that stands on it. Grey cells are unknown.

A car has its road below it at all times. A hand or a robot does not show where the floor is, nor what is level: the
surfaces of the map do (`find_floor`).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.errors import OutputError
from slam.io.files import atomic_writer
from slam.mapping.submaps import Submap, SubmapStore
from slam.mapping.tsdf import EMPTY_SURFACE, Surface

Array = NDArray[np.float64]
Cells = NDArray[np.int64]

FREE, OCCUPIED, UNKNOWN = 254, 0, 205  # the grey levels that map_saver writes
# Points within the half width of a lane around the path are road, those within the half width of a road mostly are.
_LANE_HALF_WIDTH_M, _ROAD_HALF_WIDTH_M = 1.5, 4.0
_MIN_ROAD_POINTS = 50
_MAX_RESIDUALS_M = (0.3, 0.15, 0.1)  # of inliers of the road plane, in successive fits
# Level faces lean by less than this, radians, in successive fits: a camera in a hand looks down, or up, by 20 degrees.
_MAX_LEANS_RAD = (0.6, 0.3, 0.1)
_FACE_STEP = 8  # every eighth triangle is enough
_FLOOR_BIN_M = 0.05
_MIN_FLOOR_SHARE = 0.25  # of the most frequent height of level faces below the cameras: tables may be seen more often


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


INDOOR_GRID = OccupancyGridConfig(
    resolution_m=0.05, max_range_m=4.0, max_step_m=0.05, min_obstacle_m=0.1, max_obstacle_m=1.8
)


@dataclass(frozen=True)
class Floor:
    """Where the floor of a room is, and what is level.

    Attributes:
        T_level_world: (4, 4), turns the world so that y points straight down.
        down_m: y of the floor in the level frame, metres; NaN where no floor was seen.
    """

    T_level_world: Array
    down_m: float


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
    return _build(store, T_world_camera, config, lambda submap, _: _heights(submap, config.max_range_m))


def build_floor_grid(store: SubmapStore, T_level_camera: Array, floor: Floor) -> OccupancyGrid:
    """Build the grid of a room on a trajectory (F, 4, 4), metres, in the level frame of its floor."""
    return _build(store, T_level_camera, INDOOR_GRID, lambda _, level: floor.down_m - level[:, 1])


def _build(
    store: SubmapStore, T_world_camera: Array, config: OccupancyGridConfig, heights: Callable[[Submap, Array], Array]
) -> OccupancyGrid:
    """Build a grid by the heights (N,) above the ground of the points of each submap, (N, 3) in the world."""
    free, occupied = [np.zeros((0, 2), np.int64)], [np.zeros((0, 2), np.int64)]
    for submap in store:
        world = submap.surface.transform(T_world_camera[submap.anchor]).points.astype(np.float64)
        height = heights(submap, world)  # NaN: unknown, neither free nor occupied
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


def find_floor(store: SubmapStore, T_world_camera: Array) -> Floor:
    """Find the floor of a room by the level faces of all submaps on a trajectory (F, 4, 4), metres.

    A camera is upright on average, to within the angle at which it looks down. The faces that are level to within
    twice that say exactly what is level; the lowest frequent height of those that face up is the floor.
    """
    positions, down = T_world_camera[:, :3, 3], T_world_camera[:, :3, 1].mean(axis=0)
    faces = [_faces(surface) for surface in chain([EMPTY_SURFACE], store.surfaces_in_world(T_world_camera))]
    centers, normals = (np.concatenate(parts) for parts in zip(*faces, strict=True))
    area = np.linalg.norm(normals, axis=1)
    for lean_rad in _MAX_LEANS_RAD:
        down = down / max(float(np.linalg.norm(down)), 1e-9)
        along = normals @ down
        level = np.abs(along) > np.cos(lean_rad) * area
        if not level.any():
            return Floor(np.eye(4), np.nan)
        down = (np.sign(along[level, None]) * normals[level]).sum(axis=0)
    T_level_world = se3.pose(_turn_to_y(down / np.linalg.norm(down)), np.zeros(3))
    y = se3.transform(T_level_world, centers)[:, 1]
    cameras = float(np.median(se3.transform(T_level_world, positions)[:, 1]))
    floors = level & (along < 0) & (y > cameras)
    if not floors.any():
        return Floor(T_level_world, np.nan)
    bins = np.floor(y[floors] / _FLOOR_BIN_M).astype(np.int64)
    found, which = np.unique(bins, return_inverse=True)
    seen = np.bincount(which, weights=area[floors])
    lowest = found[seen > _MIN_FLOOR_SHARE * seen.max()].max()
    return Floor(T_level_world, float(np.median(y[floors][np.abs(bins - lowest) <= 1])))


def _faces(surface: Surface) -> tuple[Array, Array]:
    """Centres (M, 3) of some triangles, and their normals (M, 3), as long as twice their areas."""
    a, b, c = (surface.points[surface.triangles[::_FACE_STEP, k]].astype(np.float64) for k in range(3))
    return (a + b + c) / 3, np.cross(b - a, c - a)


def _turn_to_y(down: Array) -> Array:
    """The smallest rotation (3, 3) that turns a direction (3,) to the y axis."""
    axis = np.cross(down, [0.0, 1.0, 0.0])
    sine, cosine = float(np.linalg.norm(axis)), float(down[1])
    return se3.exp(np.concatenate([axis / max(sine, 1e-12) * np.arctan2(sine, cosine), np.zeros(3)]))[:3, :3]


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
