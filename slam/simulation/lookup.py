"""Brightness of a texture under the footprint of a pixel, compiled.

Textures are mip-mapped (Williams, Pyramidal parametrics, 1983) and looked up along the longer axis of the
pixel's footprint, so that road and facades seen at a grazing angle neither flicker nor blur away.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Buffer = NDArray[Any]  # read and written by compiled code, which takes any number type
_MAX_TAPS = 4.0


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
def along(
    texels: Buffer,
    start: int,
    power: int,
    u: float,
    v: float,
    du: float,
    dv: float,
    short: float,
    long: float,
) -> Any:
    """Brightness 0..1 averaged over a footprint centred on (u, v): long axis (du, dv), lengths in tiles."""
    blur = max(short, long / _MAX_TAPS) * (1 << power)
    if blur <= 1.0:
        return _bilinear(texels, start, power, u, v) / np.float32(255.0)
    taps = max(1, int(min(_MAX_TAPS, long / max(short, 1e-9)) + 0.5))
    level = min(np.log2(blur), power - 0.001)
    if taps > 2:
        level = np.floor(level + 0.5)  # at grazing angles the seam between levels is lost in the taps' own blur
    whole = min(int(level), power - 1)
    for _ in range(whole):
        start += 1 << (2 * power)
        power -= 1
    part = np.float32(level - whole)
    total = np.float32(0.0)
    for k in range(taps):
        t = (k + 0.5) / taps - 0.5
        fine = _bilinear(texels, start, power, u + t * du, v + t * dv)
        if part > 0.05:
            coarse = _bilinear(texels, start + (1 << (2 * power)), power - 1, u + t * du, v + t * dv)
            fine += part * (coarse - fine)
        total += fine
    return total / np.float32(255.0 * taps)


@njit(cache=True, error_model="numpy")
def grain(texels: Buffer, start: int, power: int, u: float, v: float, short: float, long: float) -> Any:
    """Brightness 0..1 of a texture by one look-up at the level of the footprint's mean width."""
    blur = np.sqrt(short * long) * (1 << power)
    # Levels change half way between powers of two; grain is too faint for the seam to show.
    while blur > 1.41 and power > 0:
        blur *= 0.5
        start += 1 << (2 * power)
        power -= 1
    return _bilinear(texels, start, power, u, v) / np.float32(255.0)
