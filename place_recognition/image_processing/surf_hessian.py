"""Compiled loops of SURF's filters: determinants of the Hessian by boxes.

Bay, Ess, Tuytelaars, Van Gool, 'Speeded-Up Robust Features', CVIU 110(3) 2008, section 3. An integral image is
(H + 1, W + 1) int32 with a first row and column of zeros, as `cv2.integral` returns it.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Ints = NDArray[np.int32]
Floats = NDArray[np.float32]

CROSS_WEIGHT = 0.912  # makes up for the boxes' poor fit to the mixed Gaussian derivative (eq. 3 of the paper)


@njit(cache=True, nogil=True)
def deinterleave(integral: Ints, step: int) -> Ints:
    """Columns 0, step, 2 step, ... of an integral image, then columns 1, 1 + step, ...: (step, H + 1, any) int32.

    What a filter needs at every step-th pixel then lies side by side in memory, so that loops over it become SIMD.
    """
    rows, columns = integral.shape
    if step == 1:
        return integral.reshape(1, rows, columns)
    planes = np.zeros((step, rows, (columns + step - 1) // step), np.int32)
    for y in range(rows):
        for plane in range(step):
            for k, x in enumerate(range(plane, columns, step)):
                planes[plane, y, k] = integral[y, x]
    return planes


@njit(cache=True, nogil=True)
def _run(planes: Ints, row: int, column: int, count: int) -> Ints:
    """So many values of a row of the integral image, step apart, from a column on."""
    step = len(planes)
    return planes[column % step, row, column // step : column // step + count]


@njit(cache=True, nogil=True)
def _second_difference_down(planes: Ints, rows: tuple[int, int, int, int], columns: tuple[int, int], out: Ints) -> None:
    """Three boxes one above the other, weighted 1, -2, 1, at each of the n = len(out) places.

    rows: where the boxes begin and end; columns: where the first place's boxes begin and end.
    """
    n = len(out)
    # Slices taken beforehand leave loops of unit steps without index checks, which the compiler turns into SIMD.
    a0, b0 = _run(planes, rows[0], columns[0], n), _run(planes, rows[0], columns[1], n)
    a1, b1 = _run(planes, rows[1], columns[0], n), _run(planes, rows[1], columns[1], n)
    a2, b2 = _run(planes, rows[2], columns[0], n), _run(planes, rows[2], columns[1], n)
    a3, b3 = _run(planes, rows[3], columns[0], n), _run(planes, rows[3], columns[1], n)
    for i in range(n):
        whole = np.int32(b3[i] - a3[i] - b0[i] + a0[i])
        middle = np.int32(b2[i] - a2[i] - b1[i] + a1[i])
        out[i] = np.int32(whole - np.int32(3) * middle)


@njit(cache=True, nogil=True)
def _second_difference_across(
    planes: Ints, rows: tuple[int, int], columns: tuple[int, int, int, int], out: Ints
) -> None:
    """Three boxes side by side, weighted 1, -2, 1; see _second_difference_down."""
    n = len(out)
    a0, b0 = _run(planes, rows[0], columns[0], n), _run(planes, rows[1], columns[0], n)
    a1, b1 = _run(planes, rows[0], columns[1], n), _run(planes, rows[1], columns[1], n)
    a2, b2 = _run(planes, rows[0], columns[2], n), _run(planes, rows[1], columns[2], n)
    a3, b3 = _run(planes, rows[0], columns[3], n), _run(planes, rows[1], columns[3], n)
    for i in range(n):
        whole = np.int32(b3[i] - a3[i] - b0[i] + a0[i])
        middle = np.int32(b2[i] - a2[i] - b1[i] + a1[i])
        out[i] = np.int32(whole - np.int32(3) * middle)


@njit(cache=True, nogil=True)
def _difference_of_pair(planes: Ints, rows: tuple[int, int], columns: tuple[int, int, int, int], out: Ints) -> None:
    """Left box minus right box, with a gap between them; see _second_difference_down."""
    n = len(out)
    a0, b0 = _run(planes, rows[0], columns[0], n), _run(planes, rows[1], columns[0], n)
    a1, b1 = _run(planes, rows[0], columns[1], n), _run(planes, rows[1], columns[1], n)
    a2, b2 = _run(planes, rows[0], columns[2], n), _run(planes, rows[1], columns[2], n)
    a3, b3 = _run(planes, rows[0], columns[3], n), _run(planes, rows[1], columns[3], n)
    for i in range(n):
        out[i] = np.int32((b1[i] - a1[i] - b0[i] + a0[i]) - (b3[i] - a3[i] - b2[i] + a2[i]))


@njit(cache=True, nogil=True)
def _whole_filters(pixels: int, half: int, step: int) -> tuple[int, int]:
    """First sample with a whole filter inside so many pixels, and how many there are; samples are step apart."""
    first = -(-half // step)
    return first, max((pixels - 1 - half) // step + 1 - first, 0)


@njit(cache=True, nogil=True)
def determinant_row(planes: Ints, y: int, size: int, work: Ints, out: Floats) -> None:
    """Determinants of the Hessian by box filters of one size along a row, step pixels apart, into out; 0 at the rim.

    Args:
        planes: (step, H + 1, any) int32 of `deinterleave`.
        y: row of the image, pixels.
        size: side of the filter, odd and divisible by 3, pixels; it acts like a Gaussian of sigma 1.2 size / 9.
        work: (4, W') int32, its values are lost.
        out: (W',) float32, W' = W / step rounded up, receives (grey levels per pixel squared) squared, normalised by
            the filter's area.
    """
    step, lobe, half, middle = len(planes), size // 3, size // 2, size // 6
    # the width may be less than this by up to step - 1 pixels: their filters are cut off
    left, n = _whole_filters(planes.shape[2] * step - step, half, step)
    out[:] = 0
    if n == 0 or y < half or y + half + 1 >= planes.shape[1]:
        return
    xx, yy, upper, lower = work[0, :n], work[1, :n], work[2, :n], work[3, :n]
    x = left * step
    outer = (x - half, x - middle, x + middle + 1, x + half + 1)
    corners = (x - lobe, x, x + 1, x + lobe + 1)
    downwards = (y - half, y - middle, y + middle + 1, y + half + 1)
    _second_difference_down(planes, downwards, (x - lobe + 1, x + lobe), yy)
    _second_difference_across(planes, (y - lobe + 1, y + lobe), outer, xx)
    _difference_of_pair(planes, (y - lobe, y), corners, upper)
    _difference_of_pair(planes, (y + 1, y + lobe + 1), corners, lower)
    scale, cross = np.float32(1.0 / (size * size)), np.float32(CROSS_WEIGHT)
    row = out[left : left + n]
    for k in range(n):
        mixed = cross * np.float32(np.int32(upper[k] - lower[k])) * scale
        row[k] = (np.float32(xx[k]) * scale) * (np.float32(yy[k]) * scale) - mixed * mixed
