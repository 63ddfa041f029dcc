"""Builds a furnished room with a window, and a corridor behind its door.

Room frame: the origin is a corner of the room on the floor, x and y along its walls, z up, metres. The room is
[0, length] x [0, width]; the corridor lies behind the wall y = width.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from slam.simulation.scenario.room_config import RoomConfig
from slam.simulation.world.furniture import WALL_PIECES, Piece, blocks, chair, low_table, table
from slam.simulation.world.mesh import Mesh, merge_meshes, panel, quads
from slam.simulation.world.room_materials import PAPERS, PICTURES, RoomSurface

Array = NDArray[np.float64]
Rectangle = tuple[float, float, float, float]  # low u, low z, high u, high z on a wall, metres

WALL_THICKNESS_M = 0.14
DOOR_WIDTH_M, DOOR_HEIGHT_M = 1.3, 2.1
_GAP_M = 0.03  # between neighbouring pieces, and behind them
_TRIES = 30  # places that are tried for each piece
_APPROACH_M = 1.5  # kept free before the door


@dataclass(frozen=True)
class Room:
    """A room with its corridor.

    Attributes:
        meshes: what can be seen, one mesh for each object.
        obstacles: (N, 2, 3) low and high corners of boxes around what stands or hangs there, metres.
        floors: (F, 4) rectangles of which the floor consists: low x, low y, high x, high y.
        door: (2,) middle of the doorway on the floor, metres.
        corridor: low x, low y, high x, high y of the corridor.
        height: of room and corridor, metres.
        window: (2, 3) low and high corner of the opening in the wall, metres.
        sights: (S, 3) what is worth looking at, metres.
    """

    meshes: list[Mesh]
    obstacles: Array
    floors: Array
    door: Array
    corridor: Array
    height: float
    window: Array
    sights: Array


@dataclass(frozen=True)
class _Wall:
    """A wall seen from inside: u runs from `origin` to the left, z up."""

    origin: Array  # (2,)
    along: Array  # (2,) unit
    length: float

    @property
    def inward(self) -> Array:
        """(2,) unit normal into the room."""
        return np.array([-self.along[1], self.along[0]])

    def at(self, u: float, out: float, z: float) -> Array:
        """Point (3,) at u along the wall, `out` metres before it, at height z."""
        return np.append(self.origin + u * self.along + out * self.inward, z)

    def rectangle(self, r: Rectangle, out: float, material: int, tiles: Rectangle, tint: float = 1.0) -> Mesh:
        """Panel that covers a rectangle of the wall, its texture upright and not mirrored."""
        along = np.append(self.along, 0.0) * (r[0] - r[2])
        return panel(self.at(r[2], out, r[1]), along, [0, 0, r[3] - r[1]], material, tiles, tint)

    def box(self, r: Rectangle, out: tuple[float, float], material: int, tint: float = 1.0, tile: float = 1.0) -> Mesh:
        """Box on a rectangle of the wall, from out[0] to out[1] metres before it."""
        ends = np.stack([self.at(r[0], out[0], r[1]), self.at(r[2], out[1], r[3])])
        return blocks(ends.min(axis=0), ends.max(axis=0), material, tint, tile)


@lru_cache(maxsize=8)
def build_room(seed: int) -> Room:
    """Build the room of a seed."""
    return _RoomBuilder(RoomConfig(seed=seed).rng(31)).build()


class _RoomBuilder:
    """Draws the measures of a room and fills it."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.boards = rng, rng.spawn(1)[0]
        self.length, self.width = float(rng.uniform(4.6, 8.0)), float(rng.uniform(4.2, 7.0))
        self.height = float(rng.uniform(2.5, 3.0))
        L, W = self.length, self.width
        self.walls = [
            _Wall(np.array([0.0, 0.0]), np.array([1.0, 0.0]), L),
            _Wall(np.array([L, 0.0]), np.array([0.0, 1.0]), W),
            _Wall(np.array([L, W]), np.array([-1.0, 0.0]), L),
            _Wall(np.array([0.0, W]), np.array([0.0, -1.0]), W),
        ]
        self.door_u = float(rng.uniform(0.3, L - DOOR_WIDTH_M - 0.3))  # on wall 2
        self.window_wall = int(rng.choice([0, 1, 3]))
        free = self.walls[self.window_wall].length - 1.0
        size = min(float(rng.uniform(1.4, 2.4)), free)
        u = 0.5 + float(rng.uniform(0, free - size))
        self.window: Rectangle = (u, 0.9, u + size, float(rng.uniform(2.05, 2.25)))
        self.accent = int(rng.integers(4))
        self.meshes: list[Mesh] = []
        self.obstacles: list[Array] = []
        self.sights: list[Array] = []
        self.taken: list[tuple[int, Rectangle]] = []  # wall and rectangle that something covers

    def build(self) -> Room:
        """Build everything."""
        L, W, c0 = self.length, self.width, self.width + WALL_THICKNESS_M
        c = np.array(
            [
                float(self.rng.uniform(-3.0, -1.5)),
                c0,
                L + float(self.rng.uniform(1.0, 2.5)),
                c0 + float(self.rng.uniform(1.7, 2.1)),
            ]
        )
        door_x = L - self.door_u - DOOR_WIDTH_M / 2
        self.corridor, self.door = c, np.array([door_x, W + WALL_THICKNESS_M / 2])
        half = DOOR_WIDTH_M / 2
        floors = np.array([[0, 0, L, W], [door_x - half, W - 0.01, door_x + half, c0 + 0.01], c])
        self._shell()
        self._furnish_corridor()
        self._furnish()
        self._hang_pictures()
        self._lamps()
        low, high = (
            self.walls[self.window_wall].at(self.window[0], 0.0, self.window[1]),
            self.walls[self.window_wall].at(self.window[2], 0.0, self.window[3]),
        )
        window = np.stack([np.minimum(low, high), np.maximum(low, high)])
        return Room(
            self.meshes, np.array(self.obstacles), floors, self.door, c, self.height, window, np.array(self.sights)
        )

    # What the room is made of.

    def _shell(self) -> None:
        L, W, H = self.length, self.width, self.height
        floor_tile = 2.0
        self._add(panel([0, 0, 0], [L, 0, 0], [0, W, 0], RoomSurface.FLOOR, (0, 0, L / floor_tile, W / floor_tile)))
        self._add(panel([0, 0, H], [L, 0, 0], [0, W, 0], RoomSurface.CEILING, (0, 0, L / 3, W / 3)))
        door = (self.door_u, 0.0, self.door_u + DOOR_WIDTH_M, DOOR_HEIGHT_M)
        for k, wall in enumerate(self.walls):
            holes = [door] if k == 2 else [self.window] if k == self.window_wall else []
            material = RoomSurface.ACCENT_WALL if k == self.accent else RoomSurface.WALL
            self._plaster(wall, H, holes, material)
            self._skirting(wall, holes if k == 2 else [])
        self._frame_of_the_window()
        self._frame_of_the_door()

    def _plaster(self, wall: _Wall, height: float, holes: list[Rectangle], material: int) -> None:
        """Cover a wall around its openings."""
        tile = 2.0
        for r in _around(wall.length, height, holes):
            self._add(wall.rectangle(r, 0.0, material, (r[0] / tile, r[1] / tile, r[2] / tile, r[3] / tile)))

    def _skirting(self, wall: _Wall, holes: list[Rectangle], tint: float = 1.0) -> None:
        for r in _around(wall.length, 0.08, [(h[0] - 0.1, 0.0, h[2] + 0.1, 1.0) for h in holes]):
            self._add(wall.box(r, (0.0, 0.014), RoomSurface.DARK_WOOD if tint < 1 else RoomSurface.LACQUER))

    def _frame_of_the_window(self) -> None:
        """Reveal, frame with bars, sill, radiator and curtains; what is seen through it is far away."""
        wall, (u0, z0, u1, z1) = self.walls[self.window_wall], self.window
        deep = (-WALL_THICKNESS_M, 0.0)
        middle = (u0 + u1) / 2
        parts = [
            wall.box(r, (-0.22, 0.0), RoomSurface.LACQUER)
            for r in ((u0 - 0.01, z0, u0, z1), (u1, z0, u1 + 0.01, z1), (u0, z1, u1, z1 + 0.01))
        ]
        bars = [(u0, z0, u1, z0 + 0.06), (u0, z1 - 0.06, u1, z1), (u0, z0, u0 + 0.06, z1), (u1 - 0.06, z0, u1, z1)]
        bars += [(middle - 0.05, z0, middle + 0.05, z1), (u0, z0 + 0.72 * (z1 - z0), u1, z0 + 0.72 * (z1 - z0) + 0.05)]
        parts += [wall.box(r, (deep[0] - 0.02 * (k % 3), -0.06), RoomSurface.LACQUER, 1.05) for k, r in enumerate(bars)]
        parts.append(wall.box((u0 - 0.08, z0 - 0.035, u1 + 0.08, z0), (-0.2, 0.16), RoomSurface.LACQUER, 1.0))
        self._add(merge_meshes(parts))
        ribs = np.arange(u0 + 0.1, u1 - 0.16, 0.075)
        radiator = [
            wall.box((float(u), 0.12, float(u) + 0.055, 0.72), (0.04, 0.11), RoomSurface.LACQUER, 0.95) for u in ribs
        ]
        radiator.append(wall.box((u0 + 0.1, 0.2, u1 - 0.1, 0.25), (0.06, 0.09), RoomSurface.LACQUER, 0.9))
        self._add(merge_meshes(radiator))
        self._block(wall.at(u0, 0.0, 0.0), wall.at(u1, 0.16, z0))
        for a, b in ((u0 - 0.3, u0 + 0.12), (u1 - 0.12, u1 + 0.3)):
            self._add(_curtain(wall, a, b, z1 + 0.12, self.rng))
            self._block(wall.at(a, 0.1, 0.0), wall.at(b, 0.24, z1))
        self._add(wall.box((u0 - 0.35, z1 + 0.12, u1 + 0.35, z1 + 0.15), (0.14, 0.18), RoomSurface.METAL))
        self.taken.append((self.window_wall, (u0 - 0.35, 0.0, u1 + 0.35, 2.6)))
        self.sights.append(wall.at((u0 + u1) / 2, 0.0, 1.3))

    def _frame_of_the_door(self) -> None:
        wall, u0, u1 = self.walls[2], self.door_u, self.door_u + DOOR_WIDTH_M
        thick = (-WALL_THICKNESS_M - 0.02, 0.02)
        top = DOOR_HEIGHT_M
        parts = [
            wall.box((u0 - 0.07, 0.0, u0, top + 0.07), thick, RoomSurface.LACQUER),
            wall.box((u1, 0.0, u1 + 0.07, top + 0.07), thick, RoomSurface.LACQUER),
            wall.box((u0, top, u1, top + 0.07), thick, RoomSurface.LACQUER),
        ]
        sill = panel(
            wall.at(u0, -WALL_THICKNESS_M, 0.0),
            np.append(wall.along, 0) * DOOR_WIDTH_M,
            np.append(wall.inward, 0) * WALL_THICKNESS_M,
            RoomSurface.DARK_WOOD,
            (0, 0, 1, 0.2),
        )
        self._add(merge_meshes([*parts, sill]))
        self.taken.append((2, (u0 - 0.1, 0.0, u1 + 0.1, 2.4)))
        self.taken.append((2, (u0 - 0.4, 0.0, u1 + 0.4, 1.2)))
        middle = wall.at((u0 + u1) / 2, 0.0, 1.3)
        self.sights.append(middle)
        # Nothing may stand before the door; the box is no obstacle to the camera.
        self.approach = np.stack([wall.at(u1 + 0.05, 0.0, 0.0), wall.at(u0 - 0.05, _APPROACH_M, 2.0)])

    def _wainscot(self, wall: _Wall, holes: list[Rectangle]) -> None:
        """Cover the lower part of a wall with boards and battens, which a robot sees where pictures hang too high."""
        tint = float(self.boards.uniform(0.9, 1.4))
        beside = [(h[0] - 0.1, 0.0, h[2] + 0.1, 2.0) for h in holes]
        for u0, z0, u1, z1 in _around(wall.length, 0.95, beside):
            if z0 > 0.0 or u1 - u0 < 0.1:
                continue
            self._add(wall.rectangle((u0, z0, u1, z1), 0.004, RoomSurface.WOOD, (u0, z0, u1, z1), tint))
            parts = [wall.box((u0, z1 - 0.04, u1, z1), (0.0, 0.03), RoomSurface.WOOD, 0.8 * tint)]
            u = u0
            while u < u1 - 0.05:
                parts.append(wall.box((u, 0.08, u + 0.04, z1 - 0.04), (0.0, 0.016), RoomSurface.WOOD, 0.75 * tint))
                u += float(self.boards.uniform(0.22, 0.4))
            self._add(merge_meshes(parts))

    # What stands in it.

    def _furnish(self) -> None:
        rng = self.rng
        boxes = [self._ordered(*self.approach)]
        boxes += [box for box in self.obstacles if box[0, 1] < self.width]
        for build in WALL_PIECES:
            piece = build(rng)
            place = self._find_place(piece, boxes)
            if place is not None:
                boxes.append(place)
        if min(self.length, self.width) > 5.2:
            self._table_in_the_middle(boxes)
        else:
            self._rug(np.array([self.length / 2, self.width / 2]))

    def _find_place(self, piece: Piece, boxes: list[Array]) -> Array | None:
        """Place a piece at a wall where nothing else stands; return its box, or None if no place was found."""
        rng, (w, d, h) = self.rng, piece.size
        for _ in range(_TRIES):
            k = int(rng.integers(4))
            wall = self.walls[k]
            if wall.length < w + 0.1:
                continue
            u = float(rng.uniform(0.05, wall.length - w - 0.05))
            covers = (u, 0.0, u + w, h)
            if any(k == other and _overlap(covers, r) for other, r in self.taken):
                continue
            box = self._ordered(wall.at(u, _GAP_M, 0.0), wall.at(u + w, _GAP_M + d, h))
            grown = box + np.array([[-_GAP_M, -_GAP_M, 0], [_GAP_M, _GAP_M, 0]])
            if any((grown[0, :2] < b[1, :2]).all() and (b[0, :2] < grown[1, :2]).all() for b in boxes):
                continue
            yaw = float(np.arctan2(wall.inward[1], wall.inward[0]) + np.pi / 2)
            self._add(piece.mesh.transform(yaw, wall.at(u + w / 2, _GAP_M + d / 2, 0.0)))
            self._block(*box)
            self.taken.append((k, covers))
            self.sights.append(wall.at(u + w / 2, _GAP_M + d / 2, 0.8 * h))
            return box
        return None

    def _table_in_the_middle(self, boxes: list[Array]) -> None:
        """Place a table with chairs, on a rug, as far from everything else as possible."""
        rng = self.rng
        piece = table(rng, float(rng.uniform(1.1, 1.5))) if rng.random() < 0.7 else low_table(rng)
        half = piece.size[:2] / 2
        best, best_gap = np.zeros(2), -1.0
        for _ in range(60):
            at = rng.uniform([1.0, 1.0], [self.length - 1.0, self.width - 1.0])
            gaps = [np.maximum(np.maximum(b[0, :2] - at - half, at - half - b[1, :2]), 0) for b in boxes]
            gap = min(float(np.hypot(*g)) for g in gaps)
            if gap > best_gap:
                best, best_gap = at, gap
        if best_gap < 1.25:
            return
        self._rug(best)
        self._put(piece, best, 0.0)
        if piece.size[2] < 0.6:
            return
        for side, x in ((1, -0.25), (-1, 0.25), (1, 0.35), (-1, -0.35)):
            seat = chair(rng)
            if abs(x) > 0.3 and rng.random() < 0.6:
                continue
            away = half[1] + 0.1 + float(rng.uniform(0.0, 0.08))
            x = x * 1.3 if abs(x) < 0.3 else x
            self._put(
                seat, best + np.array([x, side * away]), (0.0 if side > 0 else np.pi) + float(rng.uniform(-0.15, 0.15))
            )
            if abs(x) <= 0.3 * 1.3 and rng.random() < 0.5:
                break

    def _put(self, piece: Piece, at: Array, yaw: float) -> None:
        mesh = piece.mesh.transform(yaw, np.append(at, 0.0))
        self._add(mesh)
        self._block(mesh.corners.min(axis=(0, 1)), mesh.corners.max(axis=(0, 1)))
        self.sights.append(np.append(at, 0.6 * piece.size[2]))

    def _rug(self, at: Array) -> None:
        w, d = float(self.rng.uniform(1.6, 2.4)), float(self.rng.uniform(1.2, 1.7))
        low, high = at - np.array([w, d]) / 2, at + np.array([w, d]) / 2
        self._add(panel([*low, 0.008], [w, 0, 0], [0, d, 0], RoomSurface.RUG, (0, 0, 1, 1)))
        self._add(blocks([*low, 0.0], [*high, 0.0075], RoomSurface.FABRIC, 0.6))

    def _furnish_corridor(self) -> None:
        """Walls, doors, pictures and a cupboard of the corridor."""
        rng, (x0, y0, x1, y1), H = self.rng, self.corridor, self.height
        length, width = x1 - x0, y1 - y0
        self._add(
            panel(
                [x0, y0, 0],
                [length, 0, 0],
                [0, width, 0],
                RoomSurface.CORRIDOR_FLOOR,
                (0, 0, length / 1.2, width / 1.2),
            )
        )
        self._add(panel([x0, y0, H], [length, 0, 0], [0, width, 0], RoomSurface.CEILING, (0, 0, length / 3, width / 3)))
        hole = (self.door[0] - DOOR_WIDTH_M / 2 - x0, 0.0, self.door[0] + DOOR_WIDTH_M / 2 - x0, DOOR_HEIGHT_M)
        walls = [
            (_Wall(np.array([x0, y0]), np.array([1.0, 0.0]), length), [hole]),
            (_Wall(np.array([x1, y0]), np.array([0.0, 1.0]), width), []),
            (_Wall(np.array([x1, y1]), np.array([-1.0, 0.0]), length), []),
            (_Wall(np.array([x0, y1]), np.array([0.0, -1.0]), width), []),
        ]
        across, end = walls[2][0], walls[1][0]
        opposite = x1 - self.door[0]  # u of the door on the wall across
        doors = [(u, 0.0, u + 0.95, 2.05) for u in (opposite - 2.3, opposite + 1.3) if 0.2 < u < length - 1.2]
        for wall, holes in walls:
            self._plaster(wall, H, holes, RoomSurface.WALL)
            self._skirting(wall, holes, 0.5)
            self._wainscot(wall, holes + (doors if wall is across else []))
        for door in doors:
            u = door[0]
            self._add(across.rectangle(door, 0.012, RoomSurface.DOOR, (0, 0, 1, 1)))
            self._add(across.box((u - 0.07, 0.0, u + 1.02, 2.12), (0.0, 0.01), RoomSurface.LACQUER))
        self._picture(across, (opposite - 1.0, 1.1, opposite - 0.1, 1.9))
        self._picture(across, (opposite + 0.15, 1.2, opposite + 0.85, 2.0))
        self._picture(end, (0.4, 1.2, width - 0.4, 2.0))
        for u in (hole[2] + 0.35, hole[0] - 1.15):
            if 0.1 < u < length - 1.0:
                self._picture(walls[0][0], (u, 1.2, u + 0.75, 1.9))
        self._picture(walls[3][0], (0.5, 1.2, width - 0.5, 1.8))
        for piece, u in ((WALL_PIECES[0](rng), 0.3), (WALL_PIECES[7](rng), 0.3)):
            wall = end if piece.size[2] > 1.5 else walls[3][0]
            w, d, h = piece.size
            yaw = float(np.arctan2(wall.inward[1], wall.inward[0]) + np.pi / 2)
            self._add(piece.mesh.transform(yaw, wall.at(u + w / 2, _GAP_M + d / 2, 0.0)))
            self._block(wall.at(u, _GAP_M, 0.0), wall.at(u + w, _GAP_M + d, h))

    def _hang_pictures(self) -> None:
        """Hang pictures, papers and a clock on walls; one wall stays bare where nothing stands."""
        rng, bare = self.rng, int(self.rng.integers(4))
        for k, wall in enumerate(self.walls):
            for _ in range(0 if k == bare else int(rng.integers(8, 20))):
                w = float(rng.uniform(0.25, 0.95))
                h, z = w * float(rng.choice([0.7, 1.0, 1.35])), float(rng.uniform(1.0, 1.65))
                u = float(rng.uniform(0.15, max(0.16, wall.length - w - 0.15)))
                r = (u, z, u + w, min(z + h, self.height - 0.25))
                spot = (r[0] - 0.08, r[1] - 0.08, r[2] + 0.08, r[3] + 0.08)
                if u + w > wall.length - 0.1 or any(k == other and _overlap(spot, t) for other, t in self.taken):
                    continue
                self._picture(wall, r)
                self.taken.append((k, spot))
                self.sights.append(wall.at((r[0] + r[2]) / 2, 0.0, (r[1] + r[3]) / 2))
            if k != self.window_wall:
                u = float(rng.uniform(0.3, wall.length - 0.4))
                self._add(wall.box((u, 0.28, u + 0.08, 0.36), (0.0, 0.012), RoomSurface.LACQUER, 1.15))

    def _picture(self, wall: _Wall, r: Rectangle) -> None:
        """Hang a framed picture, or a sheet of paper if it is small."""
        rng = self.rng
        if r[2] - r[0] < 0.34:
            self._add(wall.rectangle(r, 0.003, RoomSurface.PAPER + int(rng.integers(PAPERS)), (0, 0, 1, 1)))
            return
        edge, frame = (
            0.025,
            int(rng.choice([RoomSurface.DARK_WOOD, RoomSurface.WOOD, RoomSurface.BLACK, RoomSurface.LACQUER])),
        )
        inner = (r[0] + edge, r[1] + edge, r[2] - edge, r[3] - edge)
        rims = (
            (r[0], r[1], r[2], inner[1]),
            (r[0], inner[3], r[2], r[3]),
            (r[0], inner[1], inner[0], inner[3]),
            (inner[2], inner[1], r[2], inner[3]),
        )
        parts = [wall.box(rim, (0.0, 0.025), frame, 1.2) for rim in rims]
        parts.append(wall.rectangle(inner, 0.012, RoomSurface.PICTURE + int(rng.integers(PICTURES)), (0, 0, 1, 1)))
        self._add(merge_meshes(parts))

    def _lamps(self) -> None:
        """Hang lamps from the ceilings of room and corridor."""
        H, (x0, y0, x1, y1) = self.height, self.corridor
        count = 1 if self.length < 5.5 else 2
        spots = [((k + 0.5) * self.length / count, self.width / 2) for k in range(count)]
        spots += [(x0 + (k + 0.5) * (x1 - x0) / 3, (y0 + y1) / 2) for k in range(3)]
        for k, (x, y) in enumerate(spots):
            w, d = (0.6, 0.3) if k < count else (0.25, 0.25)
            low, high = np.array([x - w / 2, y - d / 2, H - 0.1]), np.array([x + w / 2, y + d / 2, H - 0.02])
            rim = blocks([*low[:2], H - 0.02], [*high[:2], H], RoomSurface.METAL)
            self._add(merge_meshes([rim, blocks(low, high, RoomSurface.LAMP)]))
            self._block(low, [*high[:2], H])

    def _add(self, mesh: Mesh) -> None:
        self.meshes.append(mesh)

    def _block(self, a: Array, b: Array | list[float]) -> None:
        self.obstacles.append(self._ordered(a, b))

    @staticmethod
    def _ordered(a: Array, b: Array | list[float]) -> Array:
        ends = np.stack([np.asarray(a, float), np.asarray(b, float)])
        return np.stack([ends.min(axis=0), ends.max(axis=0)])


