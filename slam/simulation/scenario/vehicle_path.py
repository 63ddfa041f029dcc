"""The trajectory of a simulated camera: the path of a lap, the path of all laps, and a pose for every frame.

Town frame: x, y on the ground, z up, metres. Paths are polylines sampled every `STEP` metres.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from slam.errors import DataError
from slam.io.files import read_numbers
from slam.simulation.scenario.config import SimulationConfig

Array = NDArray[np.float64]

STEP = 0.25  # metres between the points of a path
LANE = 1.5  # metres from the middle of the street to the middle of the right lane
CAMERA_HEIGHT = 1.65  # metres above the road
_CORNER = 9.0  # radius of the turns between blocks, metres
_TURN = 7.0  # radius in which the car turns round, metres
_BLEND = 30.0  # path length on which a lateral offset grows to its full size, metres
_CURVATURE_WINDOW = 4  # steps over which the curvature of the path is averaged: the radius that a driver sees
_MIN_SPEED_SHARE = 0.15  # of the speed on a straight road, below which no corner slows the car
# Corners of two neighbouring blocks in units of one block's side; three sides are driven twice in a lap.
_BLOCKS = ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1))


@dataclass(frozen=True)
class Polyline:
    """A smooth line on the ground.

    Attributes:
        points: (N, 2) metres, `STEP` apart.
        closed: whether the first point follows the last.
    """

    points: Array
    closed: bool

    @property
    def length_m(self) -> float:
        """Length, of one round where the line is closed."""
        return STEP * (len(self.points) if self.closed else len(self.points) - 1)

    @property
    def headings(self) -> Array:
        """(N,) direction of travel, radians, unwrapped."""
        if self.closed:
            d = np.roll(self.points, -1, axis=0) - np.roll(self.points, 1, axis=0)
        else:
            d = np.gradient(self.points, axis=0)
        return np.unwrap(np.arctan2(d[:, 1], d[:, 0]))

    def interpolate(self, distance_m: Array) -> tuple[Array, Array]:
        """Positions (M, 2) and headings (M,) at distances (M,) along the line.

        Distances beyond the ends of an open line are moved to its ends; those of a closed line wrap around.
        """
        headings = self.headings
        x, y = np.asarray(distance_m) / STEP, self.points
        if self.closed:
            turn = 2 * np.pi * np.round((headings[-1] - headings[0]) / (2 * np.pi))
            y, headings = np.vstack([y, y[:1]]), np.append(headings, headings[0] + turn)
            x = np.mod(x, len(self.points))
        grid = np.arange(len(y))
        return np.stack([np.interp(x, grid, y[:, 0]), np.interp(x, grid, y[:, 1])], 1), np.interp(x, grid, headings)

    def offset(self, left: float) -> "Polyline":
        """Return the parallel line `left` metres to the left, resampled."""
        h = self.headings
        return resample(self.points + left * np.stack([-np.sin(h), np.cos(h)], axis=1), self.closed)


def resample(points: Array, closed: bool) -> Polyline:
    """Return the line through points (N, 2) at equal distances, as close to `STEP` as its length allows."""
    p = np.vstack([points, points[:1]]) if closed else points
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    keep = np.concatenate([[True], np.diff(s) > 1e-9])
    p, s = p[keep], s[keep]
    count = max(2, round(s[-1] / STEP))
    t = np.arange(count + (not closed)) * (s[-1] / count)
    return Polyline(np.stack([np.interp(t, s, p[:, 0]), np.interp(t, s, p[:, 1])], axis=1), closed)


def _scaled(points: Array, length: float) -> Polyline:
    """Return the closed line (N, 2) scaled to a length in metres."""
    loop = np.vstack([points, points[:1]])
    return resample(points * (length / np.linalg.norm(np.diff(loop, axis=0), axis=1).sum()), True)


def _circle(length: float) -> Polyline:
    a = np.linspace(0, 2 * np.pi, round(length / STEP), endpoint=False)
    return _scaled(np.stack([np.sin(a), 1 - np.cos(a)], axis=1), length)


def _figure_eight(length: float) -> Polyline:
    # Lemniscate of Gerono, started at the far end of a lobe.
    a = np.linspace(0, 2 * np.pi, 4 * round(length / STEP), endpoint=False)
    return _scaled(np.stack([np.cos(a), 0.8 * np.sin(2 * a)], axis=1), length)


def _blocks(length: float) -> Polyline:
    # Rounding saves (2 - pi / 2) radii at each turn; two of the ten corners are driven straight through.
    turns = len(_turning(_BLOCKS))
    side = (length + turns * (2 - math.pi / 2) * _CORNER) / len(_BLOCKS)
    return _rounded(np.array(_BLOCKS, dtype=np.float64) * side)


def _turning(corners: tuple[tuple[int, int], ...]) -> list[int]:
    """Corners at which a closed polygon changes direction."""
    p = np.array(corners, dtype=np.float64)
    before, after = p - np.roll(p, 1, axis=0), np.roll(p, -1, axis=0) - p
    return list(np.flatnonzero(np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]) > 0.5))


def _rounded(p: Array) -> Polyline:
    """Round the corners of a closed right-angled polygon (N, 2); start in the middle of its first side."""
    pieces = [(p[:1] + p[1:2]) / 2]
    for i in [*range(1, len(p)), 0]:
        into, out = p[i] - p[i - 1], p[(i + 1) % len(p)] - p[i]
        into, out = into / np.linalg.norm(into), out / np.linalg.norm(out)
        if abs(into @ out) > 0.5:
            continue
        a = np.linspace(0, np.pi / 2, 60)[:, None]
        pieces.append(p[i] + _CORNER * ((out - into) - out * np.cos(a) + into * np.sin(a)))
    return resample(np.vstack(pieces), True)


def read_plan(path: Path) -> Array:
    """Plan positions (N, 2) of a KITTI pose file: town x = its x, town y = its z, metres.

    Raises:
        DataError: it has fewer than 3 lines of 12 numbers, or others.
    """
    rows = read_numbers(path, 12)
    if len(rows) < 3:
        raise DataError(f"{path}: expected at least 3 lines of 12 numbers, found {len(rows)}; use a longer trajectory")
    return rows[:, [3, 11]]


def plan_base_path(config: SimulationConfig) -> Polyline:
    """Return the path of the first lap, along the middle of its lane."""
    if config.from_file:
        plan = read_plan(Path(config.shape))
        return resample(gaussian_filter1d(plan, 1.5, axis=0, mode="nearest"), False)
    return {"circle": _circle, "figure-eight": _figure_eight, "blocks": _blocks}[config.shape](config.length_m)


def plan_full_path(config: SimulationConfig) -> tuple[Polyline, list[float]]:
    """Return the path of all laps, open, and the distance along it at which each lap ends, metres.

    Lateral offsets grow smoothly at the start of a lap. Before a lap in the opposite direction the car turns round in a
    loop.
    """
    base = plan_base_path(config)
    if config.from_file:
        return base, [base.length_m]
    pieces, ends = [base.points], [base.length_m]
    for lap in range(1, config.laps):
        piece = _later_lap(base, config, lap, pieces[-1])
        pieces.append(piece)
        ends.append(ends[-1] + float(np.linalg.norm(np.diff(piece, axis=0), axis=1).sum()))
    return resample(np.vstack(pieces), False), ends


def _later_lap(base: Polyline, config: SimulationConfig, lap: int, before: Array) -> Array:
    """Points (N, 2) of a lap after the first, from the end of the points `before`."""
    back = config.reverse and lap % 2 == 1
    distance_m = np.arange(len(base.points)) * STEP
    # After turning round, the car is as far off its lane to the other side.
    start = 0.0 if lap == 1 else config.lateral_offset_m * (-1 if config.reverse else 1)
    blend = np.clip(distance_m / _BLEND, 0, 1)
    offset = start + (config.lateral_offset_m - start) * blend * blend * (3 - 2 * blend)
    if back:
        # The parallel line in the other lane, from the same point in the opposite direction.
        offset = -(2 * LANE + np.roll(offset[::-1], 1))
    h = base.headings
    points = base.points + offset[:, None] * np.stack([np.sin(h), -np.cos(h)], axis=1)
    if back:
        points = np.roll(points[::-1], 1, axis=0)
    if not config.reverse:
        return points
    heading = np.arctan2(*(before[-1] - before[-2])[::-1])
    return np.vstack([_turn_round(before[-1] + STEP * np.array([np.cos(heading), np.sin(heading)]), heading), points])


def _turn_round(at: Array, heading: float) -> Array:
    """Points (N, 2) of a drop-shaped loop from a pose in the right lane to the opposite pose in the other."""
    reach = np.sqrt(4 * _TURN**2 - (_TURN + LANE) ** 2)
    swing = np.pi / 2 - np.arctan2(_TURN + LANE, reach)
    steps = np.concatenate(
        [np.full(40, -swing / 40), np.full(160, (np.pi + 2 * swing) / 160), np.full(40, -swing / 40)]
    )
    h = np.concatenate([[0.0], np.cumsum(steps)])
    middle = heading + (h[:-1] + h[1:]) / 2
    chord = 2 * _TURN * np.sin(np.abs(steps) / 2)
    return at + np.cumsum(chord[:, None] * np.stack([np.cos(middle), np.sin(middle)], axis=1), axis=0)


@dataclass(frozen=True)
class SimulatedTrajectory:
    """The poses of the left camera, one for each frame.

    Attributes:
        path: path of all laps, open.
        schedule_s: (P,) seconds at which the car passes each point of the path.
        distance_m: (N,) distance along the path.
        lap: (N,) number of the lap, from 0.
        T_town_camera: (N, 4, 4), metres.
        timestamps: (N,) seconds.
    """

    path: Polyline
    schedule_s: Array
    distance_m: Array
    lap: NDArray[np.int64]
    T_town_camera: Array
    timestamps: Array

    def time_at(self, distance_m: Array) -> Array:
        """Seconds at which the car passes distances (M,) along the path; beyond its end as fast as on its last step."""
        beyond = np.maximum(distance_m - self.path.length_m, 0.0) / STEP
        return _interpolate(distance_m, self.schedule_s) + beyond * (self.schedule_s[-1] - self.schedule_s[-2])


def _interpolate(distance_m: Array, values: Array) -> Array:
    """Values (M,) at distances (M,) along a line, from those at its points (P,)."""
    return np.interp(distance_m, np.arange(len(values)) * STEP, values)


def plan_trajectory(config: SimulationConfig) -> SimulatedTrajectory:
    """Place the frames along all laps, as far apart as the car drives between two of them."""
    path, ends = plan_full_path(config)
    schedule_s = _plan_schedule(config, path)
    count = int(np.floor(schedule_s[-1] * config.frame_rate_hz + 0.01)) + 1
    count = min(count, config.max_frames) if config.max_frames else count
    timestamps = np.arange(count) / config.frame_rate_hz
    distance_m = np.interp(timestamps, schedule_s, np.arange(len(schedule_s)) * STEP)
    lap = np.minimum(np.searchsorted(ends, distance_m, side="right"), len(ends) - 1)
    positions, headings = path.interpolate(distance_m)
    sway = _sway(config, count)
    angles = sway[:, :3] + headings[:, None] * [1.0, 0.0, 0.0]
    poses = camera_poses(np.column_stack([positions, CAMERA_HEIGHT + sway[:, 3]]), angles)
    return SimulatedTrajectory(path, schedule_s, distance_m, lap, poses, timestamps)


def _plan_schedule(config: SimulationConfig, path: Polyline) -> Array:
    """Seconds (P,) at which the car passes each point of the path.

    Its speed is bounded by lateral acceleration and yaw rate in corners, by the brakes before a corner and by the
    engine after it.
    """
    limits, straight = config.conditions, config.speed_m_per_s
    turn_per_m = np.abs(uniform_filter1d(np.gradient(path.headings), _CURVATURE_WINDOW, mode="nearest")) / STEP
    turn_per_m = np.maximum(turn_per_m, 1e-9)
    corner = np.minimum(np.sqrt(limits.max_lateral_m_per_s2 / turn_per_m), limits.max_yaw_rad_per_s / turn_per_m)
    squared = np.clip(corner, _MIN_SPEED_SHARE * straight, straight) ** 2
    squared = _limit_growth(squared[::-1], 2 * STEP * limits.max_braking_m_per_s2)[::-1]
    speeds = np.sqrt(_limit_growth(squared, 2 * STEP * limits.max_speeding_m_per_s2))
    return np.concatenate([[0.0], np.cumsum(2 * STEP / (speeds[:-1] + speeds[1:]))])


def _limit_growth(values: Array, step: float) -> Array:
    """Lower values (P,) so that none exceeds the one before it by more than a step."""
    if np.isinf(step):
        return values
    ramp = step * np.arange(len(values))
    return np.minimum.accumulate(values - ramp) + ramp


def _sway(config: SimulationConfig, count: int) -> Array:
    """Yaw, pitch and roll (rad) and height (m) that suspension and road add to a car's motion, (N, 4)."""
    time = np.arange(count) / config.frame_rate_hz
    rng = config.rng(1)
    # (amplitude of yaw, pitch, roll in degrees and height in metres) at body, axle and slow frequencies,
    # hertz.
    bands = (
        (0.15, (0.5, 0.25, 0.35, 0.02)),
        (1.3, (0.1, 0.3, 0.25, 0.015)),
        (3.7, (0.03, 0.09, 0.09, 0.004)),
    )
    sway = np.zeros((count, 4))
    for hertz, amplitude in bands:
        for _ in range(3):
            f = hertz * rng.uniform(0.7, 1.4, 4)
            phase = rng.uniform(0, 2 * np.pi, 4)
            sway += np.array(amplitude) / 2 * np.sin(2 * np.pi * f * time[:, None] + phase)
    sway[:, :3] = np.radians(sway[:, :3])
    return sway


def camera_poses(positions: Array, angles: Array) -> Array:
    """Poses (N, 4, 4), z up, of cameras at positions (N, 3), metres, by yaw, pitch upwards and roll (N, 3), radians."""
    yaw, pitch, roll = angles.T
    zeros = np.zeros_like(yaw)
    forward = np.stack([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)], axis=1)
    level = np.stack([np.sin(yaw), -np.cos(yaw), zeros], axis=1)  # to the right
    below = np.cross(forward, level)
    right = level * np.cos(roll)[:, None] + below * np.sin(roll)[:, None]
    poses = np.tile(np.eye(4), (len(yaw), 1, 1))
    poses[:, :3, 0], poses[:, :3, 1], poses[:, :3, 2] = right, np.cross(forward, right), forward
    poses[:, :3, 3] = positions
    return poses
