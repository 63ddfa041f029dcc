"""Compiled loops of SURF: box filters, scale-space maxima and Haar descriptors, all on the integral image.

Source of the method: Bay, Ess, Tuytelaars, Van Gool, 'Speeded-Up Robust Features', CVIU 110(3) 2008, sections 3 and 4.
An integral image is (H + 1, W + 1) int32 with a first row and column of zeros, as `cv2.integral` returns it.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Ints = NDArray[np.int32]
Floats = NDArray[np.float32]

SAMPLES = 24  # Haar samples along each side of the described square, one scale apart
CELLS = 4  # cells along each side, with four sums in each
CELL_SIZE = 5.0  # distance between the centres of neighbouring cells, samples
GAUSSIAN_SIGMA = 5.5  # of the weight of a sample, samples
CROSS_WEIGHT = 0.912  # makes up for the boxes' poor fit to the mixed Gaussian derivative (eq. 3 of the paper)


@njit(cache=True)
def _second_difference_down(
    integral: Ints, rows: tuple[int, int, int, int], columns: tuple[int, int], out: Ints
) -> None:
    """Three boxes one above the other, weighted 1, -2, 1, at each of the n = len(out) places one pixel apart.

    rows: where the boxes begin and end; columns: where the first place's boxes begin and end.
    """
    n = len(out)
    # Slices taken beforehand leave loops of unit steps without index checks, which the compiler turns into SIMD.
    left, right = columns
    a0, b0 = integral[rows[0], left : left + n], integral[rows[0], right : right + n]
    a1, b1 = integral[rows[1], left : left + n], integral[rows[1], right : right + n]
    a2, b2 = integral[rows[2], left : left + n], integral[rows[2], right : right + n]
    a3, b3 = integral[rows[3], left : left + n], integral[rows[3], right : right + n]
    for i in range(n):
        whole = np.int32(b3[i] - a3[i] - b0[i] + a0[i])
        middle = np.int32(b2[i] - a2[i] - b1[i] + a1[i])
        out[i] = np.int32(whole - np.int32(3) * middle)


@njit(cache=True)
def _second_difference_across(
    integral: Ints, rows: tuple[int, int], columns: tuple[int, int, int, int], out: Ints
) -> None:
    """Three boxes side by side, weighted 1, -2, 1; see _second_difference_down."""
    n = len(out)
    top, bottom = integral[rows[0]], integral[rows[1]]
    c0, c1, c2, c3 = columns
    a0, a1, a2, a3 = top[c0 : c0 + n], top[c1 : c1 + n], top[c2 : c2 + n], top[c3 : c3 + n]
    b0, b1, b2, b3 = bottom[c0 : c0 + n], bottom[c1 : c1 + n], bottom[c2 : c2 + n], bottom[c3 : c3 + n]
    for i in range(n):
        whole = np.int32(b3[i] - a3[i] - b0[i] + a0[i])
        middle = np.int32(b2[i] - a2[i] - b1[i] + a1[i])
        out[i] = np.int32(whole - np.int32(3) * middle)


@njit(cache=True)
def _difference_of_pair(integral: Ints, rows: tuple[int, int], columns: tuple[int, int, int, int], out: Ints) -> None:
    """Left box minus right box, with a gap between them; see _second_difference_down."""
    n = len(out)
    top, bottom = integral[rows[0]], integral[rows[1]]
    c0, c1, c2, c3 = columns
    a0, a1, a2, a3 = top[c0 : c0 + n], top[c1 : c1 + n], top[c2 : c2 + n], top[c3 : c3 + n]
    b0, b1, b2, b3 = bottom[c0 : c0 + n], bottom[c1 : c1 + n], bottom[c2 : c2 + n], bottom[c3 : c3 + n]
    for i in range(n):
        out[i] = np.int32((b1[i] - a1[i] - b0[i] + a0[i]) - (b3[i] - a3[i] - b2[i] + a2[i]))


@njit(cache=True)
def hessian_determinants(integral: Ints, size: int, out: Floats) -> None:
    """Determinants of the Hessian by box filters of one size, into out (H, W) float32; 0 at the rim.

    Args:
        integral: of the grey image.
        size: side of the filter, odd and divisible by 3, pixels; it acts like a Gaussian of sigma 1.2 size / 9.
        out: receives (grey levels per pixel squared) squared, normalised by the filter's area.
    """
    lobe, half, middle = size // 3, size // 2, size // 6
    height, n = out.shape[0], out.shape[1] - 2 * half
    out[:half] = 0
    out[height - half :] = 0
    out[:, :half] = 0
    out[:, half + n :] = 0
    xx, yy, upper, lower = (
        np.empty(n, np.int32),
        np.empty(n, np.int32),
        np.empty(n, np.int32),
        np.empty(n, np.int32),
    )
    scale, cross = np.float32(1.0 / (size * size)), np.float32(CROSS_WEIGHT)
    x = half  # column of the first pixel with a whole filter
    outer = (x - half, x - middle, x + middle + 1, x + half + 1)
    corners = (x - lobe, x, x + 1, x + lobe + 1)
    for y in range(half, height - half):
        downwards = (y - half, y - middle, y + middle + 1, y + half + 1)
        _second_difference_down(integral, downwards, (x - lobe + 1, x + lobe), yy)
        _second_difference_across(integral, (y - lobe + 1, y + lobe), outer, xx)
        _difference_of_pair(integral, (y - lobe, y), corners, upper)
        _difference_of_pair(integral, (y + 1, y + lobe + 1), corners, lower)
        row = out[y, half : half + n]
        for i in range(n):
            mixed = cross * np.float32(np.int32(upper[i] - lower[i])) * scale
            row[i] = (np.float32(xx[i]) * scale) * (np.float32(yy[i]) * scale) - mixed * mixed


@njit(cache=True)
def _is_peak(below: Floats, layer: Floats, above: Floats, pixel: tuple[int, int]) -> bool:
    """Whether no neighbour in its own layer or above exceeds a pixel, and none below reaches it."""
    y, x = pixel
    value = layer[y, x]
    for dy in range(-1, 2):
        for dx in range(-1, 2):
            i, j = y + dy, x + dx
            if layer[i, j] > value or above[i, j] > value or below[i, j] >= value:
                return False
    return True


@njit(cache=True)
def _mark_row(layer: Floats, y: int, threshold: float, marks: NDArray[np.uint8]) -> None:
    """Mark (W - 2,) the pixels of row y that are above the threshold and not below their four neighbours."""
    n = len(marks)
    least = np.float32(threshold)
    centre, left, right = layer[y, 1 : 1 + n], layer[y, :n], layer[y, 2 : 2 + n]
    up, down = layer[y - 1, 1 : 1 + n], layer[y + 1, 1 : 1 + n]
    for i in range(n):  # no branches: SIMD
        v = centre[i]
        marks[i] = (v > least) & (v > left[i]) & (v >= right[i]) & (v > up[i]) & (v >= down[i])


@njit(cache=True)
def find_peaks(below: Floats, layer: Floats, above: Floats, threshold: float) -> Ints:
    """Pixels (N, 2) int32, row and column, where a layer peaks in its 3 x 3 x 3 neighbourhood, in reading order.

    Args:
        below: (H, W) determinants at the next smaller scale.
        layer: (H, W) determinants at the scale searched.
        above: (H, W) determinants at the next larger scale.
        threshold: least determinant of a peak.
    """
    rows, columns = layer.shape
    found = np.empty((rows * columns // 2 + 1, 2), np.int32)  # no two peaks share a side
    marks = np.empty(columns - 2, np.uint8)
    count = 0
    for y in range(1, rows - 1):
        _mark_row(layer, y, threshold, marks)
        for i in range(columns - 2):
            # most pixels are turned down by their mark
            if marks[i] and _is_peak(below, layer, above, (y, i + 1)):
                found[count, 0], found[count, 1] = y, i + 1
                count += 1
    return found[:count].copy()


@njit(cache=True)
def gather_cubes(layers: Floats, peaks: Ints) -> Floats:
    """The 27 values around each peak: (N, 3, 3, 3) float32 over layer, row, column.

    peaks: (N, 5) int32, indices of the layers below, at and above, row and column.
    """
    cubes = np.empty((len(peaks), 3, 3, 3), np.float32)
    for k in range(len(peaks)):
        y, x = peaks[k, 3], peaks[k, 4]
        for level in range(3):
            cubes[k, level] = layers[peaks[k, level], y - 1 : y + 2, x - 1 : x + 2]
    return cubes


@njit(cache=True)
def _haar_row(integral: Ints, rows: Ints, columns: Ints, weights: Floats, sums: Floats) -> None:
    """Gather one row of Haar responses into sums (CELLS, 4): of dx, |dx|, dy, |dy|, shared among two cells each.

    rows: three integral rows (top, centre, bottom); columns: (SAMPLES, 3) left, centre, right, negative if outside.
    weights: (SAMPLES, CELLS) Gaussian times share of each cell.
    """
    top, centre, bottom = integral[rows[0]], integral[rows[1]], integral[rows[2]]
    for j in range(SAMPLES):
        left, middle, right = columns[j, 0], columns[j, 1], columns[j, 2]
        if left < 0:
            continue
        whole = bottom[right] - top[right] - bottom[left] + top[left]
        dx = np.float32(whole - 2 * (bottom[middle] - top[middle] - bottom[left] + top[left]))
        dy = np.float32(whole - 2 * (centre[right] - top[right] - centre[left] + top[left]))
        first = max(0, min(CELLS - 2, int((j - 0.5 * (SAMPLES - 1)) / CELL_SIZE + 0.5 * (CELLS - 1))))
        for cell in range(first, first + 2):
            w = weights[j, cell]
            sums[cell, 0] += w * dx
            sums[cell, 1] += w * abs(dx)
            sums[cell, 2] += w * dy
            sums[cell, 3] += w * abs(dy)


@njit(cache=True)
def _sample_spans(centre: float, scale: float, limit: int) -> Ints:
    """Integral coordinates (SAMPLES, 3) of each wavelet's begin, middle and end; -1 where it leaves the image."""
    spans = np.empty((SAMPLES, 3), np.int32)
    radius = max(1, int(scale + 0.5))
    for i in range(SAMPLES):
        # a wavelet of even width is centred half a pixel before the integral coordinate of its middle
        middle = int(np.floor(centre + (i - 0.5 * (SAMPLES - 1)) * scale + 1.0))
        inside = middle - radius >= 0 and middle + radius <= limit
        spans[i, 0] = middle - radius if inside else -1
        spans[i, 1] = middle
        spans[i, 2] = middle + radius
    return spans


