"""The inner loop of the monocular adjustment, compiled: residuals, derivatives, depths eliminated, sums.

Unknowns are some of the poses, each with a right perturbation `T @ exp(xi)` (6, rotation first), the lens (3),
and an inverse depth for every point, along the ray of the frame that saw it first. Depths may have priors: one
that is not known at all leaves its point an epipolar constraint.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from odometry.window_equations import gradient, relate

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_POSE, _LENS, _POINT = 6, 3, 3
# Columns of a sighting: its errors, their derivatives by the anchor's pose, the frame's pose, the point and the lens.
_ERROR, _ANCHOR, _FRAME, _BY_POINT, _BY_LENS, _COLUMNS = 0, 1, 7, 13, 16, 19
_STATES = 3 * _POSE + _LENS  # unknowns of one residual beside the point
_SINGULAR = 1e-9  # information about a depth, pixels squared over its unit squared, that is none
_BEHIND = 1e-2  # smallest depth over depth that is divided by


@njit(cache=True)
def accumulate(
    camera: Array,
    sightings: tuple[Indices, Indices, Array],
    points: tuple[Array, Array, Array],
    poses: Array,
    states: Indices,
    lens: Array,
    noise: tuple[float, float, float],
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Sum the normal equations of all points, with robust weights, and eliminate the points.

    Args:
        camera: (4,) fx, fy, cx, cy in pixels.
        sightings: first row of each point's sightings and their end (N + 1,); the frame of each sighting (M,),
            growing for each point; its column and row, (M, 2) pixels.
        points: (N, 3) how far each is from where its first frame saw it, two pixels, and its inverse depth there;
            what the inverse depth was thought to be (N,), and the weight of that (N,), pixels squared over its
            unit squared.
        poses: (K, 4, 4) T_map_frame.
        states: (K,) first unknown of each pose, negative where the pose is fixed; the last three are the lens.
        lens: (3,) coefficients, see `odometry.lens`.
        noise: squared residual, pixels squared, at which a weight is a quarter (Geman and McClure); share of a
            track's error that it still has in the next frame; weight of a point's first sighting.

    Returns:
        H (S, S) and b (S,), `H @ change = -b`; squared residuals (M,), pixels squared; for the points
        `points -= offset (N, 3) + rows (N, 3, S) @ change`; and the information about each inverse depth (N,),
        pixels squared over its unit squared.

    """
    first, frame, places = sightings
    n, size = len(first) - 1, _LENS
    for state in states:
        if state >= 0:
            size += _POSE
    H, b, chi2 = np.zeros((size, size)), np.zeros(size), np.zeros(len(frame))
    rows, offset, known = np.zeros((n, _POINT, size)), np.zeros((n, _POINT)), np.zeros(n)
    now, before, relative = np.zeros((2, _COLUMNS)), np.zeros((2, _COLUMNS)), np.zeros((3, 4))
    J, columns = np.zeros((2, _STATES)), np.full(_STATES, size - _LENS)
    columns[3 * _POSE :] += np.arange(_LENS)
    A, g, W = np.zeros((_POINT, _POINT)), np.zeros(_POINT), np.zeros((_POINT, size))
    for i in range(n):
        W[:] = 0.0
        _prior(A, g, points[0][i], points[1][i], points[2][i], noise[2])
        anchor, previous = frame[first[i]], frame[first[i]]
        before[:] = 0.0
        before[0, _ERROR], before[1, _ERROR] = -points[0][i, 0], -points[0][i, 1]
        before[0, _BY_POINT], before[1, _BY_POINT + 1] = -1.0, -1.0
        for m in range(first[i] + 1, first[i + 1]):
            relate(poses[anchor], poses[frame[m]], relative)
            _see(camera, places[first[i]], places[m], points[0][i], relative, lens, now)
            _columns(columns, states, anchor, previous, frame[m])
            chi2[m] = _differ(now, before, noise[1], J)
            weight = 1.0 / (1.0 + chi2[m] / noise[0]) ** 2
            _add(H, b, A, g, W, J, columns, now, before, noise[1], weight)
            before[:] = now
            previous = frame[m]
        known[i] = _eliminate(H, b, A, g, W, rows[i], offset[i])
    for j in range(size):
        for k in range(j):
            H[j, k] = H[k, j]
    return H, b, chi2, rows, offset, known


