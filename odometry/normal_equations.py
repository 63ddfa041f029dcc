"""The inner loop of the two-view adjustment, compiled: residuals, derivatives, depth eliminated, sums.

Unknowns, in this order: the motion as a left perturbation `exp(xi) @ T_second_first` (6, rotation first),
then the calibration error (15, see `odometry.calibration`). Everything is in pixels.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MOTION, _LENS, _FIELD = 6, 3, 6
_FIRST_FIELD = _MOTION + _LENS
_STATES = _FIRST_FIELD + 2 * _FIELD


@njit(cache=True)
def accumulate(
    camera: Array, pixels: Array, inverse_depth: Array, T_second_first: Array, calibration: Array, scale: float
) -> tuple[Array, Array, Array, Array, Array]:
    """Sum the normal equations of all points, each with its depth eliminated and its robust weight.

    Args:
        camera: (5,) fx, fy, cx, cy in pixels and the baseline in metres.
        pixels: (N, 4, 2) places in the first left, first right, second left and second right image.
        inverse_depth: (N,) 1/m.
        T_second_first: (4, 4) first camera in the second one's frame, metres.
        calibration: (15,) pixels.
        scale: squared residual, pixels squared, at which a weight is a quarter (Geman and McClure).

    Returns:
        H (21, 21) and b (21,), `H @ change = -b`; squared residuals (N,), pixels squared, each with
        its depth at its best; and for the depths: `inverse_depth -= offset (N,) + rows (N, 21) @ change`.

    """
    n = len(pixels)
    H, b = np.zeros((_STATES, _STATES)), np.zeros(_STATES)
    chi2, rows, offset = np.empty(n), np.empty((n, _STATES)), np.empty(n)
    residual, J, Jd, lens = np.empty(6), np.zeros((6, _STATES)), np.zeros(6), np.empty((4, 2, _LENS))
    for i in range(n):
        _residuals(camera, pixels[i], inverse_depth[i], T_second_first, calibration, lens, residual, J, Jd)
        curvature = Jd @ Jd
        for k in range(_STATES):
            rows[i, k] = _dot(Jd, J[:, k]) / curvature
        offset[i] = (Jd @ residual) / curvature
        chi2[i] = max(residual @ residual - curvature * offset[i] ** 2, 0.0)
        weight = 1.0 / (1.0 + chi2[i] / scale) ** 2
        _add(H, b, J, residual, weight)
        _eliminate(H, b, rows[i], offset[i], weight * curvature)
    for j in range(_STATES):
        for k in range(j):
            H[j, k] = H[k, j]
    return H, b, chi2, rows, offset


@njit(cache=True)
def _dot(a: Array, b: Array) -> float:
    """Inner product of two vectors (6,), of any stride."""
    total = 0.0
    for k in range(6):
        total += a[k] * b[k]
    return total


@njit(cache=True)
def _add(H: Array, b: Array, J: Array, residual: Array, weight: float) -> None:
    """Add one point's six weighted rows to the upper half of H and to b."""
    for m in range(6):
        for j in range(_STATES):
            scaled = weight * J[m, j]
            if scaled != 0.0:
                b[j] += scaled * residual[m]
                for k in range(j, _STATES):
                    H[j, k] += scaled * J[m, k]


@njit(cache=True)
def _eliminate(H: Array, b: Array, row: Array, offset: float, curvature: float) -> None:
    """Take the share of one depth out of the upper half of H and out of b: its Schur complement."""
    for j in range(_STATES):
        scaled = curvature * row[j]
        b[j] -= scaled * offset
        for k in range(j, _STATES):
            H[j, k] -= scaled * row[k]


