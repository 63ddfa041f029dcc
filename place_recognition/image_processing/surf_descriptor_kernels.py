"""Compiled descriptor of SURF: Haar wavelets around a point, upright or in its dominant orientation, pooled in cells.

Bay, Ess, Tuytelaars, Van Gool, 'Speeded-Up Robust Features', CVIU 110(3) 2008, sections 4.1 and 4.2; cells that overlap
as in Agrawal, Konolige, Blas, 'CenSurE', ECCV 2008, section 4. An integral image is (H + 1, W + 1) int32 with a first
row and column of zeros, as `cv2.integral` returns it.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Ints = NDArray[np.int32]
Floats = NDArray[np.float32]

SAMPLES = 24  # Haar samples along each side of the described square, one scale apart
CELLS = 4  # cells along each side, with four sums in each
CELL_SIZE = 5.0  # distance between the centres of neighbouring cells, samples
GAUSSIAN_SIGMA = 5.5  # sigma of the weight of a sample, samples
GRID = SAMPLES + 2  # grid lines of an upright square: a wavelet spans two spaces between them
MIDDLE = 0.5 * (SAMPLES - 1)  # index of the middle of the square

RADIUS = 6  # radius of the disc whose wavelets determine the orientation, scales
WEIGHT_SIGMA = 2.5  # sigma of the weight of a wavelet in the disc, scales
DIRECTIONS = 72  # positions of the sliding window, 5 degrees apart
WINDOW = DIRECTIONS // 6  # opening of the window, 60 degrees as in the paper


def cell_weights() -> Floats:
    """Compute the weight (SAMPLES, CELLS) of each sample along one axis in each cell: linear share times Gaussian."""
    # The weight of a sample in the square is the product of those along both axes, so that 24 x 4 numbers suffice.
    offsets = np.arange(SAMPLES) - MIDDLE
    centers = (np.arange(CELLS) - 0.5 * (CELLS - 1)) * CELL_SIZE
    shares = np.clip(1 - np.abs(offsets[:, None] - centers) / CELL_SIZE, 0, None)
    gaussian = np.exp(-0.5 * (offsets / GAUSSIAN_SIGMA) ** 2)
    return (shares * gaussian[:, None]).astype(np.float32)


@njit(cache=True, nogil=True)
def _grid_lines(center: float, scale: float, limit: int, shares: Floats) -> Ints:
    """Return the integral coordinates (GRID,) below the grid lines of a square along one axis.

    shares (GRID,) receives their fractions. A line outside 0 ... limit is moved to the nearer end.
    """
    below = np.empty(GRID, np.int32)
    for i in range(GRID):
        # the integral coordinate of a pixel's centre is half a pixel more than its index
        line = min(max(center + 0.5 + (i - MIDDLE - 1) * scale, 0.0), float(limit))
        below[i] = min(int(line), limit - 1)
        shares[i] = line - below[i]
    return below


@njit(cache=True, nogil=True)
def _integral_at(integral: Ints, lines: tuple[Ints, Ints], shares: Floats, out: Floats) -> None:
    """Interpolate the integral image at the crossings of grid lines, into out (GRID, GRID), up to row and column sums.

    By the linear interpolation a wavelet covers parts of pixels, and does not jump where its scale changes.

    Args:
        integral: integral image.
        lines: rows and columns below the grid lines.
        shares: (2, GRID) fractions of the rows and columns.
        out: (GRID, GRID) receives the values.
    """
    rows, columns = lines
    begin = columns[0]
    count = columns[GRID - 1] + 2 - begin
    line = np.empty(count, np.float32)
    # The sums above the square and left of it cancel in every wavelet. Without them single precision is exact.
    above = integral[rows[0], begin : begin + count]
    for i in range(GRID):
        upper = integral[rows[i], begin : begin + count]
        lower = integral[rows[i] + 1, begin : begin + count]
        left, further, share = upper[0] - above[0], lower[0] - upper[0], shares[0, i]
        for k in range(count):
            whole = np.float32(np.int32(upper[k] - above[k] - left))
            line[k] = whole + share * np.float32(np.int32(lower[k] - upper[k] - further))
        for j in range(GRID):
            k = columns[j] - begin
            out[i, j] = line[k] + shares[1, j] * (line[k + 1] - line[k])


@njit(cache=True, nogil=True)
def _upright_haar(integral: Ints, point: Floats, haar: Floats, inside: NDArray[np.bool_]) -> None:
    """Compute the responses of the wavelets around a point.

    Args:
        integral: integral image.
        point: x, y and scale, pixels.
        haar: (2, SAMPLES, SAMPLES) receives the responses to the right and downwards.
        inside: (2, SAMPLES) receives which rows and columns of wavelets lie in the image.
    """
    x, y, scale = point[0], point[1], point[2]
    height, width = integral.shape[0] - 1, integral.shape[1] - 1
    shares, grid = np.empty((2, GRID), np.float32), np.empty((GRID, GRID), np.float32)
    rows, columns = _grid_lines(y, scale, height, shares[0]), _grid_lines(x, scale, width, shares[1])
    _integral_at(integral, (rows, columns), shares, grid)
    for i in range(SAMPLES):
        offset = (i - MIDDLE) * scale + 0.5
        inside[0, i] = y + offset - scale >= 0 and y + offset + scale <= height
        inside[1, i] = x + offset - scale >= 0 and x + offset + scale <= width
    for i in range(SAMPLES):
        top, center, bottom = grid[i], grid[i + 1], grid[i + 2]
        for j in range(SAMPLES):
            # Box sums are differences of these: dx is the right half minus the left, dy the lower minus the upper.
            right, middle, left = bottom[j + 2] - top[j + 2], bottom[j + 1] - top[j + 1], bottom[j] - top[j]
            haar[0, i, j] = right + left - 2 * middle
            haar[1, i, j] = right - left - 2 * (center[j + 2] - top[j + 2] - center[j] + top[j])


@njit(cache=True, nogil=True)
def pool_haar(haar: Floats, inside: NDArray[np.bool_], weights: Floats, out: Floats) -> None:
    """Sum responses in cells: out (CELLS, CELLS, 4) receives sums of dx, |dx|, dy, |dy|, normalised to length 1."""
    # The weights separate: rows first, into CELLS x 4 x SAMPLES sums, then columns. So a sample is added to 2 x 4 sums
    # and not to the 4 x 4 of all cells that it belongs to.
    sums = np.zeros((CELLS, 4, SAMPLES), np.float32)
    for i in range(SAMPLES):
        # Cells overlap by half: a row belongs to two of them, from this one on; to none where it leaves the image.
        first = max(0, min(CELLS - 2, int((i - MIDDLE) / CELL_SIZE + 0.5 * (CELLS - 1))))
        for cell in range(first, first + 2 if inside[0, i] else first):
            w, total = weights[i, cell], sums[cell]
            dx, dy = haar[0, i], haar[1, i]
            for j in range(SAMPLES):  # all columns at once, as SIMD
                total[0, j] += w * dx[j]
                total[1, j] += w * abs(dx[j])
                total[2, j] += w * dy[j]
                total[3, j] += w * abs(dy[j])
    _pool_columns(sums, inside[1], weights, out)
    norm = np.sqrt(np.sum(out * out))
    if norm > 0:
        out /= norm


@njit(cache=True, nogil=True, forceinline=True)
def _pool_columns(sums: Floats, inside: NDArray[np.bool_], weights: Floats, out: Floats) -> None:
    """Add the sums of rows (CELLS, 4, SAMPLES), column by column, to out (CELLS, CELLS, 4)."""
    for cell in range(CELLS):
        for kind in range(4):
            for j in range(SAMPLES):
                if inside[j]:
                    for column in range(CELLS):
                        out[cell, column, kind] += weights[j, column] * sums[cell, kind, j]


@njit(cache=True, nogil=True)
def describe_upright(integral: Ints, points: Floats, weights: Floats) -> Floats:
    """Compute upright SURF descriptors.

    Args:
        integral: integral image of the grey image.
        points: (N, 3) float32 x right, y down and sigma, pixels.
        weights: (SAMPLES, CELLS) of `cell_weights`.

    Returns:
        (N, 64) float32 of unit length; all zeros where the surroundings are perfectly even.
    """
    out = np.zeros((len(points), CELLS, CELLS, 4), np.float32)
    haar, inside = np.empty((2, SAMPLES, SAMPLES), np.float32), np.empty((2, SAMPLES), np.bool_)
    for k in range(len(points)):
        _upright_haar(integral, points[k], haar, inside)
        pool_haar(haar, inside, weights, out[k])
    return out.reshape(len(points), CELLS * CELLS * 4)


@njit(cache=True, nogil=True)
def _haar(integral: Ints, x: float, y: float, radius: int) -> tuple[float, float]:
    """Compute the responses to the right and downwards of the wavelet nearest to a pixel; 0 if it leaves the image."""
    # A wavelet of even width is centred half a pixel before the integral coordinate of its middle.
    column, row = math.floor(x + 1.0), math.floor(y + 1.0)
    left, right, top, bottom = column - radius, column + radius, row - radius, row + radius
    if left < 0 or top < 0 or right >= integral.shape[1] or bottom >= integral.shape[0]:
        return 0.0, 0.0
    nw, n, ne = integral[top, left], integral[top, column], integral[top, right]
    w, e = integral[row, left], integral[row, right]
    sw, s, se = integral[bottom, left], integral[bottom, column], integral[bottom, right]
    whole = se - ne - sw + nw
    return float(whole - 2 * (s - n - sw + nw)), float(whole - 2 * (e - ne - w + nw))


@njit(cache=True, nogil=True)
def _gradients_by_direction(integral: Ints, point: Floats) -> NDArray[np.float64]:
    """Sum the weighted responses in the disc around a point (x, y, scale) by their direction: (DIRECTIONS, 2)."""
    sums, scale = np.zeros((DIRECTIONS, 2)), point[2]
    radius = max(1, int(2 * scale + 0.5))
    for i in range(-RADIUS, RADIUS + 1):
        for j in range(-RADIUS, RADIUS + 1):
            if i * i + j * j < RADIUS * RADIUS:
                weight = math.exp(-0.5 * (i * i + j * j) / WEIGHT_SIGMA**2)
                dx, dy = _haar(integral, point[0] + j * scale, point[1] + i * scale, radius)
                direction = int((math.atan2(dy, dx) / (2 * math.pi) + 0.5) * DIRECTIONS) % DIRECTIONS
                sums[direction, 0] += weight * dx
                sums[direction, 1] += weight * dy
    return sums


@njit(cache=True, nogil=True)
def orientation(integral: Ints, point: Floats) -> float:
    """Compute the orientation of a point (x, y, scale), radians from x towards y: the longest sum in a window."""
    sums = _gradients_by_direction(integral, point)
    best, largest = 0.0, -1.0
    for begin in range(DIRECTIONS):
        x, y = 0.0, 0.0
        for k in range(begin, begin + WINDOW):
            x += sums[k % DIRECTIONS, 0]
            y += sums[k % DIRECTIONS, 1]
        if x * x + y * y > largest:
            best, largest = math.atan2(y, x), x * x + y * y
    return best


@njit(cache=True, nogil=True)
def _rotated_haar(integral: Ints, point: Floats, angle: float, haar: Floats) -> None:
    """Compute the responses of the rotated square, into haar (2, SAMPLES, SAMPLES): along and across; 0 outside."""
    x, y, scale = point[0], point[1], point[2]
    cos, sin, radius = math.cos(angle), math.sin(angle), max(1, int(scale + 0.5))
    for i in range(SAMPLES):
        for j in range(SAMPLES):
            along, across = (j - MIDDLE) * scale, (i - MIDDLE) * scale
            dx, dy = _haar(integral, x + cos * along - sin * across, y + sin * along + cos * across, radius)
            haar[0, i, j], haar[1, i, j] = cos * dx + sin * dy, cos * dy - sin * dx


@njit(cache=True, nogil=True)
def describe_oriented(integral: Ints, points: Floats, weights: Floats) -> Floats:
    """Compute SURF descriptors (N, 64) that rotate with the image; arguments and values as of `describe_upright`."""
    out = np.zeros((len(points), CELLS, CELLS, 4), np.float32)
    haar, inside = np.empty((2, SAMPLES, SAMPLES), np.float32), np.ones((2, SAMPLES), np.bool_)
    for k in range(len(points)):
        _rotated_haar(integral, points[k], orientation(integral, points[k]), haar)
        pool_haar(haar, inside, weights, out[k])
    return out.reshape(len(points), CELLS * CELLS * 4)