@njit(cache=True)
def _prior(A: Array, g: Array, point: Array, expected: float, trust: float, weight: float) -> None:
    """Begin a point's equations with its first sighting and with what was thought of its depth."""
    A[:] = 0.0
    A[0, 0] = A[1, 1] = weight
    g[0], g[1] = weight * point[0], weight * point[1]
    A[2, 2], g[2] = trust, trust * (point[2] - expected)


@njit(cache=True)
def _columns(columns: Indices, states: Indices, anchor: int, previous: int, frame: int) -> None:
    """Set the unknowns that a residual's poses belong to, negative ones where they are fixed."""
    for k in range(_POSE):
        columns[k] = states[anchor] + k if states[anchor] >= 0 else -1
        columns[_POSE + k] = states[previous] + k if states[previous] >= 0 else -1
        columns[2 * _POSE + k] = states[frame] + k if states[frame] >= 0 else -1


@njit(cache=True)
def _differ(now: Array, before: Array, memory: float, J: Array) -> float:
    """Set the derivatives (2, 21) of what is new in an error since the frame before; its square."""
    for r in range(2):
        for k in range(_POSE):
            J[r, k] = now[r, _ANCHOR + k] - memory * before[r, _ANCHOR + k]
            J[r, _POSE + k] = -memory * before[r, _FRAME + k]
            J[r, 2 * _POSE + k] = now[r, _FRAME + k]
        for k in range(_LENS):
            J[r, 3 * _POSE + k] = now[r, _BY_LENS + k] - memory * before[r, _BY_LENS + k]
    u, v = now[0, _ERROR] - memory * before[0, _ERROR], now[1, _ERROR] - memory * before[1, _ERROR]
    return float(u * u + v * v)


@njit(cache=True)
def _add(
    H: Array, b: Array, A: Array, g: Array, W: Array, J: Array, columns: Indices,
    now: Array, before: Array, memory: float, weight: float,
) -> None:  # fmt: skip
    """Add one sighting to H above the diagonal and to b, and to its point's A, g and W."""
    for r in range(2):
        residual = now[r, _ERROR] - memory * before[r, _ERROR]
        d0 = weight * (now[r, _BY_POINT] - memory * before[r, _BY_POINT])
        d1 = weight * (now[r, _BY_POINT + 1] - memory * before[r, _BY_POINT + 1])
        d2 = weight * (now[r, _BY_POINT + 2] - memory * before[r, _BY_POINT + 2])
        for k in range(_POINT):
            d = now[r, _BY_POINT + k] - memory * before[r, _BY_POINT + k]
            A[0, k] += d0 * d
            A[1, k] += d1 * d
            A[2, k] += d2 * d
        g[0] += d0 * residual
        g[1] += d1 * residual
        g[2] += d2 * residual
        for j in range(_STATES):
            state, scaled = columns[j], weight * J[r, j]
            if state < 0 or scaled == 0.0:
                continue
            b[state] += scaled * residual
            W[0, state] += d0 * J[r, j]
            W[1, state] += d1 * J[r, j]
            W[2, state] += d2 * J[r, j]
            for k in range(_STATES):
                if columns[k] >= state:
                    H[state, columns[k]] += scaled * J[r, k]


