"""Furniture and small things of a room.

A piece stands with the middle of its footprint on the origin, its back towards +y, its front towards -y, z up, metres.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam.simulation.world.mesh import Mesh, boxes, merge_meshes, panel, prism, quads
from slam.simulation.world.room_materials import PAPERS, PICTURES, SCREENS, SPINES, SPINES_OF_A_TEXTURE, RoomSurface

Array = NDArray[np.float64]
_WHOLE = (0.0, 0.0, 1.0, 1.0)  # tiles of a texture that is shown once
_ABOVE = 0.002  # metres by which painted panels lie before the surface that carries them


@dataclass(frozen=True)
class Piece:
    """A piece of furniture in its own frame.

    Attributes:
        mesh: triangles.
        size: (3,) width, depth and height, metres; nothing reaches beyond.
    """

    mesh: Mesh
    size: Array


def _piece(parts: list[Mesh]) -> Piece:
    """Combine parts, and move them so that the middle of the footprint is the origin."""
    mesh = merge_meshes(parts)
    low, high = mesh.corners.min(axis=(0, 1)), mesh.corners.max(axis=(0, 1))
    middle = (low + high) / 2 * [1.0, 1.0, 0.0]
    return Piece(mesh.transform(0.0, -middle), np.append((high - low)[:2], high[2]))


def blocks(low: ArrayLike, high: ArrayLike, material: int, tint: float | Array = 1.0, tile: float = 1.0) -> Mesh:
    """Axis-aligned boxes between `low` and `high` (N, 3), metres, closed below too; a tile covers `tile` metres."""
    a, b = (np.atleast_2d(np.asarray(end, dtype=np.float64)) for end in (low, high))
    x, y, z = np.stack([a[:, 0], b[:, 0]]), np.stack([a[:, 1], b[:, 1]]), a[:, 2]
    under = np.stack([np.stack([x[i], y[j], z], -1) for i, j in ((0, 1), (1, 1), (1, 0), (0, 0))], axis=1)
    return merge_meshes([boxes(a, b, material, tint, tile), quads(under, under[:, :, :2] / tile, material, tint)])


def _legs(width: float, depth: float, height: float, thick: float, material: int) -> Mesh:
    """Four legs at the corners of a footprint that starts at the origin."""
    at = np.array([[0, 0, 0], [width - thick, 0, 0], [0, depth - thick, 0], [width - thick, depth - thick, 0]])
    return blocks(at, at + np.array([thick, thick, height]), material, tile=0.6)


def table(rng: np.random.Generator, width: float = 1.3, depth: float = 0.8) -> Piece:
    """Build a table with things on it."""
    material, height = int(rng.choice([RoomSurface.WOOD, RoomSurface.DARK_WOOD, RoomSurface.LACQUER])), 0.74
    top = blocks([0, 0, height - 0.04], [width, depth, height], material, tile=0.9)
    rail = blocks([0.06, 0.06, height - 0.12], [width - 0.06, depth - 0.06, height - 0.04], material, 0.9, 0.9)
    parts = [top, rail, _legs(width, depth, height - 0.04, 0.06, material)]
    return _piece([*parts, *_clutter(rng, width, depth, height, int(rng.integers(5, 9)))])


def low_table(rng: np.random.Generator) -> Piece:
    """Build a table for a sofa."""
    material, width, depth, height = RoomSurface.DARK_WOOD, 0.9, 0.55, 0.42
    top = blocks([0, 0, height - 0.03], [width, depth, height], material, 1.4, tile=0.7)
    shelf = blocks([0.04, 0.04, 0.15], [width - 0.04, depth - 0.04, 0.17], material, 1.2, tile=0.7)
    parts = [top, shelf, _legs(width, depth, height - 0.03, 0.05, material)]
    return _piece([*parts, *_clutter(rng, width, depth, height, 4)])


def _clutter(rng: np.random.Generator, width: float, depth: float, height: float, count: int) -> list[Mesh]:
    """Papers, books, mugs and boxes in the cells of a grid on a surface, so that they do not meet."""
    cells = [(i, j) for i in range(max(1, int(width / 0.32))) for j in range(max(1, int(depth / 0.34)))]
    out = []
    for k in rng.permutation(len(cells))[:count]:
        i, j = cells[int(k)]
        at = np.array([0.16 + 0.32 * i, 0.17 + 0.34 * j, height])
        out.append(_THINGS[int(rng.integers(len(_THINGS)))](rng).transform(float(rng.uniform(-0.4, 0.4)), at))
    return out


def _paper(rng: np.random.Generator) -> Mesh:
    a, b = np.array([-0.1, -0.14, 0.003]), np.array([0.0, 0.0, 0.0])
    return panel(a + b, [0.2, 0, 0], [0, 0.28, 0], RoomSurface.PAPER + int(rng.integers(PAPERS)), _WHOLE)


def _lying_books(rng: np.random.Generator) -> Mesh:
    parts, z = [], 0.0
    for _ in range(int(rng.integers(1, 4))):
        w, d, h = rng.uniform(0.12, 0.19), rng.uniform(0.17, 0.25), rng.uniform(0.015, 0.045)
        parts.append(
            blocks([-w / 2, -d / 2, z], [w / 2, d / 2, z + h], RoomSurface.LACQUER, float(rng.uniform(0.2, 1.1)))
        )
        z += h
        cover = RoomSurface.PICTURE + int(rng.integers(PICTURES))
        parts.append(panel([-w / 2, -d / 2, z + 0.001], [w, 0, 0], [0, d, 0], cover, _WHOLE))
    return merge_meshes(parts)


def _mug(rng: np.random.Generator) -> Mesh:
    tint = float(rng.uniform(0.3, 1.2))
    wall = prism(0.04, 0.042, 0.1, RoomSurface.LACQUER, sides=12).scale_brightness(tint)
    handle = blocks([0.038, -0.008, 0.02], [0.07, 0.008, 0.08], RoomSurface.LACQUER, tint)
    return merge_meshes([wall, handle, _disc(0.04, 0.085, RoomSurface.DARK_WOOD)])


def _disc(radius: float, z: float, material: int, tint: float = 1.0, sides: int = 12) -> Mesh:
    """Horizontal disc above the origin."""
    a = np.linspace(0, 2 * np.pi, sides + 1)
    rim = np.stack([radius * np.cos(a), radius * np.sin(a), np.full_like(a, z)], -1)
    middle = np.tile([0.0, 0.0, z], (sides // 2, 1))
    corners = np.stack([middle, rim[:-1:2], rim[1::2], rim[2::2]], axis=1)
    return quads(corners, corners[:, :, :2] / (2 * radius) + 0.5, material, tint)


def _parcel(rng: np.random.Generator) -> Mesh:
    w, d, h = rng.uniform(0.08, 0.24), rng.uniform(0.08, 0.2), rng.uniform(0.06, 0.25)
    material = int(rng.choice([RoomSurface.CARTON, RoomSurface.PICTURE + int(rng.integers(PICTURES))]))
    return blocks([-w / 2, -d / 2, 0], [w / 2, d / 2, h], material, tile=0.25)


def _vase(rng: np.random.Generator) -> Mesh:
    height, tint = float(rng.uniform(0.15, 0.28)), float(rng.uniform(0.25, 1.2))
    body = prism(0.04, 0.07, height * 0.6, RoomSurface.RUG, sides=12)
    neck = prism(0.07, 0.035, height * 0.4, RoomSurface.RUG, sides=12).transform(0.0, np.array([0, 0, height * 0.6]))
    return merge_meshes([body, neck]).scale_brightness(tint)


_THINGS: tuple[Callable[[np.random.Generator], Mesh], ...] = (_paper, _lying_books, _mug, _parcel, _vase, _paper)


def chair(rng: np.random.Generator) -> Piece:
    """Build a chair of wood, cushioned or not."""
    material, seat = int(rng.choice([RoomSurface.WOOD, RoomSurface.DARK_WOOD])), RoomSurface.FABRIC
    parts = [_legs(0.42, 0.42, 0.44, 0.035, material), blocks([0, 0, 0.43], [0.42, 0.42, 0.46], material, tile=0.5)]
    if rng.random() < 0.6:
        parts.append(blocks([0.02, 0.02, 0.46], [0.40, 0.38, 0.5], seat, float(rng.uniform(0.7, 1.6)), 0.5))
    parts.append(blocks([[0, 0.385, 0.46], [0.385, 0.385, 0.46]], [[0.035, 0.42, 0.92], [0.42, 0.42, 0.92]], material))
    rails = np.array([0.56, 0.68, 0.8])
    low = np.stack([np.full(3, 0.035), np.full(3, 0.39), rails], -1)
    parts.append(blocks(low, low + np.array([0.35, 0.02, 0.075]), material, 1.1, 0.5))
    return _piece(parts)


def bookshelf(rng: np.random.Generator) -> Piece:
    """Build a shelf of several boards with books and things."""
    width, depth, height = float(rng.uniform(0.8, 1.2)), 0.3, float(rng.uniform(1.7, 2.1))
    material, rows = int(rng.choice([RoomSurface.WOOD, RoomSurface.DARK_WOOD, RoomSurface.LACQUER])), 5
    z = np.linspace(0.06, height - 0.025, rows + 1)
    ends = np.array([[0.0, 0.0, 0.0], [width - 0.025, 0.0, 0.0]])
    sides = blocks(ends, ends + np.array([0.025, depth, height]), material)
    low = np.stack([np.full(rows + 1, 0.025), np.zeros(rows + 1), z], -1)
    boards = blocks(low, low + np.array([width - 0.05, depth, 0.025]), material, tile=0.8)
    back = panel([0, depth - 0.01, 0], [width, 0, 0], [0, 0, height], material, (0, 0, width, height), 0.8)
    parts = [sides, boards, back]
    for row in range(rows):
        parts += _row_of_books(rng, width - 0.05, z[row] + 0.025, z[row + 1] - z[row] - 0.045)
    return _piece(parts)


def _row_of_books(rng: np.random.Generator, width: float, z: float, height: float) -> list[Mesh]:
    """Books beside each other on a board that starts at x = 0.025, with gaps and things between."""
    parts, x, end = [], 0.03, 0.025 + width
    while x < end - 0.09:
        if rng.random() < 0.06:
            parts.append(
                _THINGS[int(rng.integers(2, 4))](rng)
                .scale_brightness(0.9)
                .transform(0.0, np.array([x + 0.12, 0.15, z]), 0.8)
            )
            x += 0.26
            continue
        w, h, front = rng.uniform(0.018, 0.055), height * rng.uniform(0.62, 0.98), rng.uniform(0.02, 0.08)
        tint, column = float(rng.uniform(0.25, 1.1)), int(rng.integers(SPINES_OF_A_TEXTURE))
        parts.append(blocks([x, front, z], [x + w, 0.27, z + h], RoomSurface.LACQUER, tint))
        u = column / SPINES_OF_A_TEXTURE
        tiles = (u, 0.0, u + 1 / SPINES_OF_A_TEXTURE, 1.0)
        spine = RoomSurface.SPINE + int(rng.integers(SPINES))
        parts.append(panel([x, front - _ABOVE, z], [w, 0, 0], [0, 0, h], spine, tiles))
        x += w + (0.001 if rng.random() < 0.9 else rng.uniform(0.03, 0.15))
    return parts


def cupboard(rng: np.random.Generator) -> Piece:
    """Build a sideboard or a wardrobe with fronts; things stand on a low one."""
    high = rng.random() < 0.4
    width, depth = float(rng.uniform(0.8, 1.3)), float(rng.uniform(0.38, 0.55))
    height = 1.95 if high else float(rng.uniform(0.75, 0.95))
    tint = float(rng.uniform(0.6, 1.4))
    body = blocks([0, 0, 0.06], [width, depth, height], RoomSurface.WOOD, tint, 0.9)
    foot = blocks([0.03, 0.04, 0], [width - 0.03, depth, 0.06], RoomSurface.BLACK)
    front = panel([0.01, -0.012, 0.07], [width - 0.02, 0, 0], [0, 0, height - 0.09], RoomSurface.FRONT, _WHOLE, tint)
    rim = blocks([0.01, -0.01, 0.07], [width - 0.01, 0, height - 0.02], RoomSurface.WOOD, tint)
    parts = [body, foot, rim, front]
    return _piece(parts if high else parts + _clutter(rng, width, depth, height, 3))


def desk(rng: np.random.Generator) -> Piece:
    """Build a desk with a screen, a keyboard, a lamp and papers."""
    width, depth, height = float(rng.uniform(1.2, 1.6)), 0.7, 0.73
    material = int(rng.choice([RoomSurface.WOOD, RoomSurface.LACQUER]))
    top = blocks([0, 0, height - 0.03], [width, depth, height], material, tile=0.9)
    drawers = blocks([width - 0.42, 0.05, 0.05], [width - 0.02, depth - 0.02, height - 0.03], material, 0.9, 0.9)
    front = panel([width - 0.42, 0.048, 0.05], [0.4, 0, 0], [0, 0, height - 0.08], RoomSurface.FRONT, _WHOLE, 0.9)
    legs = _legs(width, depth, height - 0.03, 0.05, RoomSurface.METAL)
    keys = blocks([0.32, 0.12, height], [0.76, 0.27, height + 0.02], RoomSurface.BLACK)
    key_top = panel([0.32, 0.12, height + 0.022], [0.44, 0, 0], [0, 0.15, 0], RoomSurface.KEYBOARD, _WHOLE)
    screen = monitor(rng, 0.56, 0.33).transform(0.0, np.array([0.54, 0.5, height]))
    things = [_THINGS[int(k)](rng) for k in rng.integers(0, len(_THINGS), 3)]
    spots = ([0.14, 0.2, height], [width - 0.2, 0.2, height], [width - 0.2, 0.5, height])
    placed = [t.transform(0.2, np.array(at)) for t, at in zip(things, spots, strict=True)]
    return _piece([top, drawers, front, legs, keys, key_top, screen, *placed])


def monitor(rng: np.random.Generator, width: float, height: float) -> Mesh:
    """Build a screen on a foot, with its middle above the origin."""
    foot = blocks([-0.12, -0.08, 0], [0.12, 0.1, 0.015], RoomSurface.BLACK)
    neck = blocks([-0.03, 0.03, 0.015], [0.03, 0.06, 0.15], RoomSurface.BLACK)
    case = blocks([-width / 2, -0.01, 0.1], [width / 2, 0.03, 0.12 + height], RoomSurface.BLACK)
    picture = RoomSurface.SCREEN + int(rng.integers(SCREENS))
    glass = panel(
        [-width / 2 + 0.012, -0.01 - _ABOVE, 0.112], [width - 0.024, 0, 0], [0, 0, height - 0.01], picture, _WHOLE
    )
    return merge_meshes([foot, neck, case, glass])


def media_board(rng: np.random.Generator) -> Piece:
    """Build a low board with a television."""
    width, depth, height = 1.5, 0.4, 0.5
    body = blocks([0, 0, 0.05], [width, depth, height], RoomSurface.DARK_WOOD, 1.5, 0.8)
    front = panel([0, -_ABOVE, 0.06], [width, 0, 0], [0, 0, height - 0.08], RoomSurface.FRONT, (0, 0, 2, 1), 0.7)
    foot = blocks([0.05, 0.05, 0], [width - 0.05, depth - 0.02, 0.05], RoomSurface.BLACK)
    tv = monitor(rng, 1.05, 0.6).transform(0.0, np.array([0.7, 0.2, height]))
    thing = _vase(rng).transform(0.0, np.array([1.38, 0.2, height]))
    return _piece([body, front, foot, tv, thing])


def sofa(rng: np.random.Generator) -> Piece:
    """Build a sofa with cushions."""
    width, depth, tint = float(rng.uniform(1.5, 1.95)), 0.85, float(rng.uniform(0.7, 1.5))
    cloth = RoomSurface.FABRIC
    base = blocks([0, 0, 0.08], [width, depth, 0.28], cloth, tint * 0.9, 0.8)
    back = blocks([0.0, depth - 0.2, 0.28], [width, depth, 0.82], cloth, tint, 0.8)
    arms = blocks(
        [[0, 0, 0.28], [width - 0.18, 0, 0.28]], [[0.18, depth - 0.2, 0.6], [width, depth - 0.2, 0.6]], cloth, tint, 0.8
    )
    half = width / 2
    seats = blocks(
        [[0.185, -0.02, 0.28], [half + 0.005, -0.02, 0.28]],
        [[half - 0.005, depth - 0.21, 0.44], [width - 0.185, depth - 0.21, 0.44]],
        cloth, tint * 1.1, 0.8,
    )  # fmt: skip
    feet = _legs(width, depth, 0.08, 0.06, RoomSurface.DARK_WOOD)
    parts = [base, back, arms, seats, feet]
    for x in (0.4, width - 0.42):
        corner = [
            [x - 0.19, depth - 0.4, 0.44],
            [x + 0.19, depth - 0.4, 0.44],
            [x + 0.19, depth - 0.24, 0.8],
            [x - 0.19, depth - 0.24, 0.8],
        ]
        pillow = RoomSurface.RUG if rng.random() < 0.5 else RoomSurface.PICTURE + int(rng.integers(PICTURES))
        face = np.array([corner])
        parts.append(quads(face, np.array([[[0, 0], [1, 0], [1, 1], [0, 1]]]), pillow))
        sides = [face[0][[0, 3]], face[0][[1, 2]]]
        for low, high in sides:
            wedge = np.array([[low, high, [low[0], depth - 0.2, 0.8], [low[0], depth - 0.2, 0.44]]])
            parts.append(quads(wedge, np.array([[[0, 0], [0, 0.4], [0.2, 0.4], [0.2, 0]]]), cloth, tint * 0.8))
        lid = np.array([[face[0][3], face[0][2], [x + 0.19, depth - 0.2, 0.8], [x - 0.19, depth - 0.2, 0.8]]])
        parts.append(quads(lid, np.array([[[0, 0], [0.4, 0], [0.4, 0.1], [0, 0.1]]]), cloth, tint * 0.8))
    return _piece(parts)


def bed(rng: np.random.Generator) -> Piece:
    """Build a bed whose head is at the wall."""
    width, length = float(rng.choice([1.0, 1.5])), 2.05
    frame = blocks([0, 0, 0.12], [width, length, 0.32], RoomSurface.WOOD, tile=0.8)
    head = blocks([0, length, 0], [width, length + 0.05, 0.95], RoomSurface.WOOD, tile=0.8)
    mattress = blocks([0.03, 0.03, 0.32], [width - 0.03, length - 0.02, 0.48], RoomSurface.LACQUER)
    blanket = blocks([-0.02, -0.02, 0.3], [width + 0.02, length * 0.68, 0.53], RoomSurface.FABRIC, 1.2, 0.7)
    count = 1 if width < 1.2 else 2
    x = (np.arange(count) + 0.5) * width / count
    low = np.stack([x - 0.3, np.full(count, length - 0.5), np.full(count, 0.48)], -1)
    pillows = blocks(low, low + np.array([0.6, 0.42, 0.12]), RoomSurface.CURTAIN, 1.3, 0.5)
    return _piece([frame, head, mattress, blanket, pillows, _legs(width, length, 0.12, 0.07, RoomSurface.WOOD)])


def plant(rng: np.random.Generator) -> Piece:
    """Build a plant in a pot: leaves at the ends of bent stalks."""
    pot = prism(0.12, 0.17, 0.32, RoomSurface.LACQUER, sides=12).scale_brightness(float(rng.uniform(0.3, 1.0)))
    soil = _disc(0.165, 0.29, RoomSurface.DARK_WOOD, 0.7)
    corners = []
    for _ in range(46):
        angle, out, z = rng.uniform(0, 2 * np.pi), rng.uniform(0.03, 0.33), rng.uniform(0.45, 1.25)
        along = np.array([np.cos(angle), np.sin(angle), rng.uniform(-0.5, 0.5)]) * rng.uniform(0.1, 0.2)
        across = np.cross(along, [0, 0, 1.0]) * rng.uniform(0.4, 0.6)
        foot = np.array([out * np.cos(angle), out * np.sin(angle), z])
        corners.append([foot, foot + along / 2 + across, foot + along, foot + along / 2 - across])
    part = rng.uniform(0, 0.7, (46, 1, 2)) + np.array([[0, 0], [0.3, 0], [0.3, 0.3], [0, 0.3]])
    leaves = quads(np.array(corners), part, RoomSurface.LEAF, rng.uniform(0.7, 1.8, 46))
    stalks = [
        prism(0.012, 0.008, 0.95, RoomSurface.DARK_WOOD, sides=5).transform(0.0, np.array([x, 0.0, 0.28]))
        for x in (-0.04, 0.05)
    ]
    return _piece([pot, soil, leaves, *stalks])


def floor_lamp(rng: np.random.Generator) -> Piece:
    """Build a lamp on a stand; its shade glows."""
    stand = prism(0.015, 0.015, 1.45, RoomSurface.METAL, sides=8)
    foot = blocks([-0.14, -0.14, 0], [0.14, 0.14, 0.025], RoomSurface.METAL)
    shade = prism(0.2, 0.13, 0.28, RoomSurface.LAMP, sides=16).transform(0.0, np.array([0, 0, 1.42]))
    return _piece([stand, foot, shade.scale_brightness(float(rng.uniform(0.55, 0.75)))])


def cartons(rng: np.random.Generator) -> Piece:
    """Build a small stack of boxes."""
    parts, z = [], 0.0
    for _ in range(int(rng.integers(1, 4))):
        w, d, h = rng.uniform(0.3, 0.45), rng.uniform(0.3, 0.4), rng.uniform(0.2, 0.34)
        box = blocks([-w / 2, -d / 2, z], [w / 2, d / 2, z + h], RoomSurface.CARTON, float(rng.uniform(0.8, 1.2)), 0.45)
        parts.append(box.transform(float(rng.uniform(-0.2, 0.2)), np.zeros(3)))
        z += h
    return _piece(parts)


WALL_PIECES: tuple[Callable[[np.random.Generator], Piece], ...] = (
    bookshelf, desk, cupboard, sofa, bookshelf, media_board, cupboard, plant, bed, cartons, floor_lamp, chair, plant,
)  # fmt: skip
"""What stands at walls, in the order in which it is placed as long as there is room."""