def _overlap(a: Rectangle, b: Rectangle) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def _around(length: float, height: float, holes: list[Rectangle]) -> list[Rectangle]:
    """Rectangles that cover a wall except its openings."""
    if not holes:
        return [(0.0, 0.0, length, height)]
    out, u = [], 0.0
    for u0, z0, u1, z1 in sorted(holes):
        out += [(u, 0.0, u0, height), (u0, 0.0, u1, z0), (u0, min(z1, height), u1, height)]
        u = u1
    out.append((u, 0.0, length, height))
    return [r for r in out if r[2] - r[0] > 1e-6 and r[3] - r[1] > 1e-6]


def _curtain(wall: _Wall, a: float, b: float, top: float, rng: np.random.Generator) -> Mesh:
    """Cloth in folds from a to b along the wall."""
    folds = np.linspace(a, b, 25)
    out = 0.16 + 0.035 * np.sin(np.linspace(0, 2 * np.pi * float(rng.uniform(3.0, 4.5)), 25))
    low = np.array([wall.at(float(u), float(o), 0.03) for u, o in zip(folds, out, strict=True)])
    high = low + np.array([0, 0, top - 0.03])
    corners = np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)
    u = (folds - a) / 0.6
    uv = np.stack([np.stack([u[:-1], u[1:], u[1:], u[:-1]], 1), np.tile([0, 0, top / 0.6, top / 0.6], (24, 1))], -1)
    return quads(corners, uv, RoomSurface.CURTAIN, float(rng.uniform(0.8, 1.4)))
