"""Cars and traffic: extruded side outlines with glass, wheels, lamps and number plates, and where they drive.

A car stands on the origin, x forward, y left, z up, metres. Moving cars are oncoming ones in the other lane, and one
that drives ahead for a while.
"""

import numpy as np
from numpy.typing import NDArray

from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.scenario.vehicle_path import LANE, SimulatedTrajectory
from slam.simulation.world import materials as m
from slam.simulation.world.mesh import Mesh, boxes, merge_meshes, panel, quads, triangles

Array = NDArray[np.float64]

# Outlines (x, z) of body and cabin from the front bumper backwards over the roof.
_BODIES = {
    "saloon": (
        [(2.2, 0.3), (2.25, 0.6), (2.1, 0.78), (0.95, 0.95), (-1.45, 0.98), (-2.2, 0.92), (-2.25, 0.35)],
        [(1.0, 0.95), (0.3, 1.42), (-0.9, 1.42), (-1.65, 0.97)],
    ),
    "hatchback": (
        [(1.9, 0.3), (1.95, 0.6), (1.75, 0.8), (0.95, 0.98), (-1.7, 1.0), (-1.85, 0.9), (-1.85, 0.35)],
        [(1.0, 0.97), (0.35, 1.48), (-1.3, 1.48), (-1.75, 1.0)],
    ),
    "estate": (
        [(2.2, 0.3), (2.25, 0.62), (2.05, 0.82), (0.95, 1.0), (-2.15, 1.02), (-2.25, 0.9), (-2.25, 0.35)],
        [(1.05, 0.98), (0.35, 1.5), (-1.85, 1.52), (-2.2, 1.02)],
    ),
    "van": ([(2.3, 0.35), (2.35, 0.8), (1.9, 1.15), (1.3, 1.25), (-2.4, 1.3), (-2.4, 0.4)],
            [(1.9, 1.15), (1.1, 2.0), (-2.35, 2.05), (-2.4, 1.3)]),
}  # fmt: skip
CAR_TYPES = tuple(_BODIES)
_HALF_WIDTH_M = 0.87
_MAX_DISTANCE_M = 140.0  # along the path: cars farther away are not drawn
_LAP_M = 360.0  # path length to which `cars_per_360m` refers
_LEAD_M = 120.0  # a car drives ahead on every second stretch of this length


def car(car_type: str, paint: float) -> Mesh:
    """Build a car of one of `CAR_TYPES`; paint is the brightness factor of its body."""
    body, cabin = (np.array(line) for line in _BODIES[car_type])
    cabin_low, cabin_high = _HALF_WIDTH_M - 0.03, _HALF_WIDTH_M - 0.17
    across = np.interp(cabin[:, 1], [1.0, cabin[:, 1].max()], [cabin_low, cabin_high])
    parts = [
        _extrude(body, np.full(len(body), _HALF_WIDTH_M), m.PAINT, paint),
        _extrude(cabin, across, m.PAINT, paint),
    ]
    parts.append(_windows(cabin, across, car_type))
    parts += [_wheel(x, side) for x in (body[:, 0].max() - 0.85, body[:, 0].min() + 0.8) for side in (-1, 1)]
    parts += _ends(body)
    shade = panel([-2.1, -0.85, 0.03], [4.2, 0, 0], [0, 1.7, 0], m.RUBBER, np.array([0, 0, 1, 1]), 0.08)
    return merge_meshes([*parts, shade])


def _extrude(outline: Array, half_width: Array, material: int, tint: float) -> Mesh:
    """Build the outline (N, 2) extruded from -half_width to half_width (N,), with both sides closed."""
    left = np.column_stack([outline[:, 0], half_width, outline[:, 1]])
    right = left * [1, -1, 1]
    across = np.stack([left[:-1], left[1:], right[1:], right[:-1]], axis=1)
    skin = quads(across, across[:, :, :2], material, tint)
    sides = [skin]
    for edge in (left, right):
        middle = edge.mean(axis=0)
        ring = np.roll(edge, -1, axis=0)
        fan = np.stack([edge, ring, np.broadcast_to(middle, edge.shape)], axis=1)
        sides.append(triangles(fan, fan[:, :, [0, 2]], material, tint))
    return merge_meshes(sides)


def _windows(cabin: Array, across: Array, car_type: str) -> Mesh:
    """Windscreen, rear window and side windows, 1.5 cm before the cabin's skin."""
    (x0, z0), (x1, z1), (x2, z2), (x3, z3) = cabin
    parts = []
    for a, b in ((0, 1), (3, 2)):
        low, high = cabin[a], cabin[b]
        out = 0.015 if a == 0 else -0.015
        ends = [(low, across[a] - 0.1, 0.12), (high, across[b] - 0.08, 0.88)]
        (pl, yl), (ph, yh) = ((low + (high - low) * t, y) for _, y, t in ends)
        corner = [
            [pl[0] + out, -yl, pl[1]],
            [pl[0] + out, yl, pl[1]],
            [ph[0] + out, yh, ph[1]],
            [ph[0] + out, -yh, ph[1]],
        ]
        parts.append(quads(np.array([corner]), np.zeros((1, 4, 2)), m.GLASS, 0.1))
    panes = [(0.12, 0.48), (0.53, 0.88)] if car_type != "van" else [(0.05, 0.3)]
    for start, end in panes:
        for side in (-1, 1):
            low = [x0 + (x3 - x0) * t for t in (start, end)]
            high = [x1 + (x2 - x1) * t for t in (start, end)]
            yl, yh = side * (across[0] - 0.01), side * (across[1] + 0.03)
            zl, zh = max(z0, z3) + 0.06, min(z1, z2) - 0.07
            corner = [[low[0], yl, zl], [low[1], yl, zl], [high[1], yh, zh], [high[0], yh, zh]]
            parts.append(quads(np.array([corner]), np.zeros((1, 4, 2)), m.GLASS, 0.1))
    return merge_meshes(parts)


