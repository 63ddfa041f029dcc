"""Pairwise consistency maximisation: a large set of loops that agree pairwise (Mangelson et al., ICRA 2018).

Two loops agree where the cycle through both of them and the poses between closes within its covariance. Sets
are weighted by the likelihood ratios of their loops and grown greedily, so that many true loops win over a clique of
false ones.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.marginals import Posterior
from slam.pose_graph.robust.likelihood_ratio import MIN_LOG_RATIO, LoopLikelihood, max_inlier_chi2

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Rows = NDArray[np.int64]

# Pairs grow with the square of the loops: every pair of the seeds is tested, the other loops against the seeds only.
SEEDS = 150
_MAX_PAIRS = 50_000  # of other loops and seeds: of many other loops each is tested against fewer seeds
_MIN_TESTED_SEEDS = 16
_LIMIT_FACTOR = 2.0  # on the chi-square limit of a cycle: the scale of single covariances is uncertain
_MIN_AGREEING_SHARE = 0.8  # of the accepted seeds, with which another loop must agree
_NEIGHBORS = 8  # loops nearest to a loop, itself included, that vote on it
# False loops come in runs that agree with one another: two loops are independent evidence only if both of their
# ends are this far apart.
_MIN_INDEPENDENT_POSES = 100
_MIN_WEIGHT = 1e-3  # weights of a clique must be positive
_PAIRS_PER_CHUNK = 3000  # bounds the memory


def pairwise_consistent(likelihood: LoopLikelihood, rows: Rows, scale: float) -> Rows:
    """Rows of a set of pairwise consistent loops of large weight.

    Args:
        likelihood: likelihood ratio of all L loops by the rest of the graph.
        rows: (M,) rows of the proposed loops.
        scale: covariance scale.
    """
    log_ratio = np.maximum(likelihood.log_ratio_at(scale)[rows], _MIN_WEIGHT)
    order = np.argsort(-log_ratio, kind="stable")
    seeds, others = rows[order[:SEEDS]], rows[np.sort(order[SEEDS:])]
    agree = pairwise_consistency(likelihood, seeds, seeds, scale)
    good = seeds[greedy_max_weight_clique(agree & agree.T, log_ratio[order[:SEEDS]])]
    tested = _spread(good, max(_MAX_PAIRS // max(len(others), 1), _MIN_TESTED_SEEDS))
    share = pairwise_consistency(likelihood, others, tested, scale).sum(axis=1)
    return np.sort(np.concatenate([good, others[share >= _MIN_AGREEING_SHARE * len(tested)]]))


def _spread(rows: Rows, count: int) -> Rows:
    """At most `count` of the rows, evenly spread."""
    return rows if len(rows) <= count else rows[np.linspace(0, len(rows) - 1, count).round().astype(np.int64)]


def contradicted_by_neighbors(likelihood: LoopLikelihood, rows: Rows, scale: float) -> Rows:
    """Rows of the proposed loops (M rows) that their nearest neighbours contradict, weighted by likelihood ratio.

    Only close neighbours vote: by the drift between them, loops that are far apart agree with almost anything.
    """
    if len(rows) < 2:
        return rows[:0]
    ends = np.column_stack([likelihood.loops.first[rows], likelihood.loops.second[rows]])
    _, near = cKDTree(ends).query(ends, k=min(_NEIGHBORS, len(rows)))
    one, other = np.repeat(np.arange(len(rows)), near.shape[1]), near.ravel()
    agree = (_agree(likelihood, rows[one], rows[other], scale) | (one == other)).reshape(near.shape)
    # A proposed loop has a log ratio above -MIN_LOG_RATIO, so votes are positive.
    votes = likelihood.log_ratio_at(scale)[rows] + MIN_LOG_RATIO
    return rows[(np.where(agree, 1.0, -1.0) * votes[near]).sum(axis=1) < 0.0]


def greedy_max_weight_clique(agree: Mask, weights: Array) -> Rows:
    """Members of a clique of large weight, found greedily: always the vertex whose remaining neighbours weigh most.

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


def pairwise_consistency(likelihood: LoopLikelihood, ones: Rows, others: Rows, scale: float) -> Mask:
    """(A, B) bool, whether every two loops agree."""
    a, b = np.repeat(ones, len(others)), np.tile(others, len(ones))
    return _agree(likelihood, a, b, scale).reshape(len(ones), len(others))


def _agree(likelihood: LoopLikelihood, a: Rows, b: Rows, scale: float) -> Mask:
    """(P,) bool, whether the loops of P pairs agree at a covariance scale.

    Two loops that have nothing to do with each other each add their own distance from the map to their cycle. That
    is no disagreement, so the bound is at least the sum of their own chi-squares.
    """
    bound = np.maximum(_LIMIT_FACTOR * max_inlier_chi2(likelihood.dof) * scale, likelihood.chi2[a] + likelihood.chi2[b])
    agree: Mask = _cycles(likelihood, a, b)[0] <= bound
    return agree


def is_compatible(likelihood: LoopLikelihood, scale: float) -> Mask:
    """(L,) bool, loops that the rest of the graph does not contradict, even if only because it is uncertain."""
    fits: Mask = likelihood.chi2 <= _LIMIT_FACTOR * max_inlier_chi2(likelihood.dof) * scale
    return fits


