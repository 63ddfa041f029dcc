"""Normal equations of the monocular bundle, compiled: residuals, Jacobians and points eliminated.

The unknowns are some of the poses, each with a right perturbation `T @ exp(xi)` (rotation first), the distortion of
the lens (3), and three for every point: two pixels from where its first frame saw it, and its inverse depth there.
Depths may have priors; a point without any information about its depth is an epipolar constraint on the poses.
docs/math.md, section "Monocular bundle", derives the residuals and their Jacobians.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from odometry.kernels.reprojection import (
    BY_POINT,
    DISTORTION,
    ERROR,
    distortion_terms,
    relative_pose,
    scaled_point,
    set_pose_columns,
    subtract_previous,
)
from odometry.kernels.schur import (
    FIXED,
    POINT,
    POSE,
    add_point_rows,
    compile_add_coupling,
    compile_add_rows,
    eliminate_point,
    mirror_upper,
)

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_ROWS = 2  # measurements of one observation: its column and its row
_BY_LENS = BY_POINT + POINT
_COLUMNS = _BY_LENS + DISTORTION
_STATES = 3 * POSE + DISTORTION  # unknowns of one residual beside the point
_add_rows = compile_add_rows(_ROWS, 3, DISTORTION)
_add_coupling = compile_add_coupling(_ROWS, 3, DISTORTION, POINT)


@njit(cache=True, nogil=True)
def build_normal_equations(
    camera: Array,
    observations: tuple[Indices, Indices, Array],
    points: tuple[Array, Array, Array],
    poses: Array,
    states: Indices,
    lens: Array,
    noise: tuple[float, float, float],
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Sum the normal equations of all points, with robust weights, and eliminate the points.

    Args:
        camera: (4,) fx, fy, cx, cy in pixels.
        observations: first row of each point's observations and their end (N + 1,); the frame of each observation
            (M,), growing for each point; its column and row, (M, 2) pixels.
        points: (N, 3) offset of each from where its first frame saw it, two pixels, and its inverse depth there;
            the prior of the inverse depth (N,), and the prior's information (N,), pixels squared over its unit
            squared.
        poses: (K, 4, 4) T_map_frame.
        states: (K,) first unknown of each pose, `FIXED` where it is not adjusted; the last three are the lens.
        lens: (3,) coefficients, see `odometry.distortion`.
        noise: squared residual, pixels squared, at which a weight is a quarter (Geman and McClure); share of a
            track's error that it still has in the next frame; weight of a point's first observation.

    Returns:
        H (S, S) and b (S,), `H @ change = -b`; squared residuals (M,), pixels squared; for the points
        `points -= offset (N, 3) + gain (N, 3, S) @ change`; and the information about each inverse depth (N,),
        pixels squared over its unit squared.
    """
    first, frame, pixels = observations
    n, size = len(first) - 1, DISTORTION
    for state in states:
        if state != FIXED:
            size += POSE
    H, b, chi2 = np.zeros((size, size)), np.zeros(size), np.zeros(len(frame))
    gain, offset, information = np.zeros((n, POINT, size)), np.zeros((n, POINT)), np.zeros(n)
    now, before, relative = np.zeros((_ROWS, _COLUMNS)), np.zeros((_ROWS, _COLUMNS)), np.zeros((3, 4))
    residual, J = np.zeros(_ROWS), np.zeros((_ROWS, _STATES))
    Jp, weighted_p, shares = np.zeros((_ROWS, POINT)), np.zeros((_ROWS, POINT)), (noise[1], noise[1])
    A, g, W = np.zeros((POINT, POINT)), np.zeros(POINT), np.zeros((POINT, size))
    for i in range(n):
        W[:] = 0.0
        _begin_point(A, g, before, points[0][i], points[1][i], points[2][i], noise[2])
        anchor, previous = frame[first[i]], frame[first[i]]
        for m in range(first[i] + 1, first[i + 1]):
            relative_pose(poses[anchor], poses[frame[m]], relative)
            observe(camera, pixels[first[i]], pixels[m], points[0][i], relative, lens, now)
            subtract_previous(now, before, shares, residual, J, Jp)
            chi2[m] = residual[0] * residual[0] + residual[1] * residual[1]
            weight = 1.0 / (1.0 + chi2[m] / noise[0]) ** 2
            _scale(Jp, weight, weighted_p)
            starts = (states[anchor], states[previous], states[frame[m]])
            add_point_rows(A, g, Jp, weighted_p, residual)
            _add_rows(H, b, starts, J, weight, residual)
            _add_coupling(W, starts, J, weighted_p, 1.0)
            before[:] = now
            previous = frame[m]
        information[i] = eliminate_point(H, b, A, g, W, gain[i], offset[i])
    mirror_upper(H)
    return H, b, chi2, gain, offset, information