@njit(cache=True)
def describe_upright(integral: Ints, pixels: Floats, scales: Floats, weights: Floats) -> Floats:
    """Upright SURF descriptors (N, 64) float32 of unit length; all zeros where the surroundings are perfectly even.

    Args:
        integral: of the grey image.
        pixels: (N, 2) float32, x right and y down.
        scales: (N,) float32, sigma, pixels.
        weights: (SAMPLES, CELLS) of `cell_weights`.
    """
    n = len(pixels)
    out = np.zeros((n, CELLS * CELLS * 4), np.float32)
    row_sums = np.empty((CELLS, 4), np.float32)
    for k in range(n):
        rows = _sample_spans(pixels[k, 1], scales[k], integral.shape[0] - 1)
        columns = _sample_spans(pixels[k, 0], scales[k], integral.shape[1] - 1)
        cells = out[k].reshape(CELLS, CELLS, 4)
        for i in range(SAMPLES):
            if rows[i, 0] < 0:
                continue
            row_sums[:] = 0
            _haar_row(integral, rows[i], columns, weights, row_sums)
            for cell in range(CELLS):
                if weights[i, cell] > 0:
                    cells[cell] += weights[i, cell] * row_sums
        norm = np.sqrt(np.sum(out[k] * out[k]))
        if norm > 0:
            out[k] /= norm
    return out


def cell_weights() -> Floats:
    """Weight (SAMPLES, CELLS) of each sample along one axis in each cell: linear shares times the Gaussian."""
    offsets = np.arange(SAMPLES) - 0.5 * (SAMPLES - 1)
    centres = (np.arange(CELLS) - 0.5 * (CELLS - 1)) * CELL_SIZE
    shares = np.clip(1 - np.abs(offsets[:, None] - centres) / CELL_SIZE, 0, None)
    gaussian = np.exp(-0.5 * (offsets / GAUSSIAN_SIGMA) ** 2)
    return (shares * gaussian[:, None]).astype(np.float32)
