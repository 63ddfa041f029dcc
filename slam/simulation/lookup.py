"""Texture filtering: the mean brightness of a texture under the footprint of a pixel, compiled.

Textures are mip-mapped (Williams, Pyramidal parametrics, 1983) and sampled along the longer axis of the pixel's
footprint, so that road and facades seen at a grazing angle neither flicker nor blur away.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Buffer = NDArray[Any]  # read and written by compiled code, which takes any number type

_MAX_TAPS = 4.0  # samples along a footprint; a longer one is read from a coarser level
_MIN_BLEND = 0.05  # share of the coarser level below which it is not read, to save time


class Footprint(NamedTuple):
    """What a pixel covers of a texture, in tiles.

    Attributes:
        u, v: centre.
        du, dv: vector of the long axis.
        short, long: lengths of both axes.
    """

    u: float
    v: float
    du: float
    dv: float
    short: float
    long: float


@njit(cache=True, inline="always", error_model="numpy")
def _bilinear(texels: Buffer, start: int, power: int, u: float, v: float) -> Any:
    """Value 0..255 at (u, v) tiles of the square level that starts at `start`, 2^power wide."""
    size = 1 << power
    x, y = u * size - 0.5, v * size - 0.5
    fx, fy = np.floor(x), np.floor(y)
    ax, ay = np.float32(x - fx), np.float32(y - fy)
    mask = size - 1
    x0, y0 = np.int64(fx) & mask, np.int64(fy) & mask
    x1 = (x0 + 1) & mask
    below, above = start + (y0 << power), start + (((y0 + 1) & mask) << power)
    a, b = np.float32(texels[below + x0]), np.float32(texels[below + x1])
    c, d = np.float32(texels[above + x0]), np.float32(texels[above + x1])
    low = a + ax * (b - a)
    return low + ay * (c + ax * (d - c) - low)


@njit(cache=True, error_model="numpy")
def sample_anisotropic(texels: Buffer, start: int, power: int, footprint: Footprint) -> Any:
    """Mean brightness 0..1 of a texture over a footprint, by several samples along the long axis.

    Args:
        texels: (B,) uint8, the levels of all textures one after the other.
        start: index of the first texel of the texture's finest level.
        power: binary logarithm of the side of the finest level.
        footprint: what the pixel covers.
    """
    u, v, du, dv, short, long = footprint
    blur = max(short, long / _MAX_TAPS) * (1 << power)
    if blur <= 1.0:
        return _bilinear(texels, start, power, u, v) / np.float32(255.0)
    taps = max(1, int(min(_MAX_TAPS, long / max(short, 1e-9)) + 0.5))
    level = min(np.log2(blur), power - 0.001)
    if taps > 2:
        level = np.floor(level + 0.5)  # at grazing angles the seam between levels is hidden by the taps' own blur
    whole = min(int(level), power - 1)
    for _ in range(whole):
        start += 1 << (2 * power)
        power -= 1
    part = np.float32(level - whole)
    total = np.float32(0.0)
    for k in range(taps):
        t = (k + 0.5) / taps - 0.5
        fine = _bilinear(texels, start, power, u + t * du, v + t * dv)
        if part > _MIN_BLEND:
            coarse = _bilinear(texels, start + (1 << (2 * power)), power - 1, u + t * du, v + t * dv)
            fine += part * (coarse - fine)
        total += fine
    return total / np.float32(255.0 * taps)


@njit(cache=True, error_model="numpy")
def sample_isotropic(texels: Buffer, start: int, power: int, footprint: Footprint) -> Any:
    """Brightness 0..1 of a texture by a single sample, at the level of the footprint's mean width.

    Args: as of `sample_anisotropic`.
    """
    blur = np.sqrt(footprint.short * footprint.long) * (1 << power)
    # Levels change half way between powers of two. There is no blending: details are too faint for a seam to show.
    while blur > 1.41 and power > 0:
        blur *= 0.5
        start += 1 << (2 * power)
        power -= 1
    return _bilinear(texels, start, power, footprint.u, footprint.v) / np.float32(255.0)
