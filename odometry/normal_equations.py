"""The inner loop of the two-view adjustment, compiled: residuals, derivatives, depth eliminated, sums.

Unknowns, in this order: the motion as a left perturbation `exp(xi) @ T_second_first` (6, rotation first),
then the rectification error (12). Everything is in pixels.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MOTION, _TERMS = 6, 6
_STATES = _MOTION + 2 * _TERMS


@njit(cache=True)
def accumulate(
    camera: Array,
    rays: Array,
    measured: Array,
    inverse_depth: Array,
    T_second_first: Array,
    rectification: Array,
    scale: float,
) -> tuple[Array, Array, Array, Array, Array]:
    """Sum the normal equations of all points, each with its depth eliminated and its robust weight.

    Args:
        camera: (5,) fx, fy, cx, cy in pixels and the baseline in metres.
        rays: (N, 2) x and y of the ray of each point at depth 1, first left camera.
        measured: (N, 6) pixels in the first right and second left image, and second right less second left.
        inverse_depth: (N,) 1/m.
        T_second_first: (4, 4) first camera in the second one's frame, metres.
        rectification: (12,) pixels.
        scale: squared residual, pixels squared, at which a weight is a quarter (Geman and McClure).

    Returns:
        H (18, 18) and b (18,), `H @ change = -b`; squared residuals (N,), pixels squared, each with
        its depth at its best; and for the depths: `inverse_depth -= offset (N,) + rows (N, 18) @ change`.

    """
    n = len(rays)
    H, b = np.zeros((_STATES, _STATES)), np.zeros(_STATES)
    chi2, rows, offset = np.empty(n), np.empty((n, _STATES)), np.empty(n)
    residual, J, Jd = np.empty(6), np.zeros((6, _STATES)), np.zeros(6)
    for i in range(n):
        _residuals(camera, rays[i], measured[i], inverse_depth[i], T_second_first, rectification, residual, J, Jd)
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
    ray: Array,
    measured: Array,
    inverse_depth: float,
    T: Array,
    rectification: Array,
    residual: Array,
    J: Array,
    Jd: Array,
) -> None:
    """Residuals (6,), measured minus predicted; derivatives J (6, 18), and Jd (6,) by the inverse depth."""
    fx, fy, cx, cy, baseline = camera
    J[:] = 0.0
    # First right image: the ray is known, the disparity is the inverse depth.
    residual[0] = measured[0] - (fx * (ray[0] - baseline * inverse_depth) + cx)
    residual[1] = measured[1] - (fy * ray[1] + cy)
    Jd[0], Jd[1] = fx * baseline, 0.0
    _subtract_rectification(rectification, ray[0], ray[1], residual, J, 0)
    # The point over its depth, in the second camera: it stays finite at infinity.
    X = T[0, 0] * ray[0] + T[0, 1] * ray[1] + T[0, 2] + T[0, 3] * inverse_depth
    Y = T[1, 0] * ray[0] + T[1, 1] * ray[1] + T[1, 2] + T[1, 3] * inverse_depth
    Z = T[2, 0] * ray[0] + T[2, 1] * ray[1] + T[2, 2] + T[2, 3] * inverse_depth
    Z = max(Z, 1e-3)
    x, y, nearness = X / Z, Y / Z, inverse_depth / Z
    residual[2] = measured[2] - (fx * x + cx)
    residual[3] = measured[3] - (fy * y + cy)
    residual[4] = measured[4] + fx * baseline * nearness
    residual[5] = measured[5]
    _subtract_rectification(rectification, x, y, residual, J, 4)
    _motion_rows(camera, x, y, nearness, J)
    Jd[2] = -fx * (T[0, 3] - x * T[2, 3]) / Z
    Jd[3] = -fy * (T[1, 3] - y * T[2, 3]) / Z
    Jd[4] = fx * baseline * (1.0 - nearness * T[2, 3]) / Z
    Jd[5] = 0.0


@njit(cache=True)
def _subtract_rectification(rectification: Array, x: float, y: float, residual: Array, J: Array, first: int) -> None:
    """Take the error field at the ray (x, y, 1) out of residuals `first` and next; set its derivatives."""
    terms = (1.0, x, y, x * x, x * y, y * y)
    for k in range(_TERMS):
        residual[first] -= terms[k] * rectification[k]
        residual[first + 1] -= terms[k] * rectification[_TERMS + k]
        J[first, _MOTION + k] = -terms[k]
        J[first + 1, _MOTION + _TERMS + k] = -terms[k]


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
