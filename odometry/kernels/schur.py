"""Normal equations of bundle adjustment with every point eliminated: the reduced camera system.

The unknowns of an adjustment are poses, six each, then a calibration that all residuals share, and the points.
A residual touches a few poses, the calibration and one point, so the Hessian's block of the points is block-diagonal
and each point can be eliminated as soon as its residuals have been summed (Triggs et al., Bundle Adjustment, 1999,
section 6). docs/math.md, section "Schur complement", derives the formulas. For each point,

1. `add_rows` adds each residual to H and b of the cameras; only the upper triangle of H is kept up,
2. `add_coupling` adds it to W, the block of the Hessian between the point and the cameras,
3. `eliminate_depth` or `eliminate_point` takes the point out of H and b, and gives what back substitution needs.

At the end `mirror_upper` fills the lower triangle. The caller solves `H @ change = -b` and moves each point by
`point -= offset + gain @ change`. What each adjustment shares, and why: docs/decisions/schur_complement.md.
"""

from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Starts = tuple[int, ...]

POSE = 6  # unknowns of a pose: rotation, then translation
POINT = 3  # unknowns of a point: two pixels across its ray, and its inverse depth
FIXED = -1  # first unknown of a pose that is not adjusted

# Information about a depth, relative to its unit, below which it cannot be distinguished from rounding errors.
_SINGULAR = 1e-9


def compile_add_rows(rows: int, poses: int, calibration: int) -> Callable[..., None]:
    """Compile the function that adds one observation to the reduced camera system.

    The sizes are constants of the compiled code: the compiler unrolls the short loops over them, which makes the
    adjustments a third faster than loops over the arrays' shapes.

    Args:
        rows: residuals of one observation, R.
        poses: poses that it depends on, in growing order; one that occurs twice must have zeros in its second block.
        calibration: unknowns of the calibration, the last ones of H.

    Returns:
        `add_rows(H, b, starts, J, weight, residual)`, which adds `weight * J.T @ J` to the upper triangle of H
        (S, S) and `weight * J.T @ residual` to b (S,). `starts` are the first unknowns of the poses, `FIXED` where
        one is not adjusted; J is (R, 6 poses + calibration).
    """
    sizes = (poses, calibration)

    @njit(cache=True)
    def add_rows(H: Array, b: Array, starts: Starts, J: Array, weight: float, residual: Array) -> None:
        for r in range(rows):
            for m in range(poses):
                if starts[m] >= 0:
                    for j in range(POSE):
                        scaled, state = weight * J[r, POSE * m + j], starts[m] + j
                        if scaled != 0.0:
                            b[state] += scaled * residual[r]
                            _add_row_of_pose(H, starts, J, scaled, (r, m, state), sizes)
            _add_row_of_calibration(H, b, J, residual[r], weight, r, sizes)

    return add_rows


# Both functions below are pasted into `add_rows` by the compiler, where their sizes are constants.


@njit(cache=True, forceinline=True)
def _add_row_of_pose(
    H: Array, starts: Starts, J: Array, scaled: float, at: tuple[int, int, int], sizes: tuple[int, int]
) -> None:
    """Add `scaled * J[r]` to the row of H of one unknown; `at` is (r, the unknown's pose, the unknown)."""
    (r, pose, state), (poses, calibration) = at, sizes
    for n in range(pose, poses):
        if starts[n] >= 0:
            for k in range(POSE):  # all six, though half would do on the diagonal
                H[state, starts[n] + k] += scaled * J[r, POSE * n + k]
    first = H.shape[1] - calibration
    for k in range(calibration):
        H[state, first + k] += scaled * J[r, POSE * poses + k]


@njit(cache=True, forceinline=True)
def _add_row_of_calibration(
    H: Array, b: Array, J: Array, residual: float, weight: float, r: int, sizes: tuple[int, int]
) -> None:
    """Add one residual to the rows of the calibration in H and b."""
    poses, calibration = sizes
    first, end = len(b) - calibration, POSE * poses
    for j in range(calibration):
        scaled = weight * J[r, end + j]
        if scaled != 0.0:
            b[first + j] += scaled * residual
            for k in range(j, calibration):
                H[first + j, first + k] += scaled * J[r, end + k]


def compile_add_coupling(rows: int, poses: int, calibration: int, point: int) -> Callable[..., None]:
    """Compile the function that adds one observation to the Hessian's block between its point and the cameras.

    The sizes are those of `compile_add_rows`, and the unknowns of a point, P.

    Returns:
        `add_coupling(W, starts, J, Jp, weight)`, which adds `weight * Jp.T @ J` to W (P, S), Jp (R, P) being the
        Jacobian by the point.
    """
    end = POSE * poses

    @njit(cache=True)
    def add_coupling(W: Array, starts: Starts, J: Array, Jp: Array, weight: float) -> None:
        first = W.shape[1] - calibration
        for r in range(rows):
            for p in range(point):
                for m in range(poses):
                    if starts[m] >= 0:
                        for k in range(POSE):
                            W[p, starts[m] + k] += weight * J[r, POSE * m + k] * Jp[r, p]
                for k in range(calibration):
                    W[p, first + k] += weight * J[r, end + k] * Jp[r, p]

    return add_coupling


