"""Builds the town around a trajectory: places all meshes, and keeps the path of the camera free."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.scenario.vehicle_path import SimulatedTrajectory, plan_base_path
from slam.simulation.world import street_objects, vehicles
from slam.simulation.world.buildings import build_house, draw_house
from slam.simulation.world.mesh import Mesh
from slam.simulation.world.streets import PAVEMENT_END, ROAD_HALF, Streets, ground, lay_streets

Array = NDArray[np.float64]

# Starts of the two streets with the same plots under `perceptual_aliasing`, and their length, in shares of the path:
# a tenth is one side of a block.
_TWIN_STARTS, _TWIN_LENGTH = (0.1, 0.5), 0.1
_MAX_PLOT_ROWS = 10  # rows of the widest plot
_CLEARANCE_M = 1.35  # kept free on both sides of the path


@dataclass(frozen=True)
class PlacedMesh:
    """A mesh with its pose in the town.

    Attributes:
        mesh: triangles in a frame of their own; several objects may share them.
        yaw: rotation about the vertical, radians, counter-clockwise seen from above.
        position: (x, y, z) of the mesh's origin in the town frame, metres.
        scale: factor on the size.
        tint: factor on the brightness.
    """

    mesh: Mesh
    yaw: float = 0.0
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: float = 1.0
    tint: float = 1.0

    def to_town_frame(self) -> Mesh:
        """Return the triangles in the town frame."""
        return self.mesh.transform(self.yaw, np.array(self.position), self.scale).scale_brightness(self.tint)


@dataclass
class _Plots:
    """The square metres that are built on already, so that no two objects intersect."""

    taken: set[tuple[int, int]] = field(default_factory=set)

    def take(self, points: Array) -> bool:
        """Claim the square metres of points (N, 2); False, claiming nothing, if one is taken."""
        cells = {(int(x), int(y)) for x, y in np.floor(points)}
        if cells & self.taken:
            return False
        self.taken |= cells
        return True


@dataclass(frozen=True)
class _Site:
    """A frame beside the street: x runs along the fence, y leads away from the street."""

    origin: Array
    yaw: float

    def at(self, x: float, y: float, z: float = 0.0) -> tuple[float, float, float]:
        """Town position of (x, y) of this frame."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return float(self.origin[0] + c * x - s * y), float(self.origin[1] + s * x + c * y), z

    def grid(self, low: tuple[float, float], high: tuple[float, float]) -> Array:
        """Points (N, 2) about every 0.9 m over a rectangle of this frame, its border among them."""
        axes = [np.linspace(a, b, int((b - a) / 0.9) + 2) for a, b in zip(low, high, strict=True)]
        x, y = (g.ravel() for g in np.meshgrid(*axes))
        return np.array([self.at(a, b)[:2] for a, b in zip(x, y, strict=True)])


@dataclass(frozen=True)
class _Generators:
    """Random generators of a plot.

    Attributes:
        design: for the house, which twin streets share.
        details: for everything else.
    """

    design: np.random.Generator
    details: np.random.Generator