@njit(cache=True)
def _residuals(
    camera: Array,
    pixels: Array,
    inverse_depth: float,
    T: Array,
    calibration: Array,
    lens: Array,
    residual: Array,
    J: Array,
    Jd: Array,
) -> None:
    """Residuals (6,), corrected measurements minus predictions; J (6, 21), and Jd (6,) by the inverse depth.

    In the first right image, in the second left one, and in the second right less the second left one: the
    tracker finds the second right place from the second left one, so their difference is what is independent.
    """
    fx, fy, cx, cy, baseline = camera
    J[:] = 0.0
    for k in range(4):
        _lens_terms((pixels[k, 0] - cx) / fx, (pixels[k, 1] - cy) / fy, lens[k])
    for axis in range(2):
        residual[axis] = _corrected(pixels, lens, calibration, 1, axis) - _corrected(pixels, lens, calibration, 0, axis)
        residual[2 + axis] = _corrected(pixels, lens, calibration, 2, axis)
        residual[4 + axis] = _corrected(pixels, lens, calibration, 3, axis) - residual[2 + axis]
        for k in range(_LENS):
            J[axis, _MOTION + k] = lens[1, axis, k] - lens[0, axis, k]
            J[2 + axis, _MOTION + k] = lens[2, axis, k]
            J[4 + axis, _MOTION + k] = lens[3, axis, k] - lens[2, axis, k]
    _subtract_field(calibration, (pixels[0, 0] - cx) / fx, (pixels[0, 1] - cy) / fy, residual, J, 0)
    _subtract_field(calibration, (pixels[2, 0] - cx) / fx, (pixels[2, 1] - cy) / fy, residual, J, 4)
    # The point over its depth, in the second camera: it stays finite at infinity.
    u = (_corrected(pixels, lens, calibration, 0, 0) - cx) / fx
    v = (_corrected(pixels, lens, calibration, 0, 1) - cy) / fy
    X = T[0, 0] * u + T[0, 1] * v + T[0, 2] + T[0, 3] * inverse_depth
    Y = T[1, 0] * u + T[1, 1] * v + T[1, 2] + T[1, 3] * inverse_depth
    Z = max(T[2, 0] * u + T[2, 1] * v + T[2, 2] + T[2, 3] * inverse_depth, 1e-3)
    x, y, nearness = X / Z, Y / Z, inverse_depth / Z
    residual[0] += fx * baseline * inverse_depth
    residual[2] -= fx * x + cx
    residual[3] -= fy * y + cy
    residual[4] += fx * baseline * nearness
    _motion_rows(camera, x, y, nearness, J)
    for k in range(_LENS):
        du, dv = lens[0, 0, k] / fx, lens[0, 1, k] / fy
        dz = (T[2, 0] * du + T[2, 1] * dv) / Z
        J[2, _MOTION + k] -= fx * ((T[0, 0] * du + T[0, 1] * dv) / Z - x * dz)
        J[3, _MOTION + k] -= fy * ((T[1, 0] * du + T[1, 1] * dv) / Z - y * dz)
        J[4, _MOTION + k] -= fx * baseline * nearness * dz
    Jd[0], Jd[1] = fx * baseline, 0.0
    Jd[2] = -fx * (T[0, 3] - x * T[2, 3]) / Z
    Jd[3] = -fy * (T[1, 3] - y * T[2, 3]) / Z
    Jd[4] = fx * baseline * (1.0 - nearness * T[2, 3]) / Z
    Jd[5] = 0.0


@njit(cache=True)
def _lens_terms(x: float, y: float, terms: Array) -> None:
    """Displacements (2, 3) at the ray (x, y, 1) for one pixel of each kind of distortion."""
    squared = x * x + y * y
    terms[0, 0], terms[0, 1], terms[0, 2] = squared * x, squared + 2 * x * x, 2 * x * y
    terms[1, 0], terms[1, 1], terms[1, 2] = squared * y, 2 * x * y, squared + 2 * y * y


@njit(cache=True)
def _corrected(pixels: Array, lens: Array, calibration: Array, image: int, axis: int) -> float:
    """Coordinate of a pixel (4, 2) of one image without the lens's distortion."""
    place = pixels[image, axis]
    for k in range(_LENS):
        place += lens[image, axis, k] * calibration[k]
    return place


@njit(cache=True)
def _subtract_field(calibration: Array, x: float, y: float, residual: Array, J: Array, first: int) -> None:
    """Take the rectification error at the ray (x, y, 1) out of residuals `first` and next; set its derivatives."""
    terms = (1.0, x, y, x * x, x * y, y * y)
    for k in range(_FIELD):
        residual[first] -= terms[k] * calibration[_LENS + k]
        residual[first + 1] -= terms[k] * calibration[_LENS + _FIELD + k]
        J[first, _FIRST_FIELD + k] = -terms[k]
        J[first + 1, _FIRST_FIELD + _FIELD + k] = -terms[k]


@njit(cache=True)
def _motion_rows(camera: Array, x: float, y: float, nearness: float, J: Array) -> None:
    """Set the derivatives by the motion of a point at (x, y) and inverse depth `nearness`, second camera."""
    fx, fy, _, _, baseline = camera
    dx = (-x * y, 1.0 + x * x, -y, nearness, 0.0, -x * nearness)
    dy = (-1.0 - y * y, x * y, x, 0.0, nearness, -y * nearness)
    dnear = (-y * nearness, x * nearness, 0.0, 0.0, 0.0, -nearness * nearness)
    for k in range(_MOTION):
        J[2, k] = -fx * dx[k]
        J[3, k] = -fy * dy[k]
        J[4, k] = fx * baseline * dnear[k]
