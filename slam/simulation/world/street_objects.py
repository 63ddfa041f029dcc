"""Objects beside the street: lamps, signs, garden borders, trees, bushes and hedges.

Prototypes stand on the origin, and borders run along +x, metres; the town places turned, scaled and tinted copies.
Plants are trunks, branches and some thousand sprays of leaves each.
"""

import numpy as np
from numpy.typing import NDArray

from slam.simulation.world import materials as m
from slam.simulation.world.mesh import Mesh, boxes, merge_meshes, panel, prism, triangles

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


def _sprays(centres: Array, size: float, material: int, tint: Array, rng: np.random.Generator) -> Mesh:
    """One triangle of about `size` metres in any direction at each of centres (N, 3)."""
    n = len(centres)
    corners = centres[:, None] + rng.normal(0, 0.62 * size, (n, 3, 3)) * [1.0, 1.0, 0.8]
    uv = rng.uniform(0, 1, (n, 1, 2)) + rng.uniform(-0.5, 0.5, (n, 3, 2))
    return triangles(corners, uv, material, tint)


def _blob(rng: np.random.Generator, count: int, radii: Array) -> Array:
    """Points (count, 3) in an ellipsoid, dense near its skin."""
    d = rng.normal(size=(count, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True) * rng.uniform(0.5, 1.0, (count, 1)) ** 0.6 * radii


def broadleaf(rng: np.random.Generator, height: float = 8.0, sprays: int = 2200, size: float = 0.3) -> Mesh:
    """Grow a tree of `height` metres whose crown is a heap of blobs, darker inside."""
    trunk = 0.28 * height
    blobs = [np.array([*rng.normal(0, 0.13 * height, 2), trunk + rng.uniform(0.1, 0.62) * height]) for _ in range(11)]
    centre = np.array([0.0, 0.0, trunk + 0.36 * height])
    each = [b + _blob(rng, sprays // 11, np.array([0.16, 0.16, 0.12]) * height) for b in blobs]
    points = np.concatenate(each)
    away = np.linalg.norm((points - centre) / height, axis=1)
    tint = (0.45 + 1.1 * np.clip(away / 0.36, 0, 1)) * rng.uniform(0.7, 1.25, len(points))
    parts = [
        _sprays(points, size, m.LEAF, tint, rng),
        prism(0.025 * height, 0.014 * height, trunk * 1.6, m.BARK),
    ]
    parts += [_branch(np.array([0, 0, trunk]), b, 0.009 * height) for b in blobs]
    return merge_meshes(parts)


def _branch(start: Array, end: Array, radius: float) -> Mesh:
    """Grow a thin three-sided branch."""
    axis = (end - start) / np.linalg.norm(end - start)
    side = np.cross(axis, [0.3, 0.5, 0.81])
    side *= radius / np.linalg.norm(side)
    other = np.cross(axis, side)
    ring = np.stack([side, -0.5 * side + 0.87 * other, -0.5 * side - 0.87 * other])
    corners = np.stack([np.stack([start + ring[i], start + ring[(i + 1) % 3], end]) for i in range(3)])
    uv = np.tile([[0.0, 0.0], [0.3, 0.0], [0.15, 2.0]], (3, 1, 1))
    return triangles(corners, uv, m.BARK)


def conifer(rng: np.random.Generator, height: float = 11.0, sprays: int = 1800) -> Mesh:
    """Grow a spruce: whorls of drooping boughs, narrow at the top."""
    level = rng.uniform(0, 1, sprays) ** 1.4
    reach = (1 - level) * 0.24 * height * rng.uniform(0.35, 1.0, sprays) ** 0.5
    angle = rng.uniform(0, 2 * np.pi, sprays)
    whorl = 0.02 * height * np.sin(level * 75)
    z = 0.1 * height + level * 0.9 * height - 0.25 * reach + whorl
    points = np.stack([reach * np.cos(angle), reach * np.sin(angle), z], axis=1)
    tint = (0.35 + 0.9 * reach / np.maximum((1 - level) * 0.24 * height, 1e-3)) * rng.uniform(0.7, 1.2, sprays)
    return merge_meshes(
        [_sprays(points, 0.34, m.NEEDLE, tint, rng), prism(0.02 * height, 0.004 * height, height, m.BARK)]
    )


def sapling(rng: np.random.Generator) -> Mesh:
    """Grow a young street tree with a stake: sky shows through it."""
    points = np.array([0, 0, 3.4]) + _blob(rng, 560, np.array([0.9, 0.9, 1.5]))
    tint = rng.uniform(0.6, 1.4, len(points))
    stake = prism(0.03, 0.03, 1.8, m.WOOD, 4).transform(0.0, np.array([0.35, 0.1, 0.0]))
    branches = [_branch(np.array([0, 0, 1.8]), points[i], 0.018) for i in range(0, 60, 5)]
    return merge_meshes([_sprays(points, 0.14, m.LEAF, tint, rng), prism(0.05, 0.02, 3.6, m.BARK, 5), stake, *branches])


def bush(rng: np.random.Generator) -> Mesh:
    """Grow a garden bush of about 1.4 m."""
    points = np.array([0, 0, 0.65]) + _blob(rng, 420, np.array([0.8, 0.8, 0.7]))
    tint = (0.5 + 0.7 * np.clip(points[:, 2], 0, 1.2)) * rng.uniform(0.7, 1.3, len(points))
    return _sprays(points, 0.17, m.LEAF, tint, rng)


def hedge(rng: np.random.Generator, length: float = 4.0, height: float = 1.3) -> Mesh:
    """Grow a cut hedge along +x with twigs standing out."""
    n = int(170 * length)
    points = rng.uniform([0, -0.35, 0.0], [length, 0.35, height], (n, 3))
    push = rng.integers(0, 3, n)
    points[push == 0, 1] = -0.35 + rng.normal(0, 0.03, (push == 0).sum())
    points[push == 1, 2] = height + rng.normal(0, 0.04, (push == 1).sum())
    tint = (0.45 + 0.5 * points[:, 2] / height) * rng.uniform(0.7, 1.3, n)
    return _sprays(points, 0.15, m.LEAF, tint, rng)


def grove(rng: np.random.Generator) -> list[Mesh]:
    """Grow the prototypes of the town's trees: broadleaves, conifers, saplings."""
    broad = [broadleaf(rng, h, size=0.031 * h) for h in (6.0, 8.0, 9.5, 12.0)]
    return [*broad, conifer(rng), conifer(rng, 8.0), sapling(rng), sapling(rng)]
