"""Compiled detector of SURF: box filters for the determinant of the Hessian, and its peaks over position and scale.

Bay, Ess, Tuytelaars, Van Gool, 'Speeded-Up Robust Features', CVIU 110(3) 2008, section 3. An integral image is
(H + 1, W + 1) int32 with a first row and column of zeros, as `cv2.integral` returns it: the sum over any box is four of
its values. Sums of whole numbers are exact, whatever the order; they become floats only in the determinant.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Ints = NDArray[np.int32]
Floats = NDArray[np.float32]

CROSS_WEIGHT = 0.912  # balances the boxes' poor fit to the mixed Gaussian derivative (eq. 3 of the paper)


@njit(cache=True, nogil=True)
def deinterleave(integral: Ints, step: int) -> Ints:
    """Split an integral image into planes of every step-th column: (step, H + 1, any) int32.

    Plane p holds columns p, p + step, p + 2 step, ... The values that a filter needs at every step-th pixel then lie
    side by side in memory, so that loops over them become SIMD.
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
def _row_values(planes: Ints, row: int, column: int, count: int) -> Ints:
    """Return `count` values of a row of the integral image, step apart, from a column on."""
    step = len(planes)
    return planes[column % step, row, column // step : column // step + count]


@njit(cache=True, nogil=True)
def _second_difference_down(planes: Ints, rows: tuple[int, int, int, int], columns: tuple[int, int], out: Ints) -> None:
    """Sum three boxes one above the other, weighted 1, -2, 1, at each of n = len(out) samples: the filter D_yy.

    Args:
        planes: integral image of `deinterleave`.
        rows: first row of each box, and the row behind the last one.
        columns: first column of the boxes of the first sample, and the column behind them.
        out: (n,) receives the sums.
    """
    n = len(out)
    # With slices taken beforehand the loop has unit steps and no index checks, so that the compiler makes it SIMD.
    a0, b0 = _row_values(planes, rows[0], columns[0], n), _row_values(planes, rows[0], columns[1], n)
    a1, b1 = _row_values(planes, rows[1], columns[0], n), _row_values(planes, rows[1], columns[1], n)
    a2, b2 = _row_values(planes, rows[2], columns[0], n), _row_values(planes, rows[2], columns[1], n)
    a3, b3 = _row_values(planes, rows[3], columns[0], n), _row_values(planes, rows[3], columns[1], n)
    for i in range(n):
        whole = np.int32(b3[i] - a3[i] - b0[i] + a0[i])
        middle = np.int32(b2[i] - a2[i] - b1[i] + a1[i])
        # 1, -2, 1 is 1, 1, 1 minus 3 times the middle: two box sums instead of three.
        out[i] = np.int32(whole - np.int32(3) * middle)


@njit(cache=True, nogil=True)
def _second_difference_across(
    planes: Ints, rows: tuple[int, int], columns: tuple[int, int, int, int], out: Ints
) -> None:
    """Sum three boxes side by side, weighted 1, -2, 1: the filter D_xx; see `_second_difference_down`."""
    n = len(out)
    a0, b0 = _row_values(planes, rows[0], columns[0], n), _row_values(planes, rows[1], columns[0], n)
    a1, b1 = _row_values(planes, rows[0], columns[1], n), _row_values(planes, rows[1], columns[1], n)
    a2, b2 = _row_values(planes, rows[0], columns[2], n), _row_values(planes, rows[1], columns[2], n)
    a3, b3 = _row_values(planes, rows[0], columns[3], n), _row_values(planes, rows[1], columns[3], n)
    for i in range(n):
        whole = np.int32(b3[i] - a3[i] - b0[i] + a0[i])
        middle = np.int32(b2[i] - a2[i] - b1[i] + a1[i])
        out[i] = np.int32(whole - np.int32(3) * middle)


@njit(cache=True, nogil=True)
def _difference_of_pair(planes: Ints, rows: tuple[int, int], columns: tuple[int, int, int, int], out: Ints) -> None:
    """Subtract the right box from the left one, with a gap between: half of the filter D_xy."""
    n = len(out)
    a0, b0 = _row_values(planes, rows[0], columns[0], n), _row_values(planes, rows[1], columns[0], n)
    a1, b1 = _row_values(planes, rows[0], columns[1], n), _row_values(planes, rows[1], columns[1], n)
    a2, b2 = _row_values(planes, rows[0], columns[2], n), _row_values(planes, rows[1], columns[2], n)
    a3, b3 = _row_values(planes, rows[0], columns[3], n), _row_values(planes, rows[1], columns[3], n)
    for i in range(n):
        out[i] = np.int32((b1[i] - a1[i] - b0[i] + a0[i]) - (b3[i] - a3[i] - b2[i] + a2[i]))


@njit(cache=True, nogil=True)
def _whole_filters(pixels: int, half: int, step: int) -> tuple[int, int]:
    """Return the first sample whose filter lies inside `pixels` pixels, and the number of such samples, step apart."""
    first = -(-half // step)
    return first, max((pixels - 1 - half) // step + 1 - first, 0)


@njit(cache=True, nogil=True)
def determinant_row(planes: Ints, y: int, size: int, work: Ints, out: Floats) -> None:
    """Compute determinants of the Hessian along a row, step pixels apart; 0 where the filter leaves the image.

    Args:
        planes: (step, H + 1, any) int32 of `deinterleave`.
        y: row of the image, pixels.
        size: side of the filter, odd and divisible by 3, pixels; it acts like a Gaussian of sigma 1.2 size / 9.
        work: (4, W') int32 work space, overwritten.
        out: (W',) float32, W' = W / step rounded up, receives the determinants, (grey levels / pixel^2)^2 over the
            filter's area.
    """
    step, lobe, half, middle = len(planes), size // 3, size // 2, size // 6
    # The image may be narrower than the planes by up to step - 1 pixels; filters there are cut off.
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


@njit(cache=True, nogil=True)
def _mark_row(ring: Floats, level: int, y: int, threshold: np.float32, marks: NDArray[np.uint8]) -> None:
    """Mark (W' - 2,) the samples of a row above the threshold and not below their six nearest neighbours.

    > on one side and >= on the other: of two equal neighbours exactly one can be a peak.
    """
    n = len(marks)
    above, same, below = ring[(y - 1) % 3, level], ring[y % 3, level], ring[(y + 1) % 3, level]
    center, left, right = same[1 : 1 + n], same[:n], same[2 : 2 + n]
    up, down = above[1 : 1 + n], below[1 : 1 + n]
    smaller, larger = ring[y % 3, level - 1, 1 : 1 + n], ring[y % 3, level + 1, 1 : 1 + n]
    for i in range(n):  # no branches, so that the loop becomes SIMD
        v = center[i]
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
    center = 2 * cube[1, 1, 1]
    gx, gy, gs = cube[1, 1, 2] - cube[1, 1, 0], cube[1, 2, 1] - cube[1, 0, 1], cube[2, 1, 1] - cube[0, 1, 1]
    xx, yy = cube[1, 1, 2] + cube[1, 1, 0] - center, cube[1, 2, 1] + cube[1, 0, 1] - center
    ss = cube[2, 1, 1] + cube[0, 1, 1] - center
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
