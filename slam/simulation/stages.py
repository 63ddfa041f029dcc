"""Which part of the town is set up for which frames, and under which sky."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from slam.simulation.materials import build_materials
from slam.simulation.render import Daylight, Scene, Stage, build_scene, cast_shadow
from slam.simulation.routes import Drive
from slam.simulation.spec import DriveSpec
from slam.simulation.textures import panorama
from slam.simulation.town import TownBuilder
from slam.simulation.traffic import Traffic

Array = NDArray[np.float64]
_STRETCH = 220.0  # metres in x or y that one stage may span
_SIGHT = 170.0  # metres beyond it that are still drawn
_SHADOW_REACH = 70.0  # metres around the way that have shadows
# Azimuth and height of the sun in degrees, light of sun and sky, of the first lap and of later ones.
_WEATHERS = ((-50.0, 42.0, 1.15, 0.36), (75.0, 27.0, 0.3, 0.75), (160.0, 24.0, 1.3, 0.3))


class Stages:
    """Iterates over (stage, its frames) from the first frame to the last."""

    def __init__(self, spec: DriveSpec, drive: Drive) -> None:
        """Build the town of a drive."""
        self.spec, self.drive = spec, drive
        builder = TownBuilder(spec, drive)
        self.parts = builder.build()
        self.traffic = Traffic(spec, drive, builder.cars)
        self.materials = build_materials(spec)

    def __iter__(self) -> Iterator[tuple[Stage, range]]:
        """Set up one stretch after the other; neighbours of the same extent share their scene."""
        at = np.array([part.at[:2] if any(part.at) else _middle(part.mesh.corners) for part in self.parts])
        scene, members = None, None
        for frames in self._stretches():
            near = self.drive.T_town_camera[frames.start : frames.stop, :2, 3]
            low, high = near.min(axis=0) - _SIGHT, near.max(axis=0) + _SIGHT
            inside = np.flatnonzero(((at >= low) & (at <= high)).all(axis=1))
            if scene is None or members is None or not np.array_equal(inside, members):
                scene, members = build_scene([self.parts[i].placed() for i in inside]), inside
            yield self._stage(scene, frames, near), frames

    def _stage(self, scene: Scene, frames: range, near: Array) -> Stage:
        light = daylight(self.spec, int(self.drive.lap[frames.start]))
        return Stage(scene, cast_shadow(scene, light.to_sun, near, _SHADOW_REACH), light, self.materials)

    def _stretches(self) -> Iterator[range]:
        """Return runs of frames that span little ground, and one lap where the light changes by lap."""
        positions, lap = self.drive.T_town_camera[:, :2, 3], self.drive.lap
        start = 0
        for i in range(1, len(positions) + 1):
            if i < len(positions):
                span = np.ptp(positions[start : i + 1], axis=0).max()
                if span <= _STRETCH and not (self.spec.relight and lap[i] != lap[start]):
                    continue
            yield range(start, i)
            start = i


def _middle(corners: Array) -> Array:
    return (corners[:, :, :2].min(axis=(0, 1)) + corners[:, :, :2].max(axis=(0, 1))) / 2


def daylight(spec: DriveSpec, lap: int) -> Daylight:
    """Sun and sky of a lap."""
    which = lap % len(_WEATHERS) if spec.relight else 0
    azimuth, height, sun, ambient = _WEATHERS[which]
    a, h = np.radians([azimuth, height])
    to_sun = np.array([np.cos(a) * np.cos(h), np.sin(a) * np.cos(h), np.sin(h)])
    sky = panorama(spec.rng(9, which))
    return Daylight(to_sun, sun, ambient, 0.72, sky)
