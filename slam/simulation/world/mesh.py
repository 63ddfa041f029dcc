"""Triangle meshes with texture coordinates, and the solids that the town consists of.

Town frame: x and y along the ground, z up, metres. Texture coordinates count tiles of the material's texture.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mesh:
    """T triangles.

    Attributes:
        corners: (T, 3, 3) metres.
        uv: (T, 3, 2) tiles.
        material: (T,) row of the material table.
        tint: (T,) factor on the texture's brightness.
    """

    corners: Array
    uv: Array
    material: NDArray[np.int32]
    tint: Array

    def __len__(self) -> int:
        return len(self.material)

    def transform(self, yaw: float, position: Array, scale: float = 1.0) -> "Mesh":
        """Return the mesh scaled, rotated by yaw (radians, counter-clockwise from above) and moved (3,)."""
        c, s = np.cos(yaw), np.sin(yaw)
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        return Mesh((self.corners * scale) @ turn + np.asarray(position), self.uv, self.material, self.tint)

    def scale_brightness(self, factor: float) -> "Mesh":
        """Return the mesh with all tints multiplied by a factor."""
        return Mesh(self.corners, self.uv, self.material, self.tint * factor)


def merge_meshes(meshes: list[Mesh]) -> Mesh:
    """Merge meshes into one; without any, an empty one."""
    if not meshes:
        return Mesh(np.zeros((0, 3, 3)), np.zeros((0, 3, 2)), np.zeros(0, np.int32), np.zeros(0))
    return Mesh(
        np.concatenate([m.corners for m in meshes]),
        np.concatenate([m.uv for m in meshes]),
        np.concatenate([m.material for m in meshes]),
        np.concatenate([m.tint for m in meshes]),
    )


def triangles(corners: Array, uv: Array, material: int, tint: float | Array = 1.0) -> Mesh:
    """Triangles (T, 3, 3) with texture coordinates (T, 3, 2), of one material."""
    n = len(corners)
    return Mesh(corners, uv, np.full(n, material, np.int32), np.broadcast_to(tint, (n,)).astype(np.float64))


def quads(corners: Array, uv: Array, material: int, tint: float | Array = 1.0) -> Mesh:
    """Quadrilaterals (N, 4, 3), corners in order around, as two triangles each."""
    corners, uv = np.asarray(corners, dtype=np.float64), np.asarray(uv, dtype=np.float64)
    halves = [[0, 1, 2], [0, 2, 3]]
    tints = np.repeat(np.broadcast_to(tint, (len(corners),)), 2)
    return triangles(corners[:, halves].reshape(-1, 3, 3), uv[:, halves].reshape(-1, 3, 2), material, tints)


def panel(
    origin: ArrayLike, right: ArrayLike, up: ArrayLike, material: int, tiles: ArrayLike, tint: float = 1.0
) -> Mesh:
    """Make a parallelogram from `origin` (3,) along `right` and `up` (3,), metres.

    tiles: (4,) texture coordinates u0, v0, u1, v1 of its lower left and upper right corner.
    """
    o, r, u = (np.asarray(v, dtype=np.float64) for v in (origin, right, up))
    u0, v0, u1, v1 = np.asarray(tiles)
    uv = np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]])
    return quads(np.array([[o, o + r, o + r + u, o + u]]), uv[None], material, tint)


def boxes(low: ArrayLike, high: ArrayLike, material: int, tint: float | Array = 1.0, tile: float = 1.0) -> Mesh:
    """Axis-aligned boxes between `low` and `high` (N, 3), metres, open below; a tile covers `tile` metres."""
    ends = np.stack([np.atleast_2d(np.asarray(end, dtype=np.float64)) for end in (low, high)])  # (2, N, 3)
    # Each face as corners (x end, y end, z end), and the two axes that its texture follows.
    faces = (
        ([(0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)], (0, 2)),
        ([(1, 1, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1)], (0, 2)),
        ([(0, 1, 0), (0, 0, 0), (0, 0, 1), (0, 1, 1)], (1, 2)),
        ([(1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)], (1, 2)),
        ([(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], (0, 1)),
    )
    out = []
    for corners, axes in faces:
        points = np.stack([np.stack([ends[c[k], :, k] for k in range(3)], -1) for c in corners], axis=1)
        out.append(quads(points, points[:, :, axes] / tile, material, tint))
    return merge_meshes(out)


def prism(radius: float, top_radius: float, height: float, material: int, sides: int = 6) -> Mesh:
    """Make an upright post on the origin, open at both ends, metres."""
    angle = np.linspace(0.0, 2.0 * np.pi, sides + 1)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    low, high = ring * radius, ring * top_radius + [0.0, 0.0, height]
    corners = np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1)
    u = np.arange(sides + 1) / sides
    uv = np.stack([u[:-1], u[1:], u[1:], u[:-1]], axis=1)[..., None] * [1.0, 0.0]
    uv[:, 2:, 1] = height
    return quads(corners, uv, material)
