"""Compiled search of SURF's detector: peaks of the determinant of the Hessian over position and scale.

Bay, Ess, Tuytelaars, Van Gool, 'Speeded-Up Robust Features', CVIU 110(3) 2008, section 3.4.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.image_processing.surf_hessian import Floats, Ints, determinant_row


@njit(cache=True, nogil=True)
def _mark_row(ring: Floats, level: int, y: int, threshold: np.float32, marks: NDArray[np.uint8]) -> None:
    """Mark (W' - 2,) the samples of a row above the threshold and not below their six nearest neighbours.

    > on one side and >= on the other: of two equal neighbours exactly one can be a peak.
    """
    n = len(marks)
    above, same, below = ring[(y - 1) % 3, level], ring[y % 3, level], ring[(y + 1) % 3, level]
    centre, left, right = same[1 : 1 + n], same[:n], same[2 : 2 + n]
    up, down = above[1 : 1 + n], below[1 : 1 + n]
    smaller, larger = ring[y % 3, level - 1, 1 : 1 + n], ring[y % 3, level + 1, 1 : 1 + n]
    for i in range(n):  # no branches, so that the loop becomes SIMD
        v = centre[i]
        beside = (v > left[i]) & (v >= right[i]) & (v > up[i]) & (v >= down[i])
        marks[i] = (v > threshold) & beside & (v > smaller[i]) & (v >= larger[i])


@njit(cache=True, nogil=True)
def _take_cube(ring: Floats, level: int, place: tuple[int, int], cube: NDArray[np.float64]) -> bool:
    """Copy the neighbourhood of a sample into cube (3, 3, 3) of level, row and column; return whether it is a peak.

    A peak is not exceeded by a neighbour in its own layer or above, and not reached by one below.
    """
    y, x = place
    peak = True
    value = ring[y % 3, level, x]
    for i in range(3):
        row = ring[(y + i - 1) % 3]
        for j in range(3):
            for k in range(3):
                cube[k, i, j] = row[level + k - 1, x + j - 1]
            smaller, same, larger = row[level - 1, x + j - 1], row[level, x + j - 1], row[level + 1, x + j - 1]
            peak = peak and smaller < value and same <= value and larger <= value
    return peak


@njit(cache=True, nogil=True)
def fit_peak(cube: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return the peak of the parabola through a cube (3, 3, 3): offset in x, y and level from the middle; 0 if flat.

    One Newton step from the middle, -H^-1 g, with gradient and Hessian by central differences (Brown, Lowe, 'Invariant
    Features from Interest Point Groups', BMVC 2002, which the paper follows).
    """
    centre = 2 * cube[1, 1, 1]
    gx, gy, gs = cube[1, 1, 2] - cube[1, 1, 0], cube[1, 2, 1] - cube[1, 0, 1], cube[2, 1, 1] - cube[0, 1, 1]
    xx, yy = cube[1, 1, 2] + cube[1, 1, 0] - centre, cube[1, 2, 1] + cube[1, 0, 1] - centre
    ss = cube[2, 1, 1] + cube[0, 1, 1] - centre
    xy = (cube[1, 2, 2] - cube[1, 2, 0] - cube[1, 0, 2] + cube[1, 0, 0]) / 4
    xs = (cube[2, 1, 2] - cube[2, 1, 0] - cube[0, 1, 2] + cube[0, 1, 0]) / 4
    ys = (cube[2, 2, 1] - cube[2, 0, 1] - cube[0, 2, 1] + cube[0, 0, 1]) / 4
    # Cramer's rule, by the minors of the symmetric Hessian: a, b, c in its first row, d, e below, f last.
    a, b, c = yy * ss - ys * ys, xs * ys - xy * ss, xy * ys - xs * yy
    d, e, f = xx * ss - xs * xs, xy * xs - xx * ys, xx * yy - xy * xy
    determinant = xx * a + xy * b + xs * c
    if abs(determinant) < 1e-9:
        return 0.0, 0.0, 0.0
    half = -0.5 / determinant  # the differences gx, gy, gs are twice the gradient
    dx, dy, ds = a * gx + b * gy + c * gs, b * gx + d * gy + e * gs, c * gx + e * gy + f * gs
    return half * dx, half * dy, half * ds


@njit(cache=True, nogil=True)
def _blobs_of_row(ring: Floats, place: tuple[int, int], marks: NDArray[np.uint8], found: Floats, count: int) -> int:
    """Write the blobs among the marked samples of a level and row to found[count:]; return the new count.

    found: (N, 4) receives column, row and level as fractions, and determinant.
    """
    level, y = place
    cube = np.empty((3, 3, 3))
    for i in range(len(marks)):
        # The marks of the SIMD loop dismiss most samples before their 26 neighbours are copied.
        if marks[i] and _take_cube(ring, level, (y, i + 1), cube):
            dx, dy, ds = fit_peak(cube)
            # A step of more than one sample means that the parabola does not fit this peak.
            if max(abs(dx), abs(dy), abs(ds)) <= 1:
                found[count] = (i + 1 + dx, y + dy, level + ds, cube[1, 1, 1])
                count += 1
    return count


@njit(cache=True, nogil=True)
def find_blobs(planes: Ints, sizes: Ints, threshold: float) -> Floats:
    """Find the peaks of the determinant over position and scale, in reading order of rows.

    Three rows of each layer are computed as they are needed and stay in the processor's cache; no layer is kept.

    Args:
        planes: (step, H + 1, any) int32 of `deinterleave`.
        sizes: (L,) int32 increasing sides of the filters, pixels; the first and the last have no peaks.
        threshold: minimum determinant of a peak.

    Returns:
        (N, 4) float32: column and row in units of step pixels, index of the size, all with fractions; determinant.
    """
    step, levels = len(planes), len(sizes)
    rows, width = (planes.shape[1] - 2) // step + 1, planes.shape[2] - 1
    ring, work = np.zeros((3, levels, width), np.float32), np.empty((4, width), np.int32)
    marks = np.empty(max(width - 2, 0), np.uint8)
    # No two peaks of a level touch, so that a quarter of the samples is room enough. Memory that is not written to
    # costs nothing, while an array that grows would keep the loops from becoming SIMD.
    found, count = np.empty(((levels - 2) * (rows + 1) * (width + 1) // 4 + 1, 4), np.float32), 0
    for newest in range(rows):
        for level in range(levels):
            determinant_row(planes, newest * step, sizes[level], work, ring[newest % 3, level])
        y = newest - 1  # the latest row whose neighbours are all computed
        for level in range(1, levels - 1 if y > 0 else 0):
            _mark_row(ring, level, y, np.float32(threshold), marks)
            count = _blobs_of_row(ring, (level, y), marks, found, count)
    return found[:count].copy()
