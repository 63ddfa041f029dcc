"""Normal equations of the motion between two stereo pairs, compiled: residuals, Jacobians and depths eliminated.

The unknowns are, in this order, the motion as a left perturbation `exp(xi) @ T_second_first` (6, rotation first)
and the calibration error (15, see `odometry.stereo.stereo_self_calibration`); and an inverse depth for every point.
All residuals are in pixels. docs/math.md, section "Two stereo views", derives them and their Jacobians.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from odometry.kernels.reprojection import DISTORTION, distortion_terms
from odometry.kernels.schur import POSE, eliminate_depth, mirror_upper

Array = NDArray[np.float64]

_ROWS = 6  # measurements of one point: its column and its row in the three other images
_FIELD = 6  # coefficients of the rectification error, for each of two axes
_FIRST_FIELD = POSE + DISTORTION
_STATES = _FIRST_FIELD + 2 * _FIELD

# Smallest depth over depth by which the projection divides: see `odometry.kernels.reprojection.MIN_RELATIVE_DEPTH`.
_MIN_RELATIVE_DEPTH = 1e-3


@njit(cache=True, nogil=True)
def build_normal_equations(
    camera: Array, points: tuple[Array, Array, Array], T_second_first: Array, calibration: Array, scale: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Sum the normal equations of all points, each with its depth eliminated and its robust weight.

    Args:
        camera: (5,) fx, fy, cx, cy in pixels and the baseline in metres.
        points: places (N, 4, 2) in the first left, first right, second left and second right image, pixels; factors
            (N, 2) of the residuals in the first and in the second right image; inverse depths (N,), 1/m.
        T_second_first: (4, 4) first camera in the second one's frame, metres.
        calibration: (15,) pixels.
        scale: (N,) squared residual, pixels squared, at which a weight is a quarter (Geman and McClure).

    Returns:
        H (21, 21) and b (21,), `H @ change = -b`; squared residuals (N,), pixels squared, each with
        its depth at its best; and for the depths: `inverse_depth -= offset (N,) + gain (N, 21) @ change`.
    """
    pixels, factors, inverse_depth = points
    n = len(pixels)
    H, b = np.zeros((_STATES, _STATES)), np.zeros(_STATES)
    chi2, gain, offset = np.empty(n), np.zeros((n, _STATES)), np.empty(n)
    residual, J, Jd, lens = np.empty(_ROWS), np.zeros((_ROWS, _STATES)), np.zeros(_ROWS), np.empty((4, 2, DISTORTION))
    for i in range(n):
        observe(camera, pixels[i], inverse_depth[i], T_second_first, calibration, (residual, J, Jd, lens))
        _scale_rows(residual, J, Jd, 0, factors[i, 0])
        _scale_rows(residual, J, Jd, 4, factors[i, 1])
        curvature = Jd @ Jd
        for k in range(_STATES):
            gain[i, k] = _dot(Jd, J[:, k]) / curvature
        offset[i] = (Jd @ residual) / curvature
        # One weight for all six rows: a point is an outlier as a whole, whatever depth suits it best.
        chi2[i] = max(residual @ residual - curvature * offset[i] ** 2, 0.0)
        weight = 1.0 / (1.0 + chi2[i] / scale[i]) ** 2
        _add_rows(H, b, J, residual, weight)
        eliminate_depth(H, b, gain[i], offset[i], weight * curvature, (0, _STATES))
    mirror_upper(H)
    return H, b, chi2, gain, offset


@njit(cache=True, forceinline=True)
def _scale_rows(residual: Array, J: Array, Jd: Array, first: int, factor: float) -> None:
    """Multiply residuals `first` and next, and their derivatives: a noise of their own, or none at all."""
    if factor != 1.0:
        for m in range(first, first + 2):
            residual[m], Jd[m] = factor * residual[m], factor * Jd[m]
            for k in range(_STATES):
                J[m, k] = factor * J[m, k]


@njit(cache=True)
def _dot(a: Array, b: Array) -> float:
    """Inner product of two vectors (6,), of any stride."""
    total = 0.0
    for k in range(_ROWS):
        total += a[k] * b[k]
    return total


@njit(cache=True)
def _add_rows(H: Array, b: Array, J: Array, residual: Array, weight: float) -> None:
    """Add one point's six weighted rows to the upper triangle of H and to b.

    Every residual depends on nearly all unknowns, so there are no blocks here, and the blocks of
    `odometry.kernels.schur` would take twice the time.
    """
    for m in range(_ROWS):
        for j in range(_STATES):
            scaled = weight * J[m, j]
            if scaled != 0.0:
                b[j] += scaled * residual[m]
                for k in range(j, _STATES):
                    H[j, k] += scaled * J[m, k]


