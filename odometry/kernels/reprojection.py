"""Reprojection of a point on a ray of one frame into another frame, with derivatives: shared by the adjustments.

An observation of a point is a small matrix, one row for each of its measurements, whose columns are

    error | by the anchor's pose (6) | by the frame's pose (6) | by the point (P) | by the calibration (C)

the error being the measurement less its prediction, and the rest its derivatives; P and C are those of the module
that uses it. Derivations: docs/math.md, sections "Sliding window" and "Self-calibration".
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from odometry.kernels.schur import POSE

Array = NDArray[np.float64]
Vector = tuple[float, float, float]

ERROR, ANCHOR, FRAME, BY_POINT = 0, 1, 1 + POSE, 1 + 2 * POSE  # first columns of an observation
DISTORTION = 3  # coefficients of a lens: radial, decentering along x, decentering along y

# Smallest depth in the frame over the depth in the anchor, by which the projection divides: a point that a poor guess
# puts beside or behind the camera keeps a finite residual, so large that its robust weight is next to nothing.
MIN_RELATIVE_DEPTH = 1e-2


@njit(cache=True, forceinline=True)
def relative_pose(A: Array, F: Array, out: Array) -> None:
    """Set `out` (3, 4) to the pose of the anchor A in the frame F, both (4, 4) in one map."""
    for j in range(3):
        for k in range(4):
            out[j, k] = F[0, j] * A[0, k] + F[1, j] * A[1, k] + F[2, j] * A[2, k]
        out[j, 3] -= F[0, j] * F[0, 3] + F[1, j] * F[1, 3] + F[2, j] * F[2, 3]


@njit(cache=True, forceinline=True)
def scaled_point(T: Array, ray: tuple[float, float], d: float) -> Vector:
    """Return the point at inverse depth d on a ray (x, y, 1) of the anchor, over its depth there, in the frame.

    T (3, 4) is the anchor in the frame. The result is finite for points at infinity.
    """
    rx, ry = ray
    X = T[0, 0] * rx + T[0, 1] * ry + T[0, 2] + d * T[0, 3]
    Y = T[1, 0] * rx + T[1, 1] * ry + T[1, 2] + d * T[1, 3]
    Z = max(T[2, 0] * rx + T[2, 1] * ry + T[2, 2] + d * T[2, 3], MIN_RELATIVE_DEPTH)
    return X, Y, Z


@njit(cache=True, forceinline=True)
def set_pose_columns(
    out: Array, r: int, gradient: Vector, T: Array, point: Vector, ray: tuple[float, float], d: float
) -> None:
    """Set the derivatives of row r of an observation by both poses, from its gradient by the scaled point.

    The point, ray, d and T are those of `scaled_point`; poses are perturbed on the right.
    """
    (gx, gy, gz), (X, Y, Z), (rx, ry) = gradient, point, ray
    # The frame moves by exp(w, v): the scaled point p, seen from it, changes by p x w - d v.
    out[r, 7], out[r, 8], out[r, 9] = gy * Z - gz * Y, gz * X - gx * Z, gx * Y - gy * X
    out[r, 10], out[r, 11], out[r, 12] = -d * gx, -d * gy, -d * gz
    # The anchor moves by exp(w, v): the ray changes by w x ray + d v there, which T rotates into the frame.
    hx = gx * T[0, 0] + gy * T[1, 0] + gz * T[2, 0]
    hy = gx * T[0, 1] + gy * T[1, 1] + gz * T[2, 1]
    hz = gx * T[0, 2] + gy * T[1, 2] + gz * T[2, 2]
    out[r, 1], out[r, 2], out[r, 3] = hz * ry - hy, hx - hz * rx, hy * rx - hx * ry
    out[r, 4], out[r, 5], out[r, 6] = d * hx, d * hy, d * hz


@njit(cache=True, forceinline=True)
def subtract_previous(
    now: Array, before: Array, shares: tuple[float, ...], residual: Array, J: Array, Jp: Array
) -> None:
    """Subtract from an observation's errors what the same track's errors were in the frame before.

    A tracker compares each image with the one before, so the error of a track is a random walk, whose independent
    parts are its increments: docs/math.md, section "Sliding window".

    Args:
        now: observation (R, 13 + P + C) in this frame.
        before: observation of the same point in the frame before.
        shares: share of the error before that each of the R rows still has.
        residual: (R,) set to the increments.
        J: (R, 18 + C) set to their derivatives by the poses of anchor, frame before and frame, and the calibration.
        Jp: (R, P) set to their derivatives by the point.
    """
    points, shared = Jp.shape[1], J.shape[1] - 3 * POSE
    for r in range(len(residual)):
        share = shares[r]
        residual[r] = now[r, ERROR] - share * before[r, ERROR]
        for k in range(points):
            Jp[r, k] = now[r, BY_POINT + k] - share * before[r, BY_POINT + k]
        for k in range(POSE):
            J[r, k] = now[r, ANCHOR + k] - share * before[r, ANCHOR + k]
            J[r, POSE + k] = -share * before[r, FRAME + k]
            J[r, 2 * POSE + k] = now[r, FRAME + k]
        for k in range(shared):
            column = BY_POINT + points + k
            J[r, 3 * POSE + k] = now[r, column] - share * before[r, column]


@njit(cache=True, forceinline=True)
def distortion_terms(x: float, y: float) -> tuple[Vector, Vector]:
    """Return displacements along x and along y at the ray (x, y, 1), for one pixel of each coefficient of a lens."""
    squared = x * x + y * y
    return (squared * x, squared + 2 * x * x, 2 * x * y), (squared * y, 2 * x * y, squared + 2 * y * y)
