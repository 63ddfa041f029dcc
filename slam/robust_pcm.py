"""Pairwise consistency maximisation: the largest set of loops of which every two agree (Mangelson et al., ICRA 2018).

Two loops agree where the cycle through both of them and the poses between closes within its covariance. Sets
are weighed by the evidence for their loops and grown greedily, so that a crowd outvotes a clique of false ones.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from slam.pose_graph_edges import Edges
from slam.pose_graph_lie import inverse
from slam.pose_graph_posterior import Posterior
from slam.robust_evidence import LEAST_EVIDENCE, Evidence, limit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Rows = NDArray[np.int64]

SEEDS = 150  # loops of which every pair is looked at; the others must agree with most of those found good
_TAIL = 2.0  # on the limit: covariances are not quite known
_SHARE = 0.8  # of the good seeds that another loop must agree with
_NEAR = 8  # loops next to each other, itself included, that have a say on it
_RUN = 100  # poses between two loops, at both ends, that cannot be of one run of false ones
_LEAST = 1e-3  # nats, of a weight
_CHUNK = 3000  # pairs at a time: memory


def agreeing(found: Evidence, rows: Rows, scale: float) -> Rows:
    """Those of the offered loops (M rows) to believe together.

    Args:
        found: evidence for all loops by the rest of the graph.
        rows: of the loops that are offered.
        scale: of all covariances.
    """
    nats = np.maximum(found.at(scale)[rows], _LEAST)
    order = np.argsort(-nats, kind="stable")
    seeds, others = rows[order[:SEEDS]], rows[np.sort(order[SEEDS:])]
    agree = agreement(found, seeds, seeds, scale)
    good = seeds[heaviest_clique(agree & agree.T, nats[order[:SEEDS]])]
    share = agreement(found, others, good, scale).sum(axis=1)
    return np.sort(np.concatenate([good, others[share >= _SHARE * len(good)]]))


def outvoted(found: Evidence, rows: Rows, scale: float) -> Rows:
    """Those of the offered loops (M rows) against which more evidence speaks, of the loops next to each, than for them.

    The others of a crowd agree with nearly everything far away; who is wrong shows close by.
    """
    if len(rows) < 2:
        return rows[:0]
    ends = np.column_stack([found.loops.first[rows], found.loops.second[rows]])
    _, near = cKDTree(ends).query(ends, k=min(_NEAR, len(rows)))
    one, other = np.repeat(np.arange(len(rows)), near.shape[1]), near.ravel()
    agree = (_agree(found, rows[one], rows[other], scale) | (one == other)).reshape(near.shape)
    say = found.at(scale)[rows] + LEAST_EVIDENCE  # none for a loop that is as good as excluded
    return rows[(np.where(agree, 1.0, -1.0) * say[near]).sum(axis=1) < 0.0]


def heaviest_clique(agree: Mask, weights: Array) -> Rows:
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


def agreement(found: Evidence, ones: Rows, others: Rows, scale: float) -> Mask:
    """(A, B) whether every two loops agree."""
    a, b = np.repeat(ones, len(others)), np.tile(others, len(ones))
    return _agree(found, a, b, scale).reshape(len(ones), len(others))


def _agree(found: Evidence, a: Rows, b: Rows, scale: float) -> Mask:
    """(P,) whether loops of P pairs agree, covariances multiplied by a scale.

    Each of two that have nothing to do with one another adds what it misses the map by itself to their cycle:
    that is no disagreement.
    """
    bound = np.maximum(_TAIL * limit(found.dof) * scale, found.chi2[a] + found.chi2[b])
    agree: Mask = _cycles(found, a, b)[0] <= bound
    return agree


def fitting(found: Evidence, scale: float) -> Mask:
    """(L,) loops that the rest of the graph does not contradict, be it for want of knowledge."""
    fits: Mask = found.chi2 <= _TAIL * limit(found.dof) * scale
    return fits


def in_company(found: Evidence, rows: Rows, scale: float) -> Array:
    """(M,) nats in favour of each loop (M rows) together with one other, the best of all that lie well apart.

    False loops come in runs that agree with one another, so a neighbour proves nothing.
    """
    nats, grid = found.at(scale)[rows], (len(rows), len(rows))
    ends = np.column_stack([found.loops.first[rows], found.loops.second[rows]])
    apart = np.abs(ends[:, None] - ends).min(axis=2) > _RUN
    a, b = np.nonzero(apart)
    given = np.full(grid, -np.inf)
    given[a, b] = found.nats(*_cycles(found, rows[a], rows[b]), scale)
    return np.asarray(nats + given.max(axis=1, initial=-np.inf))


def _cycles(found: Evidence, a: Rows, b: Rows) -> tuple[Array, Array]:
    """Chi-squares (P,) of the cycles through P pairs of loops, and log-determinants of their covariances."""
    loops, parts = found.loops, range(0, len(a), _CHUNK)
    pairs = [_cycle(found.posterior, loops[a[k : k + _CHUNK]], loops[b[k : k + _CHUNK]]) for k in parts]
    none = np.zeros(0)
    return np.concatenate([*(pair[0] for pair in pairs), none]), np.concatenate([*(pair[1] for pair in pairs), none])


def _cycle(posterior: Posterior, one: Edges, other: Edges) -> tuple[Array, Array]:
    """Chi-squares (P,) of the cycles through P pairs of loops, and log-determinants of their covariances.

    A cycle runs from the first loop's end back to it: first loop backwards, poses
    between the two starts, second loop, poses between the two ends.
    """
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
    return (error * solved).sum(axis=1), np.linalg.slogdet(covariance)[1]
