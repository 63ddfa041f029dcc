"""Who stands against a loop that was left out: the kept loops that could not be true if it were.

One false loop that holds a stretch of the way shuts out every true one there, however many. So the map is bent,
to first order, until it agrees with the loop that was left out; what then no longer fits is put aside for a
round and must compete with it.
"""

import numpy as np
from numpy.typing import NDArray

from slam.pose_graph_edges import Edges
from slam.pose_graph_newton import factorized, jacobian_of_errors, whitened_jacobian
from slam.robust_problem import LoopProblem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST = 30  # contenders that are looked at


def opponents(problem: LoopProblem, poses: Array, kept: Mask, contenders: NDArray[np.int64], bound: float) -> Mask:
    """(L,) kept loops that do not fit the map bent after one contender or another.

    Not those of a contender that more loops stand against than all contenders are: no vote would go its way.

    Args:
        problem: the graph.
        poses: (N, n, n), fitted to the kept loops.
        kept: (L,) loops that are in.
        contenders: rows of loops that were left out, the surest first.
        bound: chi-square that a true loop seldom exceeds.
    """
    dof, loops = problem.loops.group.dof, problem.loops
    rows = np.flatnonzero(kept)
    against = np.zeros(len(loops), dtype=bool)
    bends = _bends(problem.using(kept), poses, loops[contenders[:MOST]])
    moved = jacobian_of_errors(poses, loops[rows])[:, dof:] @ bends
    errors = loops[rows].errors(poses)[:, :, None] + moved.reshape(len(rows), dof, -1)
    unfit = np.square(loops[rows].root @ errors).sum(axis=1) > bound
    outnumbered = unfit.sum(axis=0) > len(contenders)
    against[rows] = unfit[:, ~outnumbered].any(axis=1)
    return against


def _bends(support: Edges, poses: Array, loops: Edges) -> Array:
    """The likeliest changes ((N - 1) dof, M) of all poses but the first that make each of M loops exact."""
    dof = loops.group.dof
    jacobian = jacobian_of_errors(poses, loops)[:, dof:].toarray().reshape(len(loops), dof, -1)
    columns = jacobian.reshape(len(loops) * dof, -1).T
    moved = factorized(whitened_jacobian(poses, support)[:, dof:]).solve(columns)
    moved = moved.T.reshape(len(loops), dof, -1)
    spread = jacobian @ np.swapaxes(moved, 1, 2)
    pull = np.linalg.solve(spread, loops.errors(poses)[..., None])[..., 0]
    return -np.einsum("md,mdn->nm", pull, moved)
