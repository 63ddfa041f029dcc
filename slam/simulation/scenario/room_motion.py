"""Motion of a camera through a room: carried by a hand, or on a robot that drives and turns on the spot.

Both follow a tour: stops in the room and the corridor, in a round that is repeated until the time is up, so that places
are seen again. Frame: that of the room, z up, metres.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from slam.simulation.scenario.free_space import STEP_M, FreeSpace, find_free_space
from slam.simulation.scenario.room_config import RoomConfig
from slam.simulation.scenario.vehicle_path import camera_poses

Array = NDArray[np.float64]

MIN_CLEARANCE_M = 0.4  # between camera and everything else
_RATE_HZ = 240.0  # at which motion is computed, whatever the frame rate
_HAND_STOPS, _ROBOT_STOPS = 5, 2  # in the room
# Stops in the corridor, metres along it and away from the door.
_HAND_AIMS, _ROBOT_AIMS = ((0.3, 0.9), (1.7, 1.0)), ((1.3, 1.0),)

# The hand.
_HAND_HEIGHT_M, _HAND_MARGIN_M = 1.5, 0.1  # height of the camera; clearance beyond the minimum, for sway
_BODY_TOP_M = 0.1  # whatever is higher than this is walked around
_MIN_SPEED, _MAX_SPEED = 0.35, 0.85  # metres per second
_MAX_YAW_RATE, _MAX_PITCH_RATE, _MAX_ACCELERATION = 0.85, 0.35, 2.5  # rad/s and rad/s^2
_GAZE_M = 1.8  # way along which one thing is looked at
_RAMP_S = 1.2  # in which the walker stops and starts
_MAX_PITCH = 0.4  # rad

# The robot.
_ROBOT_HEIGHT_M, _ROBOT_PITCH = 0.4, np.radians(8.0)
_ROBOT_FORWARD_M = 0.1  # from the axis of rotation to the camera
_DRIVE_SPEED, _DRIVE_ACCELERATION = 0.6, 0.8
_TURN_RATE, _TURN_ACCELERATION = 1.0, 2.0


@dataclass(frozen=True)
class RoomTrajectory:
    """Poses of the camera, or of the left one.

    Attributes:
        T_room_camera: (N, 4, 4) metres.
        timestamps: (N,) seconds.
    """

    T_room_camera: Array
    timestamps: Array


def plan_room_trajectory(
    config: RoomConfig, floors: Array, obstacles: Array, door: Array, sights: Array
) -> RoomTrajectory:
    """Plan the motion.

    Args:
        config: motion, duration, frame rate and seed.
        floors: (F, 4) rectangles of floor, the room first and the corridor last, metres.
        obstacles: (N, 2, 3) corners of boxes.
        door: (2,) middle of the doorway.
        sights: (S, 3) what is looked at.
    """
    timestamps = np.arange(config.frames) / config.frame_rate_hz
    time = np.arange(int(np.ceil(max(config.duration_s, timestamps[-1]) * _RATE_HZ)) + 2) / _RATE_HZ
    if config.motion == "hand":
        space = find_free_space(floors, obstacles, _BODY_TOP_M, _HAND_HEIGHT_M + 0.3 + MIN_CLEARANCE_M)
        positions, angles = _walk(config, space, _Tour(_HAND_STOPS, _HAND_AIMS, door, sights), time)
    else:
        space = find_free_space(floors, obstacles, 0.02, _ROBOT_HEIGHT_M + MIN_CLEARANCE_M)
        positions, angles = _drive(config, space, _Tour(_ROBOT_STOPS, _ROBOT_AIMS, door, sights), time)
    both = np.column_stack([positions, angles])
    at = np.stack([np.interp(timestamps, time, column) for column in both.T], axis=1)
    return RoomTrajectory(camera_poses(at[:, :3], at[:, 3:]), timestamps)


@dataclass(frozen=True)
class _Tour:
    """Where a tour leads.

    Attributes:
        room_stops: number of stops in the room.
        aims: stops in the corridor, metres along it and away from the door.
        door, sights: as in `plan_room_trajectory`.
    """

    room_stops: int
    aims: tuple[tuple[float, float], ...]
    door: Array
    sights: Array

    def stops(self, space: FreeSpace, min_clearance_m: float, rng: np.random.Generator) -> Array:
        """Stops (S, 2): those in the room in a round, the one next to the door last, then those in the corridor."""
        cells = space.cells(min_clearance_m, self.door)
        wall_y = self.door[1]
        room, corridor = cells[cells[:, 1] < wall_y - 0.5], cells[cells[:, 1] > wall_y + 0.6]
        chosen = [room[int(rng.integers(len(room)))]]
        for _ in range(self.room_stops - 1):
            gaps = np.min([((room - stop) ** 2).sum(axis=1) for stop in chosen], axis=0)
            chosen.append(room[int(np.argmax(gaps))])
        stops = np.array(chosen)
        around = stops - stops.mean(axis=0)
        stops = stops[np.argsort(np.arctan2(around[:, 1], around[:, 0]))]
        stops = np.roll(stops, -int(np.argmin(((stops - self.door) ** 2).sum(axis=1))), axis=0)
        side = 1.0 if rng.random() < 0.5 else -1.0
        aims = self.door + np.array(self.aims) * [side, 1.0]
        outside = [corridor[np.argmin(((corridor - aim) ** 2).sum(axis=1))] for aim in aims]
        return np.vstack([stops[1:], stops[:1], *outside])


def _waves(rng: np.random.Generator, x: Array, period: float, amplitude: float) -> Array:
    """Smooth irregular values (N,) with a standard deviation of `amplitude`, as a sum of three sines of x (N,)."""
    total = np.zeros_like(x)
    for share in (0.6, 1.0, 1.7):
        total += np.sin(2 * np.pi * (x / (period * share * rng.uniform(0.9, 1.1)) + rng.uniform()))
    return total * amplitude * np.sqrt(2 / 3)


def _walk(config: RoomConfig, space: FreeSpace, tour: _Tour, time: Array) -> tuple[Array, Array]:
    """Positions (N, 3) and yaw, pitch, roll (N, 3) of a camera in a hand."""
    rng = config.rng(1)
    keep = MIN_CLEARANCE_M + _HAND_MARGIN_M
    path = space.smooth(np.vstack(space.route(tour.stops(space, keep, rng), keep)), keep)
    length = len(path) * STEP_M
    speed = np.clip(0.6 + _waves(rng, time, 6.0, 0.2), _MIN_SPEED, _MAX_SPEED) * _walking(config, time)
    s = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2 / _RATE_HZ)])
    grid = np.arange(len(path) + 1) * STEP_M
    ahead = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    side = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1) / np.maximum(
        np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9
    )
    # Where the path turns back, left becomes right: there, sway fades out and in again.
    side = gaussian_filter1d(side, 20, axis=0, mode="wrap")
    reach = minimum_filter1d(np.clip(space.clearance_at(path) - keep, 0.0, 0.12), 61, mode="wrap")
    reach = gaussian_filter1d(reach, 15, mode="wrap") + 0.02
    wrapped = np.mod(s, length)

    def at(values: Array) -> Array:
        return np.interp(wrapped, grid, np.append(values, values[0]))

    shift = at(reach) * np.clip(_waves(rng, s, 4.3, 0.4) + 0.15 * np.sin(2 * np.pi * s / 1.4), -1.0, 1.0)
    xy = np.stack([at(path[:, k]) + shift * at(side[:, k]) for k in (0, 1)], axis=1)
    z = _HAND_HEIGHT_M + np.clip(_waves(rng, s, 5.0, 0.09), -0.25, 0.25) + 0.012 * np.sin(2 * np.pi * s / 0.7)
    positions = np.column_stack([xy, z])
    angles = _look(config, space, tour, path, (time, s, positions))
    return positions, angles


def _walking(config: RoomConfig, time: Array) -> Array:
    """Share 0..1 of the speed: 0 while the camera turns only, with ramps before and after."""
    if config.pure_rotation_s == 0:
        return np.ones_like(time)
    start, end = _pure_rotation(config)
    away = np.maximum(start - time, time - end)
    ramp = np.clip(away / _RAMP_S, 0.0, 1.0)
    return ramp * ramp * (3 - 2 * ramp)


def _pure_rotation(config: RoomConfig) -> tuple[float, float]:
    """First and last second of the pure rotation, in the middle of the sequence."""
    start = (config.duration_s - config.pure_rotation_s) / 2
    return start, start + config.pure_rotation_s


def _look(config: RoomConfig, space: FreeSpace, tour: _Tour, path: Array, walk: tuple[Array, Array, Array]) -> Array:
    """Yaw, pitch and roll (N, 3) of somebody who looks from thing to thing, the same things in each round."""
    time, s, positions = walk
    rng = config.rng(2)
    targets = _choose_targets(rng, space, tour.sights, path)
    leg_m = len(path) * STEP_M / len(targets)
    shift = np.column_stack([_waves(rng, time, 3.0, 0.15) for _ in range(3)])
    to = targets[np.int64(s / leg_m) % len(targets)] + shift - positions
    yaw = np.arctan2(to[:, 1], to[:, 0])
    pitch = np.clip(np.arctan2(to[:, 2], np.hypot(to[:, 0], to[:, 1])), -_MAX_PITCH, _MAX_PITCH)
    turning = np.zeros(len(time))
    if config.pure_rotation_s:
        start, end = _pure_rotation(config)
        rate = min(_MAX_YAW_RATE, max(2 * np.pi / max(end - start - 2.0, 1.0), 0.35)) * rng.choice([-1.0, 1.0])
        turning[(time >= start) & (time <= end)] = rate
        pitch = np.where(turning != 0, 0.2 * np.sin(2 * np.pi * (time - start) / 5.0), pitch)
    angles = _follow(yaw, pitch, turning)
    tremble = [_waves(rng, time, 0.25, np.radians(0.06)) for _ in range(3)]
    sway = [_waves(rng, time, 2.2, np.radians(a)) for a in (0.8, 0.8, 1.6)]
    return angles + np.column_stack(tremble) + np.column_stack(sway)


def _choose_targets(rng: np.random.Generator, space: FreeSpace, sights: Array, path: Array) -> Array:
    """Choose what is looked at (G, 3) on each stretch of the path: in sight from its end, not too near."""
    count = max(3, round(len(path) * STEP_M / _GAZE_M))
    targets = []
    for k in range(count):
        at = path[int((k + 0.7) * len(path) / count) % len(path)]
        gap = np.linalg.norm(sights[:, :2] - at, axis=1)
        good = [int(i) for i in np.flatnonzero((gap > 1.4) & (gap < 7.0)) if space.sees(at, sights[i, :2])]
        if not good:
            good = [int(np.argmax(gap))]
        targets.append(sights[good[int(rng.integers(len(good)))]])
    return np.array(targets)


def _follow(yaw: Array, pitch: Array, turning: Array) -> Array:
    """Yaw, pitch and roll 0 (N, 3) of a head that follows directions (N,) with bounded rates and accelerations.

    turning: (N,) rate of yaw, rad/s, where it is given; 0 where the direction is followed.
    """
    out, dt, stiff = np.zeros((len(yaw), 3)), 1.0 / _RATE_HZ, 2.2
    a, b, va, vb = float(yaw[0]), float(pitch[0]), 0.0, 0.0
    for i in range(len(yaw)):
        error = _wrap(float(yaw[i]) - a)
        wanted = float(turning[i]) if turning[i] else min(max(stiff * error, -_MAX_YAW_RATE), _MAX_YAW_RATE)
        va += min(max(6.0 * (wanted - va), -_MAX_ACCELERATION), _MAX_ACCELERATION) * dt
        wanted = min(max(stiff * (float(pitch[i]) - b), -_MAX_PITCH_RATE), _MAX_PITCH_RATE)
        vb += min(max(6.0 * (wanted - vb), -_MAX_ACCELERATION), _MAX_ACCELERATION) * dt
        a, b = a + va * dt, b + vb * dt
        out[i] = a, b, 0.0
    return out


def _drive(config: RoomConfig, space: FreeSpace, tour: _Tour, time: Array) -> tuple[Array, Array]:
    """Positions (N, 3) and yaw, pitch, roll (N, 3) of a camera on a robot."""
    rng = config.rng(1)
    keep = MIN_CLEARANCE_M + _ROBOT_FORWARD_M + 0.03
    stops = tour.stops(space, keep, rng)
    corners, is_stop = _straighten(space, space.route(stops, keep), keep)
    is_stop &= corners[:, 1] < tour.door[1]  # it looks about in the room alone
    x, y, heading = _moves(rng, corners, is_stop, len(time))
    shake = 0.5 * np.radians(0.15)
    moving = np.clip(np.abs(np.gradient(x)) + np.abs(np.gradient(y)), 0, 1e-3) / 1e-3
    moving = gaussian_filter1d(moving, 0.05 * _RATE_HZ)
    pitch = _ROBOT_PITCH + moving * _waves(rng, time, 0.3, shake)
    roll = moving * _waves(rng, time, 0.37, shake)
    z = _ROBOT_HEIGHT_M + moving * _waves(rng, time, 0.3, 0.0006)
    forward = _ROBOT_FORWARD_M * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.column_stack([np.stack([x, y], 1) + forward, z]), np.column_stack([heading, pitch, roll])


def _straighten(space: FreeSpace, legs: list[Array], min_clearance_m: float) -> tuple[Array, NDArray[np.bool_]]:
    """Corners (C, 2) of a closed polygon that keeps the clearance along legs (P, 2), and which of them are stops."""
    corners, is_stop = [], []
    for leg, following in zip(legs, [*legs[1:], legs[0]], strict=True):
        points, at = np.vstack([leg, following[:1]]), 0
        while at < len(leg):
            corners.append(points[at])
            is_stop.append(at == 0)
            ends = (
                last for last in range(len(leg), at + 1, -1) if _is_free(space, points[[at, last]], min_clearance_m)
            )
            at = next(ends, at + 1)
    return np.array(corners), np.array(is_stop)


def _is_free(space: FreeSpace, ends: Array, min_clearance_m: float) -> bool:
    """Whether the straight line between two points (2, 2) keeps the clearance."""
    count = int(np.linalg.norm(ends[1] - ends[0]) / STEP_M) + 2
    line = ends[0] + np.linspace(0.0, 1.0, count)[:, None] * (ends[1] - ends[0])
    return bool(space.clearance_at(line).min() >= min_clearance_m - 0.02)


def _moves(
    rng: np.random.Generator, corners: Array, is_stop: NDArray[np.bool_], count: int
) -> tuple[Array, Array, Array]:
    """x, y and heading (count,) of a robot that goes round the corners; at many stops it looks about."""
    spins = [np.pi / 2, np.pi, 1.5 * np.pi, 2 * np.pi]
    xy, headings, total, k = [np.tile(corners[0], (1, 1))], [np.zeros(1)], 0, 0
    heading = float(np.arctan2(*(corners[1] - corners[0])[::-1]))
    headings[0][:] = heading
    while total < count:
        a, b = corners[k % len(corners)], corners[(k + 1) % len(corners)]
        wanted = float(np.arctan2(*(b - a)[::-1]))
        turn = _wrap(wanted - heading)
        looks = is_stop[k % len(corners)] and k and rng.random() < 0.5
        spin = float(rng.choice(spins)) * (1.0 if turn >= 0 else -1.0) if looks else 0.0
        for angle in (spin, _wrap(wanted - heading - spin)):
            steps = _ramps(abs(angle), _TURN_RATE, _TURN_ACCELERATION) * np.sign(angle)
            headings.append(heading + steps)
            xy.append(np.tile(a, (len(steps), 1)))
            heading += angle
        steps = _ramps(float(np.linalg.norm(b - a)), _DRIVE_SPEED, _DRIVE_ACCELERATION)
        xy.append(a + steps[:, None] * (b - a) / max(float(np.linalg.norm(b - a)), 1e-9))
        headings.append(np.full(len(steps), heading))
        total, k = sum(len(part) for part in headings), k + 1
    places = np.concatenate(xy)[:count]
    return places[:, 0], places[:, 1], np.concatenate(headings)[:count]


def _wrap(angle: float) -> float:
    """The angle between -pi and pi, radians."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _ramps(distance: float, max_speed: float, acceleration: float) -> Array:
    """Distance covered (N,) after each time step, from rest to rest."""
    if distance < 1e-6:
        return np.zeros(0)
    top = min(max_speed, np.sqrt(distance * acceleration))
    ramp, cruise = top / acceleration, distance / top - top / acceleration
    t = np.arange(1, int(np.ceil((2 * ramp + cruise) * _RATE_HZ)) + 1) / _RATE_HZ
    up = 0.5 * acceleration * np.minimum(t, ramp) ** 2
    flat = top * np.clip(t - ramp, 0.0, cruise)
    late = np.clip(t - ramp - cruise, 0.0, ramp)
    return np.asarray(up + flat + top * late - 0.5 * acceleration * late**2)
