"""Streams the town to the renderer: the meshes, shadows and sky near each stretch of the path."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from slam.simulation.rendering.renderer import Daylight, LitScene, Scene, build_scene, build_shadow_map
from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.scenario.trajectory import SimulatedTrajectory
from slam.simulation.world.materials import build_materials
from slam.simulation.world.textures import panorama
from slam.simulation.world.town import TownBuilder
from slam.simulation.world.vehicles import Traffic

Array = NDArray[np.float64]
_MAX_STRETCH_M = 220.0  # extent of one stretch in x or y
_DRAW_DISTANCE_M = 170.0  # beyond the stretch; meshes farther away are left out
_SHADOW_DISTANCE_M = 70.0  # around the path; farther surfaces are lit without shadows
# Azimuth and elevation of the sun, degrees, and light of sun and sky; of the first lap, the second and the third.
_WEATHERS = ((-50.0, 42.0, 1.15, 0.36), (75.0, 27.0, 0.3, 0.75), (160.0, 24.0, 1.3, 0.3))


class SceneStream:
    """Iterates over (scene, its frames) from the first frame to the last."""

    def __init__(self, config: SimulationConfig, trajectory: SimulatedTrajectory) -> None:
        """Build the town around a trajectory."""
        self.config, self.trajectory = config, trajectory
        builder = TownBuilder(config, trajectory)
        self.meshes = builder.build()
        self.traffic = Traffic(config, trajectory, builder.cars)
        self.materials = build_materials(config)

    def __iter__(self) -> Iterator[tuple[LitScene, range]]:
        """Build the scene of one stretch after the other; stretches with the same meshes share them."""
        at = np.array([mesh.position[:2] if any(mesh.position) else _center(mesh.mesh.corners) for mesh in self.meshes])
        scene, members = None, None
        for frames in self._stretches():
            near = self.trajectory.T_town_camera[frames.start : frames.stop, :2, 3]
            low, high = near.min(axis=0) - _DRAW_DISTANCE_M, near.max(axis=0) + _DRAW_DISTANCE_M
            inside = np.flatnonzero(((at >= low) & (at <= high)).all(axis=1))
            if scene is None or members is None or not np.array_equal(inside, members):
                scene, members = build_scene([self.meshes[i].to_town_frame() for i in inside]), inside
            yield self._lit_scene(scene, frames, near), frames

    def _lit_scene(self, scene: Scene, frames: range, near: Array) -> LitScene:
        light = choose_daylight(self.config, int(self.trajectory.lap[frames.start]))
        return LitScene(scene, build_shadow_map(scene, light.to_sun, near, _SHADOW_DISTANCE_M), light, self.materials)

    def _stretches(self) -> Iterator[range]:
        """Split the frames into runs of limited extent, and at the end of a lap if the light changes with the lap."""
        positions, lap = self.trajectory.T_town_camera[:, :2, 3], self.trajectory.lap
        start = 0
        for i in range(1, len(positions) + 1):
            if i < len(positions):
                span = np.ptp(positions[start : i + 1], axis=0).max()
                if span <= _MAX_STRETCH_M and not (self.config.change_illumination and lap[i] != lap[start]):
                    continue
            yield range(start, i)
            start = i


def _center(corners: Array) -> Array:
    return (corners[:, :, :2].min(axis=(0, 1)) + corners[:, :, :2].max(axis=(0, 1))) / 2


def choose_daylight(config: SimulationConfig, lap: int) -> Daylight:
    """Return sun and sky of a lap."""
    which = lap % len(_WEATHERS) if config.change_illumination else 0
    azimuth, height, sun, ambient = _WEATHERS[which]
    a, h = np.radians([azimuth, height])
    to_sun = np.array([np.cos(a) * np.cos(h), np.sin(a) * np.cos(h), np.sin(h)])
    sky = panorama(config.rng(9, which))
    return Daylight(to_sun, sun, ambient, 0.72, sky)
