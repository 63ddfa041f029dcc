"""Triangulation: depth from two views of one point."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def triangulate(rays: Array, seen: Array, T_second_first: Array) -> tuple[Array, Array]:
    """Inverse depths of points from two views.

    Args:
        rays: (N, 3) directions with z = 1 in the first camera.
        seen: (N, 3) likewise in the second.
        T_second_first: (4, 4), or (N, 4, 4) with one for each point.

    Returns:
        Inverse depth (N,) in the first camera, negative behind it; and (N,) the squared shift of `seen` by a unit
        of inverse depth, a measure of parallax, zero where there is none.

    """
    R, t = T_second_first[..., :3, :3], T_second_first[..., :3, 3]
    turned = np.einsum("...ij,...j->...i", R, rays)
    shift = t[..., :2] - seen[:, :2] * t[..., 2:]
    rest = seen[:, :2] * turned[:, 2:] - turned[:, :2]
    strength = np.sum(shift * shift, axis=1)
    depth = np.sum(shift * rest, axis=1) / np.maximum(strength, 1e-12)
    # the shift is that of X over its depth before the division by the new depth
    return depth, strength / np.maximum(turned[:, 2], 0.1) ** 2