@njit(cache=True)
def _begin_point(
    A: Array, g: Array, before: Array, point: Array, prior: float, information: float, weight: float
) -> None:
    """Begin a point's equations with its first observation, and with the prior of its inverse depth."""
    A[:] = 0.0
    A[0, 0] = A[1, 1] = weight
    g[0], g[1] = weight * point[0], weight * point[1]
    A[2, 2], g[2] = information, information * (point[2] - prior)
    # The first observation's error is minus the point's own two pixels, whatever the poses are.
    before[:] = 0.0
    before[0, ERROR], before[1, ERROR] = -point[0], -point[1]
    before[0, BY_POINT], before[1, BY_POINT + 1] = -1.0, -1.0


@njit(cache=True)
def _scale(Jp: Array, weight: float, out: Array) -> None:
    """Set `out` to the Jacobian by the point (2, 3) times a weight."""
    for r in range(_ROWS):
        for k in range(POINT):
            out[r, k] = weight * Jp[r, k]


@njit(cache=True)
def observe(camera: Array, first: Array, pixel: Array, point: Array, T: Array, lens: Array, out: Array) -> None:
    """Set an observation (2, 19): errors, measured less predicted, in pixels, and their derivatives.

    Args:
        camera: (4,) fx, fy, cx, cy in pixels.
        first: (2,) pixel where the anchor saw the point.
        pixel: (2,) where the frame sees it.
        point: (3,) its offset from `first`, two pixels, and its inverse depth in the anchor.
        T: (3, 4) the anchor in the frame.
        lens: (3,) coefficients of the distortion.
        out: the columns of `odometry.kernels.reprojection`, with three for the point and three for the lens.
    """
    fx, fy, cx, cy = camera
    rx, ry, d = (first[0] - cx) / fx, (first[1] - cy) / fy, point[2]
    first_x, first_y = distortion_terms(rx, ry)
    pixel_x, pixel_y = distortion_terms((pixel[0] - cx) / fx, (pixel[1] - cy) / fy)
    u, v = pixel[0], pixel[1]
    rx, ry = rx + point[0] / fx, ry + point[1] / fy
    for k in range(DISTORTION):
        rx += first_x[k] * lens[k] / fx
        ry += first_y[k] * lens[k] / fy
        u += pixel_x[k] * lens[k]
        v += pixel_y[k] * lens[k]
    ray = (rx, ry)
    scaled = scaled_point(T, ray, d)
    X, Y, Z = scaled
    x, y = X / Z, Y / Z
    out[0, ERROR], out[1, ERROR] = u - (fx * x + cx), v - (fy * y + cy)
    set_pose_columns(out, 0, (-fx / Z, 0.0, fx * x / Z), T, scaled, ray, d)
    set_pose_columns(out, 1, (0.0, -fy / Z, fy * y / Z), T, scaled, ray, d)
    for k in range(2):  # the ray moves by one pixel of the anchor's image over the focal length
        out[0, BY_POINT + k] = -fx * (T[0, k] - x * T[2, k]) / (Z * camera[k])
        out[1, BY_POINT + k] = -fy * (T[1, k] - y * T[2, k]) / (Z * camera[k])
    out[0, BY_POINT + 2] = -fx * (T[0, 3] - x * T[2, 3]) / Z
    out[1, BY_POINT + 2] = -fy * (T[1, 3] - y * T[2, 3]) / Z
    for k in range(DISTORTION):  # the lens moves the pixel that is measured, and the ray like the point's two pixels
        out[0, _BY_LENS + k] = pixel_x[k] + first_x[k] * out[0, BY_POINT] + first_y[k] * out[0, BY_POINT + 1]
        out[1, _BY_LENS + k] = pixel_y[k] + first_x[k] * out[1, BY_POINT] + first_y[k] * out[1, BY_POINT + 1]
