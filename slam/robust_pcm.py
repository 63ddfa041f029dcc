"""Pairwise consistency maximisation: the largest set of loops of which every two agree (Mangelson et al., ICRA 2018).

Two loops agree where the cycle through both of them and the poses between closes within its covariance. Sets
are weighed by the evidence for their loops and grown greedily, so that a crowd outvotes a clique of false ones.
"""

import numpy as np
from numpy.typing import NDArray

from slam.pose_graph_edges import Edges
from slam.pose_graph_lie import inverse
from slam.pose_graph_posterior import Posterior
from slam.robust_evidence import limit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SEEDS = 150  # loops of which every pair is looked at; the others must agree with most of those found good
_TAIL = 2.0  # on the limit: covariances are not quite known
_SHARE = 0.8  # of the good seeds that another loop must agree with
_CHUNK = 3000  # pairs at a time: memory


def agreeing(posterior: Posterior, loops: Edges, nats: Array, scale: float) -> Mask:
    """(M,) the loops to believe together.

    Args:
        posterior: of the poses, without these loops.
        loops: M edges.
        nats: (M,) evidence for each, positive.
        scale: of all covariances.
    """
    chosen = np.zeros(len(loops), dtype=bool)
    seeds = np.argsort(-nats, kind="stable")[:SEEDS]
    others = np.setdiff1d(np.arange(len(loops)), seeds)
    bound = _TAIL * limit(loops.group.dof)
    agree = pair_chi2(posterior, loops[seeds], loops[seeds], scale) <= bound
    good = heaviest_clique(agree & agree.T, nats[seeds])
    chosen[seeds[good]] = True
    if len(others):
        share = (pair_chi2(posterior, loops[others], loops[seeds[good]], scale) <= bound).mean(axis=1)
        chosen[others] = share >= _SHARE
    return chosen


def heaviest_clique(agree: Mask, weights: Array) -> NDArray[np.int64]:
    """Members of a heavy clique, found greedily: always the vertex whose remaining neighbours weigh most.

    Args:
        agree: (M, M) symmetric adjacency.
        weights: (M,) positive.
    """
    agree = agree | np.eye(len(agree), dtype=bool)
    left, members = np.ones(len(agree), dtype=bool), []
    while left.any():
        total = np.where(left, agree @ (weights * left), -1.0)
        best = int(np.argmax(total))
        members.append(best)
        left &= agree[best]
        left[best] = False
    return np.sort(np.array(members, dtype=np.int64))


def pair_chi2(posterior: Posterior, ones: Edges, others: Edges, scale: float) -> Array:
    """(A, B) chi-squares of the cycles through every two loops, covariances multiplied by a scale.

    A cycle runs from the first loop's end back to it: first loop backwards, poses
    between the two starts, second loop, poses between the two ends.
    """
    count = len(ones) * len(others)
    a, b = np.divmod(np.arange(count), max(len(others), 1))
    parts = [
        _cycle_chi2(posterior, ones[a[at : at + _CHUNK]], others[b[at : at + _CHUNK]]) for at in range(0, count, _CHUNK)
    ]
    return np.concatenate([*parts, np.zeros(0)]).reshape(len(ones), len(others)) / scale


def _cycle_chi2(posterior: Posterior, one: Edges, other: Edges) -> Array:
    """(P,) chi-squares of the cycles through P pairs of loops."""
    poses, samples, adjoint = posterior.poses, posterior.samples, one.group.adjoint
    T_start_start = inverse(poses[one.first]) @ poses[other.first]
    T_end_end = inverse(poses[other.second]) @ poses[one.second]
    other_then_end = other.motions @ T_end_end
    back = inverse(T_end_end)
    moved = (
        samples[one.second]
        - adjoint(back) @ samples[other.second]
        + adjoint(inverse(other_then_end)) @ samples[other.first]
        - adjoint(inverse(T_start_start @ other_then_end)) @ samples[one.first]
    )
    Ad = adjoint(back)
    measured = one.covariance + Ad @ other.covariance @ np.swapaxes(Ad, 1, 2)
    count, dof = moved.shape[2], moved.shape[1]
    covariance = moved @ np.swapaxes(moved, 1, 2) / (count - dof - 1) + measured
    error = one.group.log(inverse(one.motions) @ T_start_start @ other_then_end)
    solved: Array = np.linalg.solve(covariance, error[..., None])[..., 0]
    return (error * solved).sum(axis=1)