def best_pair_log_ratio(likelihood: LoopLikelihood, rows: Rows, scale: float, images: Rows) -> Array:
    """(M,) log likelihood ratio of each loop (M rows) together with the best other one that is independent of it.

    Args:
        likelihood: likelihood ratio of all loops by the rest of the graph.
        rows: (M,) rows of the loops.
        scale: covariance scale.
        images: (N,) number of each pose of the graph in the recording, of which the graph may have but some.
    """
    log_ratio, grid = likelihood.log_ratio_at(scale)[rows], (len(rows), len(rows))
    ends = images[np.column_stack([likelihood.loops.first[rows], likelihood.loops.second[rows]])]
    independent = np.abs(ends[:, None] - ends).min(axis=2) > _MIN_INDEPENDENT_POSES
    a, b = np.nonzero(independent)
    given = np.full(grid, -np.inf)
    given[a, b] = likelihood.log_ratio(*_cycles(likelihood, rows[a], rows[b]), scale)
    return np.asarray(log_ratio + given.max(axis=1, initial=-np.inf))


def _cycles(likelihood: LoopLikelihood, a: Rows, b: Rows) -> tuple[Array, Array]:
    """Chi-squares (P,) of the cycles through P pairs of loops, and log-determinants of their covariances."""
    chi2, log_det = [np.zeros(0)], [np.zeros(0)]
    for k in range(0, len(a), _PAIRS_PER_CHUNK):
        part = slice(k, k + _PAIRS_PER_CHUNK)
        values = _cycle(likelihood.posterior, likelihood.loops, a[part], b[part])
        chi2.append(values[0])
        log_det.append(values[1])
    return np.concatenate(chi2), np.concatenate(log_det)


def _cycle(posterior: Posterior, loops: Edges, a: Rows, b: Rows) -> tuple[Array, Array]:
    """Chi-squares (P,) of the cycles through P pairs of loops, and log-determinants of their covariances.

    A cycle runs from the second end of the first loop back to it: the first loop backwards, the poses between the
    two first ends, the other loop, the poses between the two second ends. Its covariance is that of the two
    measurements and that of the four poses, whose correlations the samples of the posterior carry.
    """
    one, other = loops[a], loops[b]
    poses, samples, adjoint, inverse = posterior.poses, posterior.samples, loops.group.adjoint, loops.group.inverse
    T_first_first = inverse(poses[one.first]) @ poses[other.first]
    T_second_second = inverse(poses[other.second]) @ poses[one.second]
    T_other_end = other.motions @ T_second_second
    T_back = inverse(T_second_second)
    # Each pose's perturbation is moved by the adjoint to the end of the cycle.
    Ad = adjoint(T_back)
    to_end = -Ad, adjoint(inverse(T_other_end)), -adjoint(inverse(T_first_first @ T_other_end))
    ends = np.stack([one.second, other.second, other.first, one.first], axis=1)
    measured = loops.covariance[a] + Ad @ loops.covariance[b] @ np.swapaxes(Ad, 1, 2)
    error = one.group.log(inverse(one.motions) @ T_first_first @ T_other_end)
    return _chi2_and_log_det(samples, ends, np.stack(to_end, axis=1), measured, error)


@njit(cache=True, nogil=True, error_model="numpy")
def _chi2_and_log_det(samples: Array, ends: Rows, to_end: Array, measured: Array, error: Array) -> tuple[Array, Array]:
    """Chi-squares (P,) of errors, and log-determinants of their covariances.

    Args:
        samples: (N, d, S) perturbations of the poses.
        ends: (P, 4) poses of each cycle; the first one is where it ends.
        to_end: (P, 3, d, d) what moves the perturbations of the others there, with their signs.
        measured: (P, d, d) covariances of the measurements.
        error: (P, d) by which the cycles do not close.
    """
    count, dof, drawn = len(ends), samples.shape[1], samples.shape[2]
    chi2, log_det = np.empty(count), np.empty(count)
    moved, L, whitened = np.empty((dof, drawn)), np.zeros((dof, dof)), np.empty(dof)
    for p in range(count):
        _move_to_end(samples, ends[p], to_end[p], moved)
        _factorize_covariance(moved, measured[p], L)
        chi2[p], log_det[p] = 0.0, 0.0
        for i in range(dof):
            rest = error[p, i]
            for k in range(i):
                rest -= L[i, k] * whitened[k]
            whitened[i] = rest / L[i, i]
            chi2[p] += whitened[i] ** 2
            log_det[p] += 2.0 * np.log(L[i, i])
    return chi2, log_det


@njit(cache=True)
def _move_to_end(samples: Array, ends: Rows, to_end: Array, out: Array) -> None:
    """Set `out` (d, S) to the perturbations of a cycle's four poses, added up at its end."""
    out[:] = samples[ends[0]]
    for n in range(len(to_end)):
        other = samples[ends[n + 1]]
        for i in range(len(out)):
            for k in range(len(out)):
                if to_end[n, i, k] != 0.0:
                    for m in range(out.shape[1]):
                        out[i, m] += to_end[n, i, k] * other[k, m]


@njit(cache=True, error_model="numpy")
def _factorize_covariance(samples: Array, measured: Array, out: Array) -> None:
    """Set `out` to the lower Cholesky factor of the covariance of samples (d, S) and that of measurements (d, d)."""
    dof, drawn = samples.shape
    for i in range(dof):
        for j in range(i + 1):
            total = 0.0
            for m in range(drawn):
                total += samples[i, m] * samples[j, m]
            # drawn - dof - 1 makes the inverse of the sample covariance unbiased (Hartlap et al., A&A 2007)
            total = total / (drawn - dof - 1) + measured[i, j]
            for k in range(j):
                total -= out[i, k] * out[j, k]
            out[i, j] = np.sqrt(total) if i == j else total / out[j, j]
