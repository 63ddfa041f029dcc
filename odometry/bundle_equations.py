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

_POSE, _LENS = 6, 3
# Columns of a sighting: its errors, their derivatives by the anchor's pose, the frame's pose, the inverse depth
# and the lens.
_ERROR, _ANCHOR, _FRAME, _DEPTH, _BY_LENS, _COLUMNS = 0, 1, 7, 13, 14, 17
_BEHIND = 1e-2  # smallest depth over depth that is divided by


@njit(cache=True)
def accumulate(
    camera: Array,
    sightings: tuple[Indices, Indices, Array],
    depths: tuple[Array, Array, Array],
    poses: Array,
    states: Indices,
    lens: Array,
    scale: float,
    memory: float,
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Sum the normal equations of all points, with robust weights, and eliminate the depths.

    Args:
        camera: (4,) fx, fy, cx, cy in pixels.
        sightings: first row of each point's sightings and their end (N + 1,); the frame of each sighting (M,),
            growing for each point; its column and row, (M, 2) pixels.
        depths: inverse depth (N,) in the first frame that saw the point; what it was thought to be (N,), and the
            weight of that (N,), in pixels squared over its unit squared.
        poses: (K, 4, 4) T_window_frame.
        states: (K,) first unknown of each pose, negative where the pose is fixed; the last three are the lens.
        lens: (3,) coefficients, see `odometry.lens`.
        scale: squared residual, pixels squared, at which a weight is a quarter (Geman and McClure).
        memory: share of a track's error that it still has in the next frame.

    Returns:
        H (S, S) and b (S,), `H @ change = -b`; squared residuals (M,), pixels squared; for the depths
        `inverse_depth -= offset (N,) + rows (N, S) @ change`, and their curvature (N,), pixels squared over unit squared.

    """
    first, frame, places = sightings
    inverse_depth, expected, trust = depths
    size = _LENS
    for state in states:
        if state >= 0:
            size += _POSE
    H, b, chi2 = np.zeros((size, size)), np.zeros(size), np.zeros(len(frame))
    n = len(inverse_depth)
    rows, offset, curvature = np.zeros((n, size)), np.zeros(n), np.zeros(n)
    now, before, relative = np.zeros((2, _COLUMNS)), np.zeros((2, _COLUMNS)), np.zeros((3, 4))
    J = np.zeros((2, 3 * _POSE + _LENS))
    columns = np.zeros(3 * _POSE + _LENS, np.int64)
    lens_state = size - _LENS
    for k in range(_LENS):
        columns[3 * _POSE + k] = lens_state + k
    for i in range(n):
        anchor = frame[first[i]]
        slope = trust[i] * (inverse_depth[i] - expected[i])
        curvature[i] = trust[i]
        before[:] = 0.0
        previous = anchor
        for m in range(first[i] + 1, first[i + 1]):
            relate(poses[anchor], poses[frame[m]], relative)
            _see(camera, places[first[i]], places[m], inverse_depth[i], relative, lens, now)
            r0 = now[0, _ERROR] - memory * before[0, _ERROR]
            r1 = now[1, _ERROR] - memory * before[1, _ERROR]
            d0 = now[0, _DEPTH] - memory * before[0, _DEPTH]
            d1 = now[1, _DEPTH] - memory * before[1, _DEPTH]
            for r in range(2):
                for k in range(_POSE):
                    J[r, k] = now[r, _ANCHOR + k] - memory * before[r, _ANCHOR + k]
                    J[r, _POSE + k] = -memory * before[r, _FRAME + k]
                    J[r, 2 * _POSE + k] = now[r, _FRAME + k]
                for k in range(_LENS):
                    J[r, 3 * _POSE + k] = now[r, _BY_LENS + k] - memory * before[r, _BY_LENS + k]
            for k in range(_POSE):
                columns[k] = states[anchor] + k if states[anchor] >= 0 else -1
                columns[_POSE + k] = states[previous] + k if states[previous] >= 0 else -1
                columns[2 * _POSE + k] = states[frame[m]] + k if states[frame[m]] >= 0 else -1
            chi2[m] = r0 * r0 + r1 * r1
            weight = 1.0 / (1.0 + chi2[m] / scale) ** 2
            slope += weight * (d0 * r0 + d1 * r1)
            curvature[i] += weight * (d0 * d0 + d1 * d1)
            for j in range(3 * _POSE + _LENS):
                if columns[j] < 0:
                    continue
                w0, w1, cj = weight * J[0, j], weight * J[1, j], columns[j]
                if w0 == 0.0 and w1 == 0.0:
                    continue
                b[cj] += w0 * r0 + w1 * r1
                rows[i, cj] += w0 * d0 + w1 * d1
                for k in range(3 * _POSE + _LENS):
                    if columns[k] >= cj:
                        H[cj, columns[k]] += w0 * J[0, k] + w1 * J[1, k]
            before[:] = now
            previous = frame[m]
        c = curvature[i] + 1e-12
        offset[i] = slope / c
        for j in range(size):
            rows[i, j] /= c
        for j in range(size):
            scaled = c * rows[i, j]
            if scaled != 0.0:
                b[j] -= scaled * offset[i]
                for k in range(j, size):
                    H[j, k] -= scaled * rows[i, k]
    for j in range(size):
        for k in range(j):
            H[j, k] = H[k, j]
    return H, b, chi2, rows, offset, curvature


@njit(cache=True)
def _see(
    camera: Array, first: Array, place: Array, d: float, T: Array, lens: Array, out: Array
) -> None:
    """Errors of a sighting, measured less predicted, pixels, and their derivatives: a sighting's columns.

    The point was first seen at `first` and is now at `place` (2,); T (3, 4) is its first frame in the present one.
    """
    fx, fy, cx, cy = camera
    rx, ry = (first[0] - cx) / fx, (first[1] - cy) / fy
    px, py = (place[0] - cx) / fx, (place[1] - cy) / fy
    rr, pp = rx * rx + ry * ry, px * px + py * py
    first_x = (rr * rx, rr + 2 * rx * rx, 2 * rx * ry)
    first_y = (rr * ry, 2 * rx * ry, rr + 2 * ry * ry)
    place_x = (pp * px, pp + 2 * px * px, 2 * px * py)
    place_y = (pp * py, 2 * px * py, pp + 2 * py * py)
    u, v = place[0], place[1]
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
    point, ray = (X, Y, Z), (rx, ry)
    gradient(out, 0, (-fx / Z, 0.0, fx * x / Z), T, point, ray, d)
    gradient(out, 1, (0.0, -fy / Z, fy * y / Z), T, point, ray, d)
    out[0, _DEPTH] = -fx * (T[0, 3] - x * T[2, 3]) / Z
    out[1, _DEPTH] = -fy * (T[1, 3] - y * T[2, 3]) / Z
    for k in range(_LENS):
        du, dv = first_x[k] / fx, first_y[k] / fy
        dX, dY = T[0, 0] * du + T[0, 1] * dv, T[1, 0] * du + T[1, 1] * dv
        dZ = T[2, 0] * du + T[2, 1] * dv
        out[0, _BY_LENS + k] = place_x[k] - fx * (dX - x * dZ) / Z
        out[1, _BY_LENS + k] = place_y[k] - fy * (dY - y * dZ) / Z
