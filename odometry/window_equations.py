"""The inner loop of the window's adjustment, compiled: residuals, derivatives, depths eliminated, sums.

Unknowns are the poses of the window, each with a right perturbation `T @ exp(xi)` (6, rotation first), and an
inverse depth for every point, along the ray of the frame that saw it first. Calibration is known here.

A tracker compares each image with the one before, so the error of a track is a random walk. Its independent
parts are what the error grew by from frame to frame: residuals are differences of two frames' errors.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Vector = tuple[float, float, float]

_POSE = 6
_ROWS = 3  # residuals of one sighting: column and row in the left image, and disparity
# Columns of a sighting: its errors, their derivatives by the anchor's pose, the frame's pose and the inverse depth.
_ERROR, _ANCHOR, _FRAME, _DEPTH, _COLUMNS = 0, 1, 7, 13, 14
_BEHIND = 1e-2  # smallest depth over depth that is divided by


@njit(cache=True)
def accumulate(
    camera: Array, sightings: tuple[Indices, Indices, Array], inverse_depth: Array, poses: Array, scale: float
) -> tuple[Array, Array, Array, Array, Array]:
    """Sum the normal equations of all points, with robust weights, and eliminate the depths.

    Args:
        camera: (5,) fx, fy, cx, cy in pixels and the baseline in metres.
        sightings: first row of each point's sightings and their end (N + 1,); the frame of each sighting (M,),
            growing for each point; its columns left and right and its row, (M, 3) pixels.
        inverse_depth: (N,) 1/m, in the first frame that saw the point.
        poses: (K, 4, 4) T_window_frame, metres.
        scale: squared residual, pixels squared, at which a weight is a quarter (Geman and McClure).

    Returns:
        H (6K, 6K) and b (6K,), `H @ change = -b`; squared residuals (M,), pixels squared; and for the depths:
        `inverse_depth -= offset (N,) + rows (N, 6K) @ change`.

    """
    first, frame, places = sightings
    states = _POSE * len(poses)
    H, b, chi2 = np.zeros((states, states)), np.zeros(states), np.zeros(len(frame))
    rows, offset = np.zeros((len(inverse_depth), states)), np.zeros(len(inverse_depth))
    now, before, relative = np.zeros((_ROWS, _COLUMNS)), np.zeros((_ROWS, _COLUMNS)), np.zeros((3, 4))
    J, Jd, residual = np.zeros((_ROWS, 3 * _POSE)), np.zeros(_ROWS), np.zeros(_ROWS)
    for i in range(len(inverse_depth)):
        curvature, slope, anchor = 0.0, 0.0, frame[first[i]]
        for m in range(first[i], first[i + 1]):
            relate(poses[anchor], poses[frame[m]], relative)
            _see(camera, places[first[i]], places[m], inverse_depth[i], relative, now)
            if m == first[i]:  # where a point is anchored does not depend on the pose
                now[:, _ANCHOR:_DEPTH] = 0.0
            _difference(now, before, m > first[i], residual, J, Jd)
            chi2[m] = _dot(residual, residual)
            weight = 1.0 / (1.0 + chi2[m] / scale) ** 2
            slope += weight * _dot(Jd, residual)
            curvature += weight * _dot(Jd, Jd)
            _add(H, b, rows[i], (anchor, frame[max(m - 1, first[i])], frame[m]), J, Jd, residual, weight)
            before[:] = now
        offset[i] = slope / curvature
        for j in range(states):
            rows[i, j] /= curvature
        _eliminate(H, b, rows[i], offset[i], curvature, _POSE * anchor)
    for j in range(states):
        for k in range(j):
            H[j, k] = H[k, j]
    return H, b, chi2, rows, offset


@njit(cache=True)
def _dot(a: Array, b: Array) -> float:
    """Inner product of two vectors (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def relate(A: Array, F: Array, out: Array) -> None:
    """Pose (3, 4) of the anchor A in the frame F, both (4, 4) in the window."""
    for j in range(3):
        for k in range(4):
            out[j, k] = F[0, j] * A[0, k] + F[1, j] * A[1, k] + F[2, j] * A[2, k]
        out[j, 3] -= F[0, j] * F[0, 3] + F[1, j] * F[1, 3] + F[2, j] * F[2, 3]


@njit(cache=True)
def _see(camera: Array, first: Array, place: Array, d: float, T: Array, out: Array) -> None:
    """Errors of a sighting, measured less predicted, pixels, and their derivatives: a sighting's columns.

    The point was first seen at `first` and is now at `place` (3,); T (3, 4) is its first frame in the present one.
    """
    fx, fy, cx, cy, baseline = camera
    rx, ry = (first[0] - cx) / fx, (first[2] - cy) / fy
    X = T[0, 0] * rx + T[0, 1] * ry + T[0, 2] + d * T[0, 3]
    Y = T[1, 0] * rx + T[1, 1] * ry + T[1, 2] + d * T[1, 3]
    Z = max(T[2, 0] * rx + T[2, 1] * ry + T[2, 2] + d * T[2, 3], _BEHIND)
    x, y, near = X / Z, Y / Z, d / Z
    out[0, _ERROR], out[1, _ERROR] = place[0] - (fx * x + cx), place[2] - (fy * y + cy)
    out[2, _ERROR] = fx * baseline * near - (place[0] - place[1])
    point, ray = (X, Y, Z), (rx, ry)
    gradient(out, 0, (-fx / Z, 0.0, fx * x / Z), T, point, ray, d)
    gradient(out, 1, (0.0, -fy / Z, fy * y / Z), T, point, ray, d)
    gradient(out, 2, (0.0, 0.0, -fx * baseline * near / Z), T, point, ray, d)
    out[0, _DEPTH] = -fx * (T[0, 3] - x * T[2, 3]) / Z
    out[1, _DEPTH] = -fy * (T[1, 3] - y * T[2, 3]) / Z
    out[2, _DEPTH] = fx * baseline * (1.0 - near * T[2, 3]) / Z


@njit(cache=True)
def gradient(out: Array, r: int, gradient: Vector, T: Array, point: Vector, ray: tuple[float, float], d: float) -> None:
    """Turn a gradient by the point, over its depth, in the present frame into those of row r by both poses."""
    (gx, gy, gz), (X, Y, Z), (rx, ry) = gradient, point, ray
    out[r, 7], out[r, 8], out[r, 9] = gy * Z - gz * Y, gz * X - gx * Z, gx * Y - gy * X
    out[r, 10], out[r, 11], out[r, 12] = -d * gx, -d * gy, -d * gz
    hx = gx * T[0, 0] + gy * T[1, 0] + gz * T[2, 0]
    hy = gx * T[0, 1] + gy * T[1, 1] + gz * T[2, 1]
    hz = gx * T[0, 2] + gy * T[1, 2] + gz * T[2, 2]
    out[r, 1], out[r, 2], out[r, 3] = hz * ry - hy, hx - hz * rx, hy * rx - hx * ry
    out[r, 4], out[r, 5], out[r, 6] = d * hx, d * hy, d * hz


@njit(cache=True)
def _difference(now: Array, before: Array, followed: bool, residual: Array, J: Array, Jd: Array) -> None:
    """Residuals (3,): what the left error grew by since the frame before, and the disparity's error; J (3, 18)."""
    for r in range(_ROWS):
        kept = 1.0 if followed and r < 2 else 0.0
        residual[r] = now[r, _ERROR] - kept * before[r, _ERROR]
        Jd[r] = now[r, _DEPTH] - kept * before[r, _DEPTH]
        for k in range(_POSE):
            J[r, k] = now[r, _ANCHOR + k] - kept * before[r, _ANCHOR + k]
            J[r, 6 + k] = -kept * before[r, _FRAME + k]
            J[r, 12 + k] = now[r, _FRAME + k]


@njit(cache=True)
def _add(
    H: Array, b: Array, row: Array, poses: tuple[int, int, int], J: Array, Jd: Array, residual: Array, weight: float
) -> None:
    """Add one sighting to H above the diagonal, to b and to its depth's row; the three poses never decrease."""
    for r in range(_ROWS):
        for m in range(3):
            for j in range(_POSE):
                scaled, state = weight * J[r, _POSE * m + j], _POSE * poses[m] + j
                if scaled != 0.0:
                    b[state] += scaled * residual[r]
                    row[state] += scaled * Jd[r]
                    for n in range(m, 3):
                        for k in range(_POSE):  # all six, though half would do: the compiler unrolls them
                            H[state, _POSE * poses[n] + k] += scaled * J[r, _POSE * n + k]


@njit(cache=True)
def _eliminate(H: Array, b: Array, row: Array, offset: float, curvature: float, start: int) -> None:
    """Take one depth out of the upper half of H and out of b (Schur complement); its row is zero before `start`."""
    for j in range(start, len(b)):
        scaled = curvature * row[j]
        if scaled != 0.0:
            b[j] -= scaled * offset
            for k in range(j, len(b)):
                H[j, k] -= scaled * row[k]