class TownBuilder:
    """Walks along all streets and fills both sides, plot by plot."""

    def __init__(self, config: SimulationConfig, trajectory: SimulatedTrajectory) -> None:
        """Lay the streets and build the meshes whose copies are placed."""
        self.config = config
        self.streets: Streets = lay_streets(plan_base_path(config), trajectory)
        self.plots = _Plots()
        rng = config.rng(3)
        self.grove, self.cars = street_objects.grove(rng), vehicles.fleet(rng)
        self.bushes = [street_objects.bush(rng) for _ in range(3)]
        self.hedges = [street_objects.hedge(rng) for _ in range(2)]
        self.street_objects = [
            street_objects.lamp_post(),
            *(street_objects.sign(rng) for _ in range(5)),
            vehicles.bin_and_box(rng),
        ]
        self.meshes: list[PlacedMesh] = []

    def build(self) -> list[PlacedMesh]:
        """Place all meshes of the town. Equal configurations give equal towns."""
        self.meshes = [PlacedMesh(mesh) for mesh in ground(self.streets, self.config.rng(4))]
        for side in (1, -1):
            self._plots_along(side)
        for side in (1, -1):
            self._kerbside(side)
        self._background()
        return self.meshes

    def _site(self, row: int, side: int, lateral: float) -> _Site:
        """Return the frame beside a street row, `lateral` metres from its middle on the left (1) or right (-1)."""
        h = self.streets.headings[row]
        out = side * np.array([-np.sin(h), np.cos(h)])
        return _Site(self.streets.points[row] + lateral * out, float(h + (0.0 if side > 0 else np.pi)))

    def _plots_along(self, side: int) -> None:
        """Build plot after plot along one side: town houses wall to wall, cottages in gardens, or parks."""
        row, number = 2, 0
        while row < len(self.streets.points) - 8:
            row = self._next_row(row)
            rngs = self._generators(side, row, number)
            kind = rngs.design.choice(["urban", "cottage", "cottage", "park"])
            width = float(rngs.design.uniform(9, 17))
            rows = max(4, round(width / 2 + (0.5 if kind == "urban" else 2.0)))
            if self.streets.joined[row : row + rows].all():
                middle = row + rows // 2
                {"urban": self._urban, "cottage": self._cottage, "park": self._park}[str(kind)](
                    middle, side, width, rngs
                )
            row, number = row + rows, number + 1

    def _twins(self) -> list[tuple[int, int]]:
        """First row and the row after the last of each twin street; empty without perceptual aliasing."""
        rows = len(self.streets.points)
        return (
            [(int(a * rows), int((a + _TWIN_LENGTH) * rows)) for a in _TWIN_STARTS]
            if self.config.perceptual_aliasing
            else []
        )

    def _next_row(self, row: int) -> int:
        """Return the row at which to build next: twin streets begin with a whole plot, so the gap before is skipped."""
        return next((begin for begin, _ in self._twins() if begin - _MAX_PLOT_ROWS < row < begin), row)

    def _generators(self, side: int, row: int, number: int) -> _Generators:
        """Return the generators of a plot: houses of twin streets have the same design, but their own details."""
        for begin, end in self._twins():
            if begin <= row < end:
                return _Generators(self.config.rng(5, side + 1, 0, row - begin), self.config.rng(5, side + 1, number))
        rng = self.config.rng(5, side + 1, number)
        return _Generators(rng, rng)

    def _house(self, site: _Site, width: float, urban: bool, rngs: _Generators) -> bool:
        """Build a house whose front is centred on a site; return False if there is no room."""
        house = draw_house(rngs.design, width, urban)
        low, high = (-width / 2, -1.3), (width / 2, house.depth)
        inner = site.grid((-width / 2 + 0.6, 0.0), (width / 2 - 0.6, house.depth))
        if not self.streets.is_clear(site.grid(low, high), _CLEARANCE_M + 1.2) or not self.plots.take(inner):
            return False
        self.meshes.append(PlacedMesh(build_house(house, rngs.details, urban), site.yaw, site.at(-width / 2, 0.0)))
        return True

    def _urban(self, row: int, side: int, width: float, rngs: _Generators) -> None:
        site = self._site(row, side, PAVEMENT_END + rngs.design.uniform(0.3, 1.2))
        self._house(site, width + 1.5, True, rngs)

    def _cottage(self, row: int, side: int, width: float, rngs: _Generators) -> None:
        """Build a house behind a fence or hedge, with trees and bushes in front of it."""
        setback, rng = float(rngs.design.uniform(3.0, 7.5)), rngs.details
        self._house(self._site(row, side, PAVEMENT_END + setback), 0.75 * width, False, rngs)
        site = self._site(row, side, PAVEMENT_END + 0.15)
        self._border(site, width, rng)
        for _ in range(rng.integers(1, 4)):
            x, y = rng.uniform(-width / 2, width / 2), rng.uniform(0.8, max(1.0, setback - 0.8))
            self._plant(site.at(x, y, 0.1), self.bushes, rng)
        if rng.random() < 0.7:
            tall = self.grove[:2] + self.grove[4:]
            self._plant(site.at(rng.uniform(-width / 2, width / 2), rng.uniform(1.2, 3.0), 0.1), tall, rng)

    def _park(self, row: int, side: int, width: float, rngs: _Generators) -> None:
        """Plant trees on grass and bushes below them."""
        rng = rngs.details
        site = self._site(row, side, PAVEMENT_END + 0.3)
        if rng.random() < 0.4:
            self._border(site, width, rng)
        for _ in range(5):
            self._plant(site.at(rng.uniform(-width / 2, width / 2), rng.uniform(1.0, 16.0), 0.1), self.grove, rng)
        for _ in range(4):
            self._plant(site.at(rng.uniform(-width / 2, width / 2), rng.uniform(0.8, 8.0), 0.1), self.bushes, rng)

    def _border(self, site: _Site, width: float, rng: np.random.Generator) -> None:
        """Build a fence, railing, wall or hedge along the pavement."""
        kind = rng.integers(0, 5)
        length = width + 3.0
        points = site.grid((-length / 2, -0.3), (length / 2, 0.3))
        if not self.streets.is_clear(points, _CLEARANCE_M):
            return
        if kind == 0:
            for x in np.arange(-length / 2, length / 2 - 3.9, 4.0):
                self.meshes.append(PlacedMesh(self.hedges[int(rng.integers(2))], site.yaw, site.at(x, 0.3, 0.1)))
        else:
            mesh = street_objects.border(int(kind), length, rng)
            self.meshes.append(PlacedMesh(mesh, site.yaw, site.at(-length / 2, 0.0, 0.1)))

    def _plant(self, position: tuple[float, float, float], choice: list[Mesh], rng: np.random.Generator) -> None:
        """Plant one tree or bush, if its trunk is clear of houses and its crown clear of the path."""
        mesh = choice[int(rng.integers(len(choice)))]
        yaw, scale, tint = (
            rng.uniform(0, 2 * np.pi),
            float(rng.uniform(0.8, 1.2)),
            float(rng.uniform(0.6, 1.25)),
        )
        place = np.array([position[:2]])
        if self.streets.is_clear(place, 4.0) and self.plots.take(place):
            self.meshes.append(PlacedMesh(mesh, float(yaw), position, scale, tint))

    def _kerbside(self, side: int) -> None:
        """Place street trees, lamps, signs, bins and parked cars between the plots and the carriageway."""
        number = 0
        for row in range(3, len(self.streets.points) - 3, 3):
            rng, number = self.config.rng(6, side + 1, number), number + 1
            if not self.streets.joined[row]:
                continue
            if rng.random() < 0.4:
                self._park_car(self._site(row, side, ROAD_HALF + rng.uniform(-0.2, 0.4)), rng)
            thing = rng.random()
            post = self._site(row, side, ROAD_HALF + 1.75)
            if thing < 0.25:
                self._plant(post.at(0.0, 0.0, 0.12), self.grove[:2] + self.grove[-2:], rng)
            elif thing < 0.65:
                self._put(
                    self.street_objects[int(rng.integers(len(self.street_objects)))],
                    post.at(rng.uniform(-1, 1), 0, 0.12),
                    post.yaw,
                )

    def _park_car(self, site: _Site, rng: np.random.Generator) -> None:
        yaw = site.yaw + rng.normal(0, 0.02) + np.pi * rng.integers(0, 2)
        outline = site.grid((-2.3, -0.9), (2.3, 0.9))
        if self.streets.is_clear(outline, _CLEARANCE_M) and self.plots.take(outline):
            mesh = self.cars[int(rng.integers(len(self.cars)))]
            self.meshes.append(PlacedMesh(mesh, float(yaw), site.at(0.0, 0.0, 0.02)))

    def _put(self, mesh: Mesh, position: tuple[float, float, float], yaw: float) -> None:
        place = np.array([position[:2]])
        if self.streets.is_clear(place, _CLEARANCE_M + 0.4) and self.plots.take(place):
            self.meshes.append(PlacedMesh(mesh, yaw, position))

    def _background(self) -> None:
        """Build a second row of houses and trees, which is visible through gaps in the first."""
        rng = self.config.rng(8)
        for row in range(4, len(self.streets.points) - 4, 5):
            side = 1 if rng.random() < 0.5 else -1
            site = self._site(row, side, float(rng.uniform(26, 60)))
            if rng.random() < 0.5:
                self._house(site, float(rng.uniform(9, 16)), bool(rng.random() < 0.4), _Generators(rng, rng))
            else:
                for _ in range(3):
                    self._plant(site.at(*rng.normal(0, 4, 2)), self.grove[1:6], rng)
