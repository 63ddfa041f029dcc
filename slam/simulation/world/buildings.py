"""Houses: textured fronts with projecting bays, balconies, cornices, awnings, roofs and chimneys.

A house stands with the left end of its front on the origin, front along +x, garden behind it along +y, z
up, metres.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.simulation.world import materials as m
from slam.simulation.world.facades import BAY, FRONT_WIDTH, STOREY
from slam.simulation.world.mesh import Mesh, boxes, merge_meshes, panel, quads, triangles

Array = NDArray[np.float64]
Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class House:
    """Measures of one house, metres, and how it is painted."""

    width: float
    depth: float
    storeys: int
    front: int  # which of the painted fronts
    bay: int  # first bay of the texture that is shown
    tint: float

    @property
    def eaves(self) -> float:
        """Height of the walls."""
        return STOREY * self.storeys + 0.4


def draw_house(rng: np.random.Generator, width: float, urban: bool) -> House:
    """Draw a town house or a cottage of a given width."""
    storeys = int(rng.integers(3, 6)) if urban else int(rng.integers(1, 4))
    depth, tint = (
        float(rng.uniform(8, 11)),
        float(rng.choice([rng.uniform(0.9, 1.3), rng.uniform(0.35, 0.8)])),
    )
    return House(width, depth, storeys, int(rng.integers(m.FRONTS)), int(rng.integers(4)), tint)


def build_house(h: House, rng: np.random.Generator, urban: bool) -> Mesh:
    """All walls, the roof and what hangs on them."""
    parts = [_wall(h, np.zeros(3), np.array([h.width, 0, 0]), 0), _walls_behind(h, rng), _roof(h, rng)]
    parts.append(_cornice(h))
    if rng.random() < 0.45:
        parts.append(_bay_window(h, rng))
    if rng.random() < 0.5:
        parts.append(_balconies(h, rng))
    if urban and rng.random() < 0.7:
        parts.append(_awning(h, rng))
    parts.append(_sills(h))
    parts += [_poster(h, rng) for _ in range(rng.integers(0, 3))]
    return merge_meshes(parts)


def _wall(h: House, origin: Array, along: Array, shift: int) -> Mesh:
    """Street level and upper storeys of one wall."""
    length = float(np.linalg.norm(along))
    u0 = (h.bay + shift) * BAY / FRONT_WIDTH
    u1, base = u0 + length / FRONT_WIDTH, STOREY + 0.4
    street = panel(origin, along, Z * base, m.GROUND + h.front, np.array([u0, 0, u1, 1.0]), h.tint)
    if h.storeys == 1:
        return street
    tiles = np.array([u0, 0, u1, (h.storeys - 1) / 3])
    return merge_meshes(
        [street, panel(origin + Z * base, along, Z * (h.eaves - base), m.UPPER + h.front, tiles, h.tint)]
    )


def _walls_behind(h: House, rng: np.random.Generator) -> Mesh:
    """Both ends and the back; ends are blank or have windows."""
    w, d = np.array([h.width, 0, 0]), np.array([0, h.depth, 0])
    parts = []
    for origin, along in ((w, d), (d, -d)):
        if rng.random() < 0.6:
            parts.append(_wall(h, origin, along, 1))
        else:
            tiles = np.array([0, 0, h.depth / 5, h.eaves / 5])
            parts.append(panel(origin, along, Z * h.eaves, int(rng.choice([m.PLASTER, m.BRICK])), tiles, h.tint))
    return merge_meshes([*parts, _wall(h, w + d, -w, 2)])


def _roof(h: House, rng: np.random.Generator) -> Mesh:
    """Build a gable or hipped roof with eaves, a chimney and dormers."""
    over, rise = 0.5, float(rng.uniform(0.35, 0.6)) * h.depth
    hip = float(rng.choice([0.0, 0.3])) * h.depth
    x0, x1, y0, y1, y = -0.3, h.width + 0.3, -over, h.depth + over, h.depth / 2
    z, top = h.eaves - 0.1, h.eaves + rise
    a, b = np.array([x0 + hip, y, top]), np.array([x1 - hip, y, top])
    c = [np.array([x0, y0, z]), np.array([x1, y0, z]), np.array([x1, y1, z]), np.array([x0, y1, z])]
    material = int(rng.choice([m.ROOF, m.SLATE]))
    length, slope = (x1 - x0) / 6, float(np.hypot(rise, y)) / 6
    uv = np.array([[0, 0], [length, 0], [length - hip / 6, slope], [hip / 6, slope]])
    parts = [
        quads(
            np.stack([np.stack([c[0], c[1], b, a]), np.stack([c[2], c[3], a, b])]),
            np.stack([uv, uv]),
            material,
        )
    ]
    ends = np.stack([np.stack([c[1], c[2], b]), np.stack([c[3], c[0], a])])
    width = (y1 - y0) / 6
    uv_end = np.tile([[0, 0], [width, 0], [width / 2, slope]], (2, 1, 1))
    parts.append(triangles(ends, uv_end, material if hip else m.PLASTER, 1.0 if hip else h.tint))
    for _ in range(rng.integers(1, 3)):
        x = rng.uniform(1 + hip, h.width - 2 - hip) if h.width > 4 + 2 * hip else h.width / 2
        parts.append(boxes([x, y - 0.9, top - 1.2], [x + 0.6, y - 0.3, top + 0.9], m.BRICK, 0.7))
    if h.width > 9:
        parts += [_dormer(h, x, rise) for x in np.arange(2.0, h.width - 3, 4.0) if rng.random() < 0.6]
    return merge_meshes(parts)


def _dormer(h: House, x: float, rise: float) -> Mesh:
    """Build a window in the roof."""
    z = h.eaves + 0.25 * rise
    low, high = np.array([x, 0.22 * h.depth, z - 0.4]), np.array([x + 1.5, 0.5 * h.depth, z + 1.2])
    face = panel([x + 0.15, 0.215 * h.depth, z], [1.2, 0, 0], [0, 0, 1.0], m.GLASS, np.array([0, 0, 1, 1]), 0.15)
    return merge_meshes([boxes(low, high, m.SLATE, 0.9), face])


def _cornice(h: House) -> Mesh:
    low = np.array([[-0.05, -0.28, h.eaves - 0.35], [-0.02, -0.1, STOREY + 0.3]])
    return boxes(
        low,
        low + np.array([[h.width + 0.1, 0.28, 0.25], [h.width + 0.04, 0.1, 0.16]]),
        m.PLASTER,
        h.tint * 1.1,
        3.0,
    )


def _sills(h: House) -> Mesh:
    """Window sills of all upper bays, a hand deep."""
    bays, storeys = np.meshgrid(np.arange(int(h.width // BAY) + 1), np.arange(1, h.storeys))
    x = (bays.ravel() + 0.5) * BAY
    z = 0.4 + storeys.ravel() * STOREY + 0.55
    keep = (x > 0.9) & (x < h.width - 0.9)
    low = np.stack([x - 0.85, np.full_like(x, -0.16), z], axis=1)[keep]
    return boxes(low, low + np.array([1.7, 0.16, 0.1]), m.PLASTER, 1.1, 3.0) if len(low) else merge_meshes([])


def _bay_window(h: House, rng: np.random.Generator) -> Mesh:
    """Build a part of the front, one to two bays wide, that stands out by about a metre."""
    width, out = BAY * float(rng.integers(1, 3)), float(rng.uniform(0.5, 1.2))
    if h.width < width + 2:
        return merge_meshes([])
    x = float(rng.uniform(0.5, h.width - width - 0.5))
    high = h.eaves - (STOREY * rng.integers(0, 2) if h.storeys > 1 else 0.2)
    u = h.bay / 4 + x / FRONT_WIDTH
    tiles = np.array([u, 0, u + width / FRONT_WIDTH, high / STOREY / 3])
    o = np.array([x, -out, 0.0])
    front = panel(o, [width, 0, 0], Z * high, m.UPPER + h.front, tiles, h.tint)
    sides = boxes([x, -out + 0.01, 0], [x + width, 0, high], m.PLASTER, h.tint, 5.0)
    return merge_meshes([front, sides])


def _balconies(h: House, rng: np.random.Generator) -> Mesh:
    """Slabs with railings of thin bars in one bay, above each other."""
    x = 0.4 + BAY * float(rng.integers(0, max(1, int(h.width // BAY) - 1)))
    parts = []
    for storey in range(1, h.storeys):
        z = 0.4 + storey * STOREY
        parts.append(boxes([x, -1.2, z - 0.15], [x + 2.6, 0, z], m.PLASTER, 1.0, 3.0))
        bars = np.arange(x, x + 2.61, 0.13)
        low = np.stack([bars, np.full_like(bars, -1.18), np.full_like(bars, z)], axis=1)
        parts.append(boxes(low, low + np.array([0.03, 0.03, 0.95]), m.METAL, 0.4))
        parts.append(boxes([x, -1.2, z + 0.95], [x + 2.6, -1.15, z + 1.0], m.METAL, 0.4))
    return merge_meshes(parts)


def _awning(h: House, rng: np.random.Generator) -> Mesh:
    """Build a slanting cloth over a shop."""
    x, width = float(rng.uniform(0.3, h.width / 3)), min(4.0, h.width / 2)
    corner = [[x, 0, 2.95], [x + width, 0, 2.95], [x + width, -1.1, 2.45], [x, -1.1, 2.45]]
    cloth = quads(
        np.array([corner]),
        np.array([[[0, 0], [1, 0], [1, 1], [0, 1]]]),
        m.PLASTER,
        float(rng.uniform(0.3, 1.2)),
    )
    rim = panel(
        [x, -1.1, 2.2],
        [width, 0, 0],
        Z * 0.25,
        m.POSTER + int(rng.integers(m.POSTERS)),
        np.array([0, 0, 3, 0.3]),
    )
    return merge_meshes([cloth, rim])


def _poster(h: House, rng: np.random.Generator) -> Mesh:
    """Build a sign flat on the wall or standing out from it."""
    x, z, size = rng.uniform(0.3, h.width - 1.5), rng.uniform(1.2, 3.2), rng.uniform(0.5, 1.3)
    material, tiles = m.POSTER + int(rng.integers(m.POSTERS)), np.array([0.0, 0.0, 1.0, 1.0])
    if rng.random() < 0.4:
        return panel([x, -0.15 - size, z + 1], [0, size, 0], Z * size, material, tiles)
    return panel([x, -0.04, z], [size, 0, 0], Z * size * 0.8, material, tiles)