@njit(cache=True, forceinline=True)
def observe(
    camera: Array,
    pixels: Array,
    inverse_depth: float,
    T: Array,
    calibration: Array,
    out: tuple[Array, Array, Array, Array],
) -> None:
    """Set the six residuals of a point, corrected measurements less predictions, and their derivatives.

    In the first right image, in the second left one, and in the second right less the second left one: the
    tracker finds the second right place from the second left one, so their difference is what is independent.

    Args:
        camera: (5,) fx, fy, cx, cy in pixels and the baseline in metres.
        pixels: (4, 2) places in the first left, first right, second left and second right image.
        inverse_depth: in the first camera, 1/m.
        T: (4, 4) first camera in the second one's frame, metres.
        calibration: (15,) pixels.
        out: residuals (6,), their derivatives by motion and calibration (6, 21) and by the inverse depth (6,), and
            room for the distortion's terms (4, 2, 3).
    """
    fx, fy, cx, cy, _ = camera
    residual, J, _, lens = out
    J[:] = 0.0
    for k in range(4):
        _set_terms(lens[k], (pixels[k, 0] - cx) / fx, (pixels[k, 1] - cy) / fy)
    for axis in range(2):
        residual[axis] = _undistort(pixels, lens, calibration, 1, axis) - _undistort(pixels, lens, calibration, 0, axis)
        residual[2 + axis] = _undistort(pixels, lens, calibration, 2, axis)
        residual[4 + axis] = _undistort(pixels, lens, calibration, 3, axis) - residual[2 + axis]
        for k in range(DISTORTION):
            J[axis, POSE + k] = lens[1, axis, k] - lens[0, axis, k]
            J[2 + axis, POSE + k] = lens[2, axis, k]
            J[4 + axis, POSE + k] = lens[3, axis, k] - lens[2, axis, k]
    _subtract_field(calibration, (pixels[0, 0] - cx) / fx, (pixels[0, 1] - cy) / fy, residual, J, 0)
    _subtract_field(calibration, (pixels[2, 0] - cx) / fx, (pixels[2, 1] - cy) / fy, residual, J, 4)
    u = (_undistort(pixels, lens, calibration, 0, 0) - cx) / fx
    v = (_undistort(pixels, lens, calibration, 0, 1) - cy) / fy
    _subtract_prediction(camera, u, v, inverse_depth, T, out)


@njit(cache=True, forceinline=True)
def _set_terms(terms: Array, x: float, y: float) -> None:
    """Set displacements (2, 3) at the ray (x, y, 1) for one pixel of each coefficient of the distortion."""
    along_x, along_y = distortion_terms(x, y)
    for k in range(DISTORTION):
        terms[0, k], terms[1, k] = along_x[k], along_y[k]


@njit(cache=True, forceinline=True)
def _undistort(pixels: Array, lens: Array, calibration: Array, image: int, axis: int) -> float:
    """Coordinate of a pixel (4, 2) of one image without the lens's distortion."""
    place = pixels[image, axis]
    for k in range(DISTORTION):
        place += lens[image, axis, k] * calibration[k]
    return place


@njit(cache=True, forceinline=True)
def _subtract_field(calibration: Array, x: float, y: float, residual: Array, J: Array, first: int) -> None:
    """Take the rectification error at the ray (x, y, 1) out of residuals `first` and next; set its derivatives."""
    terms = (1.0, x, y, x * x, x * y, y * y)
    for k in range(_FIELD):
        residual[first] -= terms[k] * calibration[DISTORTION + k]
        residual[first + 1] -= terms[k] * calibration[DISTORTION + _FIELD + k]
        J[first, _FIRST_FIELD + k] = -terms[k]
        J[first + 1, _FIRST_FIELD + _FIELD + k] = -terms[k]


@njit(cache=True, forceinline=True)
def _subtract_prediction(
    camera: Array, u: float, v: float, d: float, T: Array, out: tuple[Array, Array, Array, Array]
) -> None:
    """Take what the point at inverse depth d on the ray (u, v, 1) should look like out of the residuals."""
    fx, fy, cx, cy, baseline = camera
    residual, J, Jd, lens = out
    # The point over its depth, in the second camera: it stays finite at infinity.
    X = T[0, 0] * u + T[0, 1] * v + T[0, 2] + T[0, 3] * d
    Y = T[1, 0] * u + T[1, 1] * v + T[1, 2] + T[1, 3] * d
    Z = max(T[2, 0] * u + T[2, 1] * v + T[2, 2] + T[2, 3] * d, _MIN_RELATIVE_DEPTH)
    x, y, near = X / Z, Y / Z, d / Z
    residual[0] += fx * baseline * d
    residual[2] -= fx * x + cx
    residual[3] -= fy * y + cy
    residual[4] += fx * baseline * near
    _set_motion_columns(camera, x, y, near, J)
    for k in range(DISTORTION):
        du, dv = lens[0, 0, k] / fx, lens[0, 1, k] / fy
        dz = (T[2, 0] * du + T[2, 1] * dv) / Z
        J[2, POSE + k] -= fx * ((T[0, 0] * du + T[0, 1] * dv) / Z - x * dz)
        J[3, POSE + k] -= fy * ((T[1, 0] * du + T[1, 1] * dv) / Z - y * dz)
        J[4, POSE + k] -= fx * baseline * near * dz
    Jd[0], Jd[1] = fx * baseline, 0.0
    Jd[2] = -fx * (T[0, 3] - x * T[2, 3]) / Z
    Jd[3] = -fy * (T[1, 3] - y * T[2, 3]) / Z
    Jd[4] = fx * baseline * (1.0 - near * T[2, 3]) / Z
    Jd[5] = 0.0


@njit(cache=True, forceinline=True)
def _set_motion_columns(camera: Array, x: float, y: float, near: float, J: Array) -> None:
    """Set the derivatives by the motion of a point at (x, y) and inverse depth `near` in the second camera."""
    fx, fy, _, _, baseline = camera
    dx = (-x * y, 1.0 + x * x, -y, near, 0.0, -x * near)
    dy = (-1.0 - y * y, x * y, x, 0.0, near, -y * near)
    d_near = (-y * near, x * near, 0.0, 0.0, 0.0, -near * near)
    for k in range(POSE):
        J[2, k] = -fx * dx[k]
        J[3, k] = -fy * dy[k]
        J[4, k] = fx * baseline * d_near[k]