def _wheel(x: float, side: int) -> Mesh:
    """Tyre and rim as discs on the car's side."""
    a = np.linspace(0, 2 * np.pi, 13)
    parts = []
    for radius, out, material, tint in (
        (0.32, 0.012, m.RUBBER, 0.12),
        (0.2, 0.02, m.METAL, 0.8),
        (0.06, 0.03, m.RUBBER, 0.3),
    ):
        ring = np.stack(
            [x + radius * np.cos(a), np.full_like(a, side * (_HALF_WIDTH_M + out)), 0.32 + radius * np.sin(a)],
            1,
        )
        centre = np.broadcast_to([x, side * (_HALF_WIDTH_M + out), 0.32], (12, 3))
        fan = np.stack([ring[:-1], ring[1:], centre], axis=1)
        parts.append(triangles(fan, fan[:, :, [0, 2]], material, tint))
    return merge_meshes(parts)


def _ends(body: Array) -> list[Mesh]:
    """Lamps, plates and grilles at both ends."""
    front, back = body[:, 0].max() + 0.012, body[:, 0].min() - 0.012
    flat = np.array([0.0, 0.0, 1.0, 1.0])
    parts = []
    for x, lamp in ((front, 1.3), (back, 0.5)):
        parts += [panel([x, y, 0.6], [0, 0.32, 0], [0, 0, 0.15], m.LAMP, flat, lamp) for y in (-0.8, 0.48)]
        parts.append(panel([x, -0.26, 0.42], [0, 0.52, 0], [0, 0, 0.11], m.LAMP, flat, 1.4))
    parts.append(panel([front, -0.42, 0.56], [0, 0.84, 0], [0, 0, 0.14], m.RUBBER, flat, 0.15))
    return parts


def fleet(rng: np.random.Generator, count: int = 14) -> list[Mesh]:
    """Cars of all kinds and shades, dark ones and light ones."""
    shades = rng.permutation(
        np.concatenate([rng.uniform(0.05, 0.25, count // 2), rng.uniform(0.6, 1.5, count - count // 2)])
    )
    return [car(CAR_TYPES[i % len(CAR_TYPES)], float(shade)) for i, shade in enumerate(shades)]


def bin_and_box(rng: np.random.Generator) -> Mesh:
    """Build a dust bin and a grey cabinet on the pavement."""
    cabinet = boxes(np.array([[0.8, 0.0, 0.0]]), np.array([[1.9, 0.4, 1.1]]), m.METAL, float(rng.uniform(0.6, 1.2)))
    return merge_meshes([boxes(np.array([[0, 0, 0]]), np.array([[0.55, 0.6, 1.05]]), m.PAINT, 0.25), cabinet])


class Traffic:
    """All moving cars of a dataset as functions of time."""

    def __init__(self, config: SimulationConfig, trajectory: SimulatedTrajectory, cars: list[Mesh]) -> None:
        """Draw the meeting point, the speed and the kind of each car at random."""
        rng = config.rng(13)
        count = round(config.cars_per_360m * trajectory.path.length_m / _LAP_M)
        self.trajectory, self.cars = trajectory, cars
        self.meeting_m = rng.uniform(0.0, max(trajectory.path.length_m, _LAP_M), count)
        self.meeting_s = trajectory.time_at(self.meeting_m)
        self.speeds_m_per_s = config.speed_m_per_s * rng.uniform(0.6, 1.3, count)
        self.kinds = rng.integers(0, len(cars), count + 1)

    def meshes_at(self, frame: int) -> list[Mesh]:
        """Return the cars around the camera at a frame, in the town frame."""
        distance_m = float(self.trajectory.distance_m[frame])
        time = float(self.trajectory.timestamps[frame])
        # An oncoming car is at its meeting point at the moment when the camera is there.
        places = self.meeting_m - self.speeds_m_per_s * (time - self.meeting_s)
        visible = np.flatnonzero((np.abs(places - distance_m) < _MAX_DISTANCE_M) & self._is_on_path(places))
        out = [self._car_at(self.kinds[i], float(places[i]), 2 * LANE + 0.1, np.pi) for i in visible]
        if len(self.meeting_m) and distance_m % (2 * _LEAD_M) < _LEAD_M:
            ahead = distance_m + _lead(distance_m)
            if ahead <= self.trajectory.path.length_m:
                out.append(self._car_at(self.kinds[-1], ahead, 0.1, 0.0))
        return out

    def _is_on_path(self, distance_m: Array) -> NDArray[np.bool_]:
        """Whether distances (M,) are on the path: at its ends all cars would stand in one place."""
        return (distance_m >= 0.0) & (distance_m <= self.trajectory.path.length_m)

    def _car_at(self, car: int, distance_m: float, left_m: float, yaw: float) -> Mesh:
        position, heading = self.trajectory.path.interpolate(np.array([distance_m]))
        side = np.array([-np.sin(heading[0]), np.cos(heading[0])])
        return self.cars[car].transform(heading[0] + yaw, np.array([*(position[0] + left_m * side), 0.01]))


def _lead(distance_m: float) -> float:
    """Distance, metres, that the car ahead keeps from the camera, which is some distance along the path."""
    leaving = max(0.0, distance_m % (2 * _LEAD_M) - 0.7 * _LEAD_M)
    return float(16.0 + 9.0 * np.sin(distance_m / 25.0) + 30.0 * leaving / _LEAD_M)
