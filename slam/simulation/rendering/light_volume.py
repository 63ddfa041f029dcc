"""Light of a room, computed once on a grid of points.

Each cell has the light that falls on a surface there, for the six directions along the axes in which the surface may
face (the ambient cube of Mitchell, McTaggart and Green, Shading in Valve's Source engine, 2006): that of the lamps and
the window that the cell sees, and what the room reflects, which is less where the cell is surrounded.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve

from slam.mapping.tsdf import load_open3d

Array = NDArray[np.float64]

_CELL_M = 0.13
_DIRECTIONS = 26  # in which a cell looks for what surrounds it
_REACH_M = 1.2  # a surface farther away takes no reflected light
_REFLECTED, _MIN_REFLECTED = 0.6, 0.45  # share of the light that the room reflects; how much of it reaches corners
_MEAN_LIGHT, _MAX_LIGHT = 0.8, 2.2  # the brightest places are compressed: cameras for rooms show them so
_MIN_DISTANCE_M = 0.7  # bounds the light near a lamp
# A cell that sees less far in most directions is inside of something, such as a cupboard.
_FAR_M, _MIN_FAR_SHARE = 0.9, 0.15
_AXES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)


@dataclass(frozen=True)
class LightSource:
    """A lamp or a window.

    Attributes:
        points: (P, 3) points that shine, metres.
        facing: (3,) unit direction of the light, or zeros if it shines in all directions.
        strength: light at a distance of one metre, relative to other sources.
    """

    points: Array
    facing: Array
    strength: float


class LightVolume(NamedTuple):
    """Light on a grid.

    Attributes:
        origin: (3,) middle of the first cell, metres.
        cell_m: distance between cells.
        light: (6, Z, Y, X) float32 light on surfaces that face +x, -x, +y, -y, +z and -z.
    """

    origin: NDArray[Any]
    cell_m: float
    light: NDArray[Any]


def bake_light(occluders: Array, sources: list[LightSource], floors: Array, height: float) -> LightVolume:
    """Compute the light in a volume.

    Args:
        occluders: (T, 3, 3) triangles that throw shadows, metres; not those of the lamps.
        sources: lamps and windows.
        floors: (F, 4) rectangles of floor: low x, low y, high x, high y, metres.
        height: of the ceilings, metres.
    """
    low, high = np.append(floors[:, :2].min(axis=0), 0.0), np.append(floors[:, 2:].max(axis=0), height)
    scene, ray_of = _ray_caster(occluders)
    shape = np.ceil((high - low) / _CELL_M).astype(int)[::-1] + 1
    z, y, x = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
    cells = low + _CELL_M * np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    around = _sphere(_DIRECTIONS)
    free_m = np.stack([scene.cast_rays(ray_of(cells, np.tile(d, (len(cells), 1))))["t_hit"].numpy() for d in around])
    facing = np.maximum(around @ _AXES.T, 0.0)
    # einsum and not @: equal bits for any number of threads.
    reflected = (
        np.einsum("da,dn->an", facing, np.clip(free_m / _REACH_M, _MIN_REFLECTED, 1.0)) / facing.sum(axis=0)[:, None]
    )
    direct = np.zeros((6, len(cells)))
    for source in sources:
        for point in source.points:
            to_source = point - cells
            squared = (to_source**2).sum(axis=1)
            seen = ~scene.test_occlusions(ray_of(cells, to_source), tfar=0.995).numpy()
            d = to_source / np.sqrt(squared)[:, None]
            emitted = np.maximum(-(d * source.facing).sum(axis=1), 0.0) if source.facing.any() else 1.0
            strength = source.strength / len(source.points) * seen * emitted / (squared + _MIN_DISTANCE_M**2)
            direct += strength * np.maximum(np.einsum("ak,nk->an", _AXES, d), 0.0)
    is_free = (free_m > _FAR_M).mean(axis=0) > _MIN_FAR_SHARE
    is_free &= _is_inside(cells, floors) & (cells[:, 2] < height)
    light = _REFLECTED * reflected + (1 - _REFLECTED) * direct / direct[:, is_free].mean()
    light = light / (1.0 + light / (_MAX_LIGHT / _MEAN_LIGHT))
    light = _spread(light.reshape(6, *shape), is_free.reshape(tuple(shape)))
    light *= _MEAN_LIGHT / light[:, is_free.reshape(tuple(shape))].mean()
    return LightVolume(np.asarray(low, np.float64), _CELL_M, np.ascontiguousarray(light, dtype=np.float32))


def _ray_caster(triangles: Array) -> tuple[Any, Callable[[Array, Array], Any]]:
    """Scene of Open3D, and a function that makes its rays of origins and directions (N, 3)."""
    o3d = load_open3d()
    scene = o3d.t.geometry.RaycastingScene()
    corners = np.ascontiguousarray(triangles.reshape(-1, 3), dtype=np.float32)
    numbers = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    scene.add_triangles(o3d.core.Tensor(corners), o3d.core.Tensor(numbers))
    return scene, lambda at, along: o3d.core.Tensor(np.hstack([at, along]).astype(np.float32))


def _is_inside(cells: Array, floors: Array) -> NDArray[np.bool_]:
    """Whether each of the points (N, 3) is above one of the rectangles."""
    x, y = cells[:, :1], cells[:, 1:2]
    return np.asarray(((x > floors[:, 0]) & (x < floors[:, 2]) & (y > floors[:, 1]) & (y < floors[:, 3])).any(axis=1))


def _sphere(count: int) -> Array:
    """Directions (count, 3) spread evenly (Fibonacci's lattice)."""
    k = np.arange(count) + 0.5
    z, turn = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def _spread(light: Array, is_free: NDArray[np.bool_]) -> Array:
    """Give cells inside of things the mean light of their free neighbours: surfaces are between both."""
    known = is_free.astype(np.float64)
    kernel = np.ones((3, 3, 3))
    for _ in range(3):
        weight = convolve(known, kernel, mode="constant")
        mean = np.stack([convolve(axis * known, kernel, mode="constant") for axis in light]) / np.maximum(weight, 1.0)
        grows = (known == 0) & (weight > 0)
        light = np.where(grows, mean, light * (known > 0))
        known = np.where(grows, 1.0, known)
    return light