@njit(cache=True, forceinline=True)
def add_point_rows(A: Array, g: Array, Jp: Array, weighted: Array, residual: Array) -> None:
    """Add `weighted.T @ Jp` to A (3, 3) and `weighted.T @ residual` to g (3,), the point's own equations.

    Jp (R, 3) is the residuals' Jacobian by the point, `weighted` the same times the weight of each residual (R,).
    """
    for r in range(Jp.shape[0]):
        for p in range(POINT):
            for q in range(POINT):
                A[p, q] += weighted[r, p] * Jp[r, q]
            g[p] += weighted[r, p] * residual[r]


@njit(cache=True, forceinline=True)
def eliminate_depth(H: Array, b: Array, gain: Array, offset: float, curvature: float, states: tuple[int, int]) -> None:
    """Take a point with one unknown, its inverse depth, out of the upper triangle of H (S, S) and out of b (S,).

    Args:
        H: (S, S) matrix of the reduced camera system, changed in place.
        b: (S,) its right side, changed in place.
        gain: (S,) the point's coupling W over its curvature.
        offset: its gradient over its curvature.
        curvature: its own Hessian.
        states: first unknown that the point is coupled with, and the number of all unknowns S. Where the caller gives
            constants, the compiler unrolls the loops.
    """
    start, end = states
    for j in range(start, end):
        scaled = curvature * gain[j]
        if scaled != 0.0:
            b[j] -= scaled * offset
            for k in range(j, end):
                H[j, k] -= scaled * gain[k]


@njit(cache=True, forceinline=True)
def eliminate_point(H: Array, b: Array, A: Array, g: Array, W: Array, gain: Array, offset: Array) -> float:
    """Take a point with three unknowns out of the upper triangle of H (S, S) and out of b (S,).

    A point of unknown depth is not eliminated: it constrains no depth, and its gain and offset stay zero.

    Args:
        H: (S, S) matrix of the reduced camera system, changed in place.
        b: (S,) its right side, changed in place.
        A: (3, 3) matrix of the point's own equations.
        g: (3,) their right side.
        W: (3, S) its coupling with the cameras.
        gain: (3, S) set to the inverse of A times W.
        offset: (3,) set to the inverse of A times g.

    Returns:
        Information about the point's last unknown with the other two eliminated; 0 where there is none.
    """
    # The inverse of a symmetric 3 x 3 matrix by its cofactors: a tenth of the time of a factorisation by a library.
    c00, c01 = A[1, 1] * A[2, 2] - A[1, 2] ** 2, A[0, 2] * A[1, 2] - A[0, 1] * A[2, 2]
    c02 = A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1]
    c11, c12 = A[0, 0] * A[2, 2] - A[0, 2] ** 2, A[0, 1] * A[0, 2] - A[0, 0] * A[1, 2]
    c22 = A[0, 0] * A[1, 1] - A[0, 1] ** 2
    determinant = A[0, 0] * c00 + A[0, 1] * c01 + A[0, 2] * c02
    if determinant <= _SINGULAR * c22:
        return 0.0
    size = len(b)
    for j in range(size):
        w0, w1, w2 = W[0, j] / determinant, W[1, j] / determinant, W[2, j] / determinant
        gain[0, j] = c00 * w0 + c01 * w1 + c02 * w2
        gain[1, j] = c01 * w0 + c11 * w1 + c12 * w2
        gain[2, j] = c02 * w0 + c12 * w1 + c22 * w2
    offset[0] = (c00 * g[0] + c01 * g[1] + c02 * g[2]) / determinant
    offset[1] = (c01 * g[0] + c11 * g[1] + c12 * g[2]) / determinant
    offset[2] = (c02 * g[0] + c12 * g[1] + c22 * g[2]) / determinant
    for j in range(size):
        w0, w1, w2 = W[0, j], W[1, j], W[2, j]
        if w0 == 0.0 and w1 == 0.0 and w2 == 0.0:
            continue
        b[j] -= w0 * offset[0] + w1 * offset[1] + w2 * offset[2]
        for k in range(j, size):
            H[j, k] -= w0 * gain[0, k] + w1 * gain[1, k] + w2 * gain[2, k]
    return float(determinant / c22)


@njit(cache=True, forceinline=True)
def mirror_upper(H: Array) -> None:
    """Copy the upper triangle of H (S, S) to the lower one."""
    for j in range(len(H)):
        for k in range(j):
            H[j, k] = H[k, j]
