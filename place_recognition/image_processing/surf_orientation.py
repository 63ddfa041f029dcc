"""Compiled parts of oriented SURF: the dominant orientation of a blob, and its rotated descriptor.

Bay, Ess, Tuytelaars, Van Gool, 'Speeded-Up Robust Features', CVIU 110(3) 2008, sections 4.1 and 4.2.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.image_processing.surf_descriptors import CELLS, MIDDLE, SAMPLES, Floats, Ints, pool_haar

RADIUS = 6  # radius of the disc whose wavelets determine the orientation, scales
WEIGHT_SIGMA = 2.5  # sigma of the weight of a wavelet in the disc, scales
DIRECTIONS = 72  # positions of the sliding window, 5 degrees apart
WINDOW = DIRECTIONS // 6  # opening of the window, 60 degrees as in the paper


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
    best, longest = 0.0, -1.0
    for begin in range(DIRECTIONS):
        x, y = 0.0, 0.0
        for k in range(begin, begin + WINDOW):
            x += sums[k % DIRECTIONS, 0]
            y += sums[k % DIRECTIONS, 1]
        if x * x + y * y > longest:
            best, longest = math.atan2(y, x), x * x + y * y
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
