"""Which kept loops contradict a loop that was left out.

One false loop that holds a stretch of the trajectory keeps every true one there out, however many there are. So the
map is bent, to first order, until it agrees with the loop that was left out. Kept loops that then no longer fit are
suspended for a round and must compete with it.
"""

import numpy as np
from numpy.typing import NDArray

from slam.pose_graph_edges import Edges
from slam.pose_graph_newton import factorize_jacobian, jacobian_of_errors, whitened_jacobian
from slam.robust_problem import LoopProblem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MAX_CONTENDERS = 30  # the most likely ones: the dense solve of `_bends` grows with them


def conflicting_loops(
    problem: LoopProblem, poses: Array, kept: Mask, contenders: NDArray[np.int64], bound: float
) -> Mask:
    """(L,) kept loops that do not fit the map bent to agree with any one contender.

    A contender that contradicts more kept loops than there are contenders counts for nothing: it could not win.

    Args:
        problem: trusted edges and loops.
        poses: (N, n, n) poses fitted to the kept loops, metres.
        kept: (L,) bool, the accepted loops.
        contenders: rows of loops that were left out, the most likely first.
        bound: chi-square that a true loop seldom exceeds.
    """
    dof, loops = problem.loops.group.dof, problem.loops
    rows = np.flatnonzero(kept)
    conflicting = np.zeros(len(loops), dtype=bool)
    # The first pose is held: it has no columns.
    bends = _bends(problem.edges_with(kept), poses, loops[contenders[:MAX_CONTENDERS]])
    moved = jacobian_of_errors(poses, loops[rows])[:, dof:] @ bends
    errors = loops[rows].errors(poses)[:, :, None] + moved.reshape(len(rows), dof, -1)
    unfit = np.square(loops[rows].sqrt_information @ errors).sum(axis=1) > bound
    outnumbered = unfit.sum(axis=0) > len(contenders)
    conflicting[rows] = unfit[:, ~outnumbered].any(axis=1)
    return conflicting


def _bends(support: Edges, poses: Array, loops: Edges) -> Array:
    """Most likely changes ((N - 1) dof, M) of all poses but the first that make each of M loops exact.

    With the posterior covariance P of the poses and the loop's Jacobian J, the change is -P J^T (J P J^T)^-1 e.
    """
    dof = loops.group.dof
    jacobian = jacobian_of_errors(poses, loops)[:, dof:].toarray().reshape(len(loops), dof, -1)
    columns = jacobian.reshape(len(loops) * dof, -1).T
    moved = factorize_jacobian(whitened_jacobian(poses, support)[:, dof:]).solve(columns)
    moved = moved.T.reshape(len(loops), dof, -1)
    covariance = jacobian @ np.swapaxes(moved, 1, 2)
    multipliers = np.linalg.solve(covariance, loops.errors(poses)[..., None])[..., 0]
    return -np.einsum("md,mdn->nm", multipliers, moved)