@njit(cache=True)
def _eliminate(H: Array, b: Array, A: Array, g: Array, W: Array, rows: Array, offset: Array) -> float:
    """Take one point out of the upper half of H and out of b (Schur complement); information about its depth."""
    # the inverse of a symmetric matrix by its cofactors
    c00, c01 = A[1, 1] * A[2, 2] - A[1, 2] ** 2, A[0, 2] * A[1, 2] - A[0, 1] * A[2, 2]
    c02 = A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1]
    c11, c12 = A[0, 0] * A[2, 2] - A[0, 2] ** 2, A[0, 1] * A[0, 2] - A[0, 0] * A[1, 2]
    c22 = A[0, 0] * A[1, 1] - A[0, 1] ** 2
    determinant = A[0, 0] * c00 + A[0, 1] * c01 + A[0, 2] * c02
    if determinant <= _SINGULAR * c22:  # nothing is known of the depth: the point pulls at nothing
        return 0.0
    size = len(b)
    for j in range(size):
        w0, w1, w2 = W[0, j] / determinant, W[1, j] / determinant, W[2, j] / determinant
        rows[0, j] = c00 * w0 + c01 * w1 + c02 * w2
        rows[1, j] = c01 * w0 + c11 * w1 + c12 * w2
        rows[2, j] = c02 * w0 + c12 * w1 + c22 * w2
    offset[0] = (c00 * g[0] + c01 * g[1] + c02 * g[2]) / determinant
    offset[1] = (c01 * g[0] + c11 * g[1] + c12 * g[2]) / determinant
    offset[2] = (c02 * g[0] + c12 * g[1] + c22 * g[2]) / determinant
    for j in range(size):
        w0, w1, w2 = W[0, j], W[1, j], W[2, j]
        if w0 == 0.0 and w1 == 0.0 and w2 == 0.0:
            continue
        b[j] -= w0 * offset[0] + w1 * offset[1] + w2 * offset[2]
        for k in range(j, size):
            H[j, k] -= w0 * rows[0, k] + w1 * rows[1, k] + w2 * rows[2, k]
    return float(determinant / c22)


@njit(cache=True)
def _see(camera: Array, first: Array, place: Array, point: Array, T: Array, lens: Array, out: Array) -> None:
    """Errors of a sighting, measured less predicted, pixels, and their derivatives: a sighting's columns.

    The point was first seen at `first`, is `point` (3,) from there, and is now at `place` (2,); T (3, 4) is its
    first frame in the present one.
    """
    fx, fy, cx, cy = camera
    rx, ry, d = (first[0] - cx) / fx, (first[1] - cy) / fy, point[2]
    px, py = (place[0] - cx) / fx, (place[1] - cy) / fy
    rr, pp = rx * rx + ry * ry, px * px + py * py
    first_x = (rr * rx, rr + 2 * rx * rx, 2 * rx * ry)
    first_y = (rr * ry, 2 * rx * ry, rr + 2 * ry * ry)
    place_x = (pp * px, pp + 2 * px * px, 2 * px * py)
    place_y = (pp * py, 2 * px * py, pp + 2 * py * py)
    u, v = place[0], place[1]
    rx, ry = rx + point[0] / fx, ry + point[1] / fy
    for k in range(_LENS):
        rx += first_x[k] * lens[k] / fx
        ry += first_y[k] * lens[k] / fy
        u += place_x[k] * lens[k]
        v += place_y[k] * lens[k]
    X = T[0, 0] * rx + T[0, 1] * ry + T[0, 2] + d * T[0, 3]
    Y = T[1, 0] * rx + T[1, 1] * ry + T[1, 2] + d * T[1, 3]
    Z = max(T[2, 0] * rx + T[2, 1] * ry + T[2, 2] + d * T[2, 3], _BEHIND)
    x, y = X / Z, Y / Z
    out[0, _ERROR], out[1, _ERROR] = u - (fx * x + cx), v - (fy * y + cy)
    gradient(out, 0, (-fx / Z, 0.0, fx * x / Z), T, (X, Y, Z), (rx, ry), d)
    gradient(out, 1, (0.0, -fy / Z, fy * y / Z), T, (X, Y, Z), (rx, ry), d)
    for k in range(2):  # by the ray, in pixels of the first frame
        out[0, _BY_POINT + k] = -fx * (T[0, k] - x * T[2, k]) / (Z * camera[k])
        out[1, _BY_POINT + k] = -fy * (T[1, k] - y * T[2, k]) / (Z * camera[k])
    out[0, _BY_POINT + 2] = -fx * (T[0, 3] - x * T[2, 3]) / Z
    out[1, _BY_POINT + 2] = -fy * (T[1, 3] - y * T[2, 3]) / Z
    for k in range(_LENS):
        out[0, _BY_LENS + k] = place_x[k] + first_x[k] * out[0, _BY_POINT] + first_y[k] * out[0, _BY_POINT + 1]
        out[1, _BY_LENS + k] = place_y[k] + first_x[k] * out[1, _BY_POINT] + first_y[k] * out[1, _BY_POINT + 1]
