"""Street furniture: lamps, signs, fences, railings and walls.

Each mesh stands on the origin; borders run along +x, metres.
"""

import numpy as np
from numpy.typing import NDArray

from slam.simulation.world import materials as m
from slam.simulation.world.mesh import Mesh, boxes, merge_meshes, panel, prism

Array = NDArray[np.float64]


def lamp_post() -> Mesh:
    """Build a mast of 6 m with an arm over the road (-y)."""
    arm = boxes([-0.04, -1.5, 5.9], [0.04, 0.0, 5.98], m.METAL, 0.6)
    head = boxes([-0.12, -1.9, 5.86], [0.12, -1.3, 6.02], m.METAL, 0.9)
    return merge_meshes([prism(0.09, 0.05, 6.0, m.METAL, 6).scale_brightness(0.6), arm, head])


def sign(rng: np.random.Generator) -> Mesh:
    """Build a traffic sign or notice on a post, facing along the street."""
    height, size = float(rng.uniform(2.0, 2.6)), float(rng.uniform(0.45, 0.8))
    plate = panel(
        [0.05, -size / 2, height],
        [0, size, 0],
        [0, 0, size],
        m.POSTER + int(rng.integers(m.POSTERS)),
        np.array([0, 0, 1, 1]),
    )
    return merge_meshes([prism(0.035, 0.035, height + size, m.METAL, 5), plate])


def border(kind: int, length: float, rng: np.random.Generator) -> Mesh:
    """Build a garden border of `length` metres: 1 pickets, 2 iron railing, 3 wall with pillars, 4 boards."""
    return (_pickets, _railing, _wall, _boards)[kind - 1](length, float(rng.uniform(0.5, 1.4)))


def _bars(length: float, spacing: float, size: Array, z: float) -> tuple[Array, Array]:
    """Corners of upright bars of `size` (3,) every `spacing` metres."""
    x = np.arange(0.0, length, spacing)
    low = np.stack([x, np.zeros_like(x), np.full_like(x, z)], axis=1)
    return low, low + size


def _pickets(length: float, tint: float) -> Mesh:
    low, high = _bars(length, 0.14, np.array([0.08, 0.02, 0.95]), 0.05)
    rails = boxes([[0, 0.02, 0.3], [0, 0.02, 0.75]], [[length, 0.06, 0.38], [length, 0.06, 0.83]], m.WOOD, tint)
    posts = boxes(*_bars(length, 2.4, np.array([0.12, 0.12, 1.1]), 0.0), m.WOOD, tint)
    return merge_meshes([boxes(low, high, m.WOOD, 1.4 * tint), rails, posts])


def _railing(length: float, tint: float) -> Mesh:
    low, high = _bars(length, 0.13, np.array([0.025, 0.025, 0.9]), 0.3)
    rails = boxes([[0, 0, 0.35], [0, 0, 1.1]], [[length, 0.03, 0.39], [length, 0.03, 1.14]], m.METAL, 0.25)
    plinth = boxes([0, -0.12, 0], [length, 0.14, 0.3], m.PLASTER, tint, 2.5)
    pillars = boxes(*_bars(length, 3.2, np.array([0.32, 0.32, 1.3]), 0.0), m.BRICK, tint)
    return merge_meshes([boxes(low, high, m.METAL, 0.25), rails, plinth, pillars])


def _wall(length: float, tint: float) -> Mesh:
    body = boxes([0, -0.1, 0], [length, 0.12, 0.9], m.BRICK if tint < 1 else m.PLASTER, tint, 2.5)
    cap = boxes([0, -0.15, 0.9], [length, 0.17, 0.98], m.PLASTER, 0.9, 2.5)
    return merge_meshes([body, cap, boxes(*_bars(length, 4.0, np.array([0.45, 0.3, 1.25]), 0.0), m.BRICK, tint)])


def _boards(length: float, tint: float) -> Mesh:
    low, high = _bars(length, 0.155, np.array([0.15, 0.02, 1.5]), 0.05)
    return boxes(low, high, m.WOOD, tint * np.tile([1.0, 0.8, 1.1, 0.9, 0.95], len(low))[: len(low)])
