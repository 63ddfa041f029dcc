"""Normal equations of the stereo sliding window, compiled: residuals, Jacobians and depths eliminated.

The unknowns are the poses of the window, each with a right perturbation `T @ exp(xi)` (rotation first), and an
inverse depth for every point, along the ray of the frame that saw it first: its anchor. The calibration is known.
docs/math.md, section "Sliding window", derives the residuals and their Jacobians.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from odometry.kernels.reprojection import (
    ANCHOR,
    BY_POINT,
    ERROR,
    relative_pose,
    scaled_point,
    set_pose_columns,
    subtract_previous,
)
from odometry.kernels.schur import POSE, compile_add_coupling, compile_add_rows, eliminate_depth, mirror_upper

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_ROWS = 3  # measurements of one observation: column and row in the left image, and disparity
_COLUMNS = BY_POINT + 1  # a point has one unknown here

# The left image is matched with the one before, so its errors accumulate; a disparity is matched anew in each frame.
_FIRST = (0.0, 0.0, 0.0)
_FOLLOWED = (1.0, 1.0, 0.0)
_add_rows = compile_add_rows(_ROWS, 3, 0)
_add_coupling = compile_add_coupling(_ROWS, 3, 0, 1)


@njit(cache=True, nogil=True)
def build_normal_equations(
    camera: Array, observations: tuple[Indices, Indices, Array, Array], inverse_depth: Array, poses: Array, scale: float
) -> tuple[Array, Array, Array, Array, Array]:
    """Sum the normal equations of all points, with robust weights, and eliminate the depths.

    Args:
        camera: (5,) fx, fy, cx, cy in pixels and the baseline in metres.
        observations: first row of each point's observations and their end (N + 1,); the frame of each observation
            (M,), growing for each point; its columns left and right and its row, (M, 3) pixels; the factor (M,) of
            its residual in disparity.
        inverse_depth: (N,) 1/m, in the first frame that saw the point.
        poses: (K, 4, 4) T_window_frame, metres.
        scale: squared residual, pixels squared, at which a weight is a quarter (Geman and McClure).

    Returns:
        H (6K, 6K) and b (6K,), `H @ change = -b`; squared residuals (M,), pixels squared; and for the depths:
        `inverse_depth -= offset (N,) + gain (N, 6K) @ change`.
    """
    first, frame, pixels, factor = observations
    states = POSE * len(poses)
    H, b, chi2 = np.zeros((states, states)), np.zeros(states), np.zeros(len(frame))
    gain, offset = np.zeros((len(inverse_depth), states)), np.zeros(len(inverse_depth))
    now, before, relative = np.zeros((_ROWS, _COLUMNS)), np.zeros((_ROWS, _COLUMNS)), np.zeros((3, 4))
    J, Jd, residual = np.zeros((_ROWS, 3 * POSE)), np.zeros((_ROWS, 1)), np.zeros(_ROWS)
    for i in range(len(inverse_depth)):
        curvature, slope, anchor = 0.0, 0.0, frame[first[i]]
        for m in range(first[i], first[i + 1]):
            relative_pose(poses[anchor], poses[frame[m]], relative)
            observe(camera, pixels[first[i]], pixels[m], inverse_depth[i], relative, now)
            for k in range(_COLUMNS):
                now[2, k] *= factor[m]
            if m == first[i]:  # where a point is anchored does not depend on the pose
                now[:, ANCHOR:BY_POINT] = 0.0
            subtract_previous(now, before, _FOLLOWED if m > first[i] else _FIRST, residual, J, Jd)
            chi2[m] = residual[0] * residual[0] + residual[1] * residual[1] + residual[2] * residual[2]
            weight = 1.0 / (1.0 + chi2[m] / scale) ** 2
            slope += weight * (Jd[0, 0] * residual[0] + Jd[1, 0] * residual[1] + Jd[2, 0] * residual[2])
            curvature += weight * (Jd[0, 0] * Jd[0, 0] + Jd[1, 0] * Jd[1, 0] + Jd[2, 0] * Jd[2, 0])
            starts = (POSE * anchor, POSE * frame[max(m - 1, first[i])], POSE * frame[m])
            _add_rows(H, b, starts, J, weight, residual)
            _add_coupling(gain[i : i + 1], starts, J, Jd, weight)
            before[:] = now
        offset[i] = slope / curvature
        for j in range(states):
            gain[i, j] /= curvature
        eliminate_depth(H, b, gain[i], offset[i], curvature, (POSE * anchor, states))
    mirror_upper(H)
    return H, b, chi2, gain, offset


@njit(cache=True)
def observe(camera: Array, first: Array, pixel: Array, d: float, T: Array, out: Array) -> None:
    """Set an observation (3, 14): errors, measured less predicted, in pixels, and their derivatives.

    Args:
        camera: (5,) fx, fy, cx, cy in pixels and the baseline in metres.
        first: (3,) column left, column right and row where the anchor saw the point.
        pixel: (3,) the same in the frame.
        d: inverse depth in the anchor, 1/m.
        T: (3, 4) the anchor in the frame.
        out: the columns of `odometry.kernels.reprojection`, with the inverse depth as the point.
    """
    fx, fy, cx, cy, baseline = camera
    ray = ((first[0] - cx) / fx, (first[2] - cy) / fy)
    point = scaled_point(T, ray, d)
    X, Y, Z = point
    x, y, near = X / Z, Y / Z, d / Z
    out[0, ERROR], out[1, ERROR] = pixel[0] - (fx * x + cx), pixel[2] - (fy * y + cy)
    out[2, ERROR] = fx * baseline * near - (pixel[0] - pixel[1])
    set_pose_columns(out, 0, (-fx / Z, 0.0, fx * x / Z), T, point, ray, d)
    set_pose_columns(out, 1, (0.0, -fy / Z, fy * y / Z), T, point, ray, d)
    set_pose_columns(out, 2, (0.0, 0.0, -fx * baseline * near / Z), T, point, ray, d)
    out[0, BY_POINT] = -fx * (T[0, 3] - x * T[2, 3]) / Z
    out[1, BY_POINT] = -fy * (T[1, 3] - y * T[2, 3]) / Z
    out[2, BY_POINT] = fx * baseline * (1.0 - near * T[2, 3]) / Z
