"""Robust consensus: grow the set of accepted loops greedily by likelihood ratio, and test it for chance.

Each loop is a CANDIDATE, KEPT or EXCLUDED. The algorithm, in pseudo-code (mathematics: docs/math.md):

    kept = {}                                         # on a long drive: the loops that the online map uses
    repeat:                                           # converge
        new   = propose(candidates)                   # most likely by the map, pairwise consistent
        wrong = reject(kept)                          # contradicted by the map without them
        kept  = fit(kept - wrong + new)               # least squares; what does not fit is removed again
    until hardly any loop moves
    suspend the kept loops that contradict a left-out loop which odometry supports, and converge again
    repeat twice:
        chance = test(kept)                           # false discovery control
        exclude those, fit the rest, converge again

After every fit the likelihood ratios of all loops are computed anew, against the map of the kept loops.

The suspension answers a trap: one false loop that holds a stretch of the trajectory keeps every true one there out,
however many there are. The map is bent, to first order, until it agrees with the loop that was left out; kept loops
that then no longer fit are suspended for a round and must compete with it.
"""

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.gauss_newton import factorize_jacobian, jacobian_of_errors, whitened_jacobian
from slam.pose_graph.robust.covariance_calibration import Screening
from slam.pose_graph.robust.gnc import gnc, least_squares
from slam.pose_graph.robust.likelihood_ratio import (
    MIN_LOG_RATIO,
    STRICT_FALSE_DISCOVERY_RATE,
    LoopLikelihood,
    estimate_student_dof,
    expected_false_positives,
    loop_likelihood,
    max_inlier_chi2,
    not_significant,
)
from slam.pose_graph.robust.pcm import (
    SEEDS,
    best_pair_log_ratio,
    contradicted_by_neighbors,
    is_compatible,
    pairwise_consistent,
)
from slam.pose_graph.robust.problem import LoopProblem, OnlineMap

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Counts = NDArray[np.int64]
Rows = NDArray[np.int64]

MAX_CONTENDERS = 30  # the most likely left-out loops: the dense solve of `_bends` grows with them
_MAX_ROUNDS = 50  # bound on the work
_MIN_GROWTH = 0.1  # of the kept loops: a round that would add fewer also takes the next less likely loops
_MIN_CHANGE = 0.002  # of the kept loops: a round that moves fewer ends the growth
_MIN_TAIL_SAMPLE = 100  # loops from which the 99 % quantile of their chi-square can be read
_MAX_FITS = 4  # of one set: misfits leave, the others are fitted again
_SCALE_ITERATIONS = 10  # EM steps of Student's distribution
# Odometry that bends to fit true loops has about as much chi-square as they have. Thirty times as much is a sign
# of false loops, and must not inflate the scale until they fit.
_MAX_ODOMETRY_SHARE = 30.0
_MAX_REJECTIONS = 2  # of one loop: a second chance, as the map that rejected it first had few loops
_MAX_TESTS = 2  # for chance: what leaves changes the map by which the others are tested
_MAX_SUSPENSIONS = 2  # of one loop; without a bound two loops that contradict each other would take turns
# Weights of the first scale, in loops. A fit hides odometry's drift, which persists: predictions must count on it
# longer than the residuals of the fit do.
_PRIOR_LOOPS_PREDICTION = 50.0
_PRIOR_LOOPS_FIT = 10.0
# Of the initial scale, on long drives. Where a place is passed hundreds of times loops can agree with one another far
# better than their errors allow; a scale that follows them contradicts each stretch whose drift has not been tied yet.
_MIN_LONG_SCALE_SHARE = 0.1


class LoopState(IntEnum):
    """State of a loop while the consensus grows."""

    CANDIDATE = 0  # left out; may be proposed
    KEPT = 1
    EXCLUDED = 2  # rejected `_MAX_REJECTIONS` times; never proposed again


@dataclass(frozen=True)
class Consensus:
    """The accepted loops and the map fitted to them; every step returns a new one.

    Attributes:
        poses: (N, n, n) poses fitted to the trusted edges and the kept loops, metres.
        kept: (L,) bool, the accepted loops.
        likelihood: likelihood ratio of every loop by the map of the kept ones.
        initial_scale: covariance scale of the screening, by odometry alone.
        fitted_scale: covariance scale of the residuals at the fit.
        rejections: (L,) how often each loop was accepted and then did not fit, or was not significant.
        suspensions: (L,) how often each loop was put aside because the others contradict it.
        images: (N,) number of each pose in the recording, of which the condensed problem has but some.
        min_scale: covariance scale below which that of the residuals does not fall.
    """

    poses: Array
    kept: Mask
    likelihood: LoopLikelihood
    initial_scale: float
    fitted_scale: float
    rejections: Counts
    suspensions: Counts
    images: Rows
    min_scale: float = 0.0

    @property
    def states(self) -> Counts:
        """(L,) `LoopState` of each loop."""
        left_out = np.where(self.rejections < _MAX_REJECTIONS, LoopState.CANDIDATE, LoopState.EXCLUDED)
        return np.where(self.kept, LoopState.KEPT, left_out)

    @property
    def prediction_scale(self) -> float:
        """Covariance scale for predictions: moves from the initial to the fitted scale as loops are accepted.

        It never falls below the fitted scale.
        """
        share = self.kept.sum() / (_PRIOR_LOOPS_PREDICTION + self.kept.sum())
        return float(max(self.fitted_scale, self.fitted_scale**share * self.initial_scale ** (1.0 - share)))


def grow_consensus(screening: Screening, online: OnlineMap | None = None) -> Consensus:
    """Grow the set of loops that agree with the trusted edges and with one another, on the condensed problem.

    It begins without any loop, or with the online map: after a hundred kilometres odometry may stand on its head, and
    no loop there agrees with it.
    """
    state = _empty(screening)
    if online is not None:
        state = fit(screening, replace(state, poses=online.poses[screening.condensed.rows]), online.used)
    state = _converge(screening, state)
    challenged = _challenged(screening, state)
    if challenged.any():
        state = _converge(screening, fit(screening, state, state.kept & ~challenged))
    for _ in range(_MAX_TESTS):
        chance = test(screening, state)
        if not chance.any():
            break
        state = fit(screening, state, state.kept & ~chance)
        state = replace(state, rejections=np.where(chance, _MAX_REJECTIONS, state.rejections))
        state = _converge(screening, state)
    return state


def propose(state: Consensus) -> Mask:
    """(L,) candidates to accept next: the most likely ones that agree in pairs and that no neighbour contradicts."""
    likelihood, scale = state.likelihood, state.prediction_scale
    candidates = state.states == LoopState.CANDIDATE
    plausible = np.flatnonzero(candidates & (likelihood.log_ratio_at(scale) > -MIN_LOG_RATIO))
    candidates &= ~_mask(contradicted_by_neighbors(likelihood, plausible, scale), len(candidates))
    rows = np.flatnonzero(_likeliest(state, candidates))
    if not len(rows):
        rows = _likely_in_pairs(state, np.flatnonzero(candidates & is_compatible(likelihood, scale)))
    return _mask(pairwise_consistent(likelihood, rows, scale), len(candidates))


def fit(screening: Screening, state: Consensus, use: Mask) -> Consensus:
    """Fit the map to the loops in use (L,), reject those that do not fit, and update all likelihood ratios."""
    problem = screening.condensed.problem
    fitted = _fit_inliers(problem, state, use)
    fitted = replace(fitted, rejections=state.rejections + (use & ~fitted.kept))
    if not fitted.kept.any():
        return replace(_empty(screening), rejections=fitted.rejections, suspensions=fitted.suspensions)
    likelihood = loop_likelihood(fitted.poses, problem.edges_with(fitted.kept), problem.loops)
    chi2 = likelihood.chi2_leave_one_out[fitted.kept]
    tail = float(np.quantile(chi2, 0.99)) / fitted.fitted_scale if len(chi2) >= _MIN_TAIL_SAMPLE else 0.0
    student_dof = estimate_student_dof(chi2, likelihood.dof)
    return replace(fitted, likelihood=replace(likelihood, student_dof=student_dof, tail_chi2=tail))


def reject(state: Consensus) -> Mask:
    """(L,) kept loops that the map without them contradicts, the worst half: without those the others may fit."""
    log_ratio = state.likelihood.leave_one_out(state.prediction_scale)
    contradicted = state.kept & (state.suspensions < _MAX_SUSPENSIONS) & (log_ratio < MIN_LOG_RATIO)
    worst = log_ratio[contradicted].min(initial=MIN_LOG_RATIO)
    return contradicted & (log_ratio <= 0.5 * (worst + MIN_LOG_RATIO))


def test(screening: Screening, state: Consensus) -> Mask:
    """(L,) kept loops that may be in by chance: by odometry, by the other loops, and by the map without them."""
    kept, scale = state.kept, state.prediction_scale
    likelihood = state.likelihood
    false_positives = expected_false_positives(screening.likelihood.log_ratio_at(screening.scale), kept)
    log_ratio = np.where(kept, likelihood.leave_one_out(scale), likelihood.log_ratio_at(scale))
    by_others = expected_false_positives(log_ratio, kept)
    supported = kept & likelihood.is_supported
    false_positives = np.where(supported, np.minimum(false_positives, by_others), false_positives)
    chance = not_significant(kept, false_positives)
    if not chance.any():
        return chance
    # A loop that fails is tested once more, against the map without all that failed, at a stricter rate.
    without = fit(screening, state, kept & ~chance)
    remaining = expected_false_positives(without.likelihood.log_ratio_at(without.prediction_scale), kept)
    false_positives = np.where(chance, np.minimum(false_positives, remaining), false_positives)
    return not_significant(kept, false_positives, STRICT_FALSE_DISCOVERY_RATE)


def _empty(screening: Screening) -> Consensus:
    """The consensus of no loop: odometry."""
    problem = screening.condensed.problem
    count = len(problem.loops)
    none, never = np.zeros(count, dtype=bool), np.zeros(count, dtype=np.int64)
    min_scale = 0.0 if screening.condensed.is_exact else _MIN_LONG_SCALE_SHARE * screening.scale
    scale, images = screening.scale, screening.condensed.rows
    return Consensus(problem.start, none, screening.likelihood, scale, scale, never, never, images, min_scale)


def _converge(screening: Screening, state: Consensus) -> Consensus:
    """Accept proposed loops and suspend contradicted ones until hardly any loop moves."""
    for round_ in range(_MAX_ROUNDS):
        proposed = propose(state)
        # The last round suspends none: a loop that is put aside must be able to come back.
        is_last = round_ == _MAX_ROUNDS - 1
        suspended = np.zeros_like(state.kept) if is_last else reject(state)
        moving = int((proposed | suspended).sum())
        if moving:
            state = replace(state, suspensions=state.suspensions + suspended)
            state = fit(screening, state, (state.kept & ~suspended) | proposed)
        if moving <= _MIN_CHANGE * state.kept.sum() and not suspended.any():
            break
    return state


def _likeliest(state: Consensus, candidates: Mask) -> Mask:
    """Candidates whose likelihood ratio outweighs the prior odds, else all that have some evidence.

    The threshold falls in three steps. The strictest corrects for the number of loops as Bonferroni does (one
    false loop in all of them), the last asks for the prior odds alone: few certain loops first make the map from
    which the others can be tested.
    """
    log_ratio = state.likelihood.log_ratio_at(state.prediction_scale)
    count = max(int(state.kept.sum()), 1)
    log_odds = float(np.log(max(len(log_ratio) - count, 1) / count))  # of false to true loops, by the kept ones
    log_count = float(np.log(max(len(log_ratio), 1)))
    for extra in (max(log_odds, 0.0) + log_count, max(log_odds, 0.0) + 0.5 * log_count, log_odds):
        likely: Mask = candidates & (log_ratio > MIN_LOG_RATIO + extra)
        if likely.sum() > _MIN_GROWTH * state.kept.sum():
            return likely
    return candidates & (log_ratio > MIN_LOG_RATIO + min(log_odds, 0.0)) if not likely.any() else likely


def _likely_in_pairs(state: Consensus, rows: Rows) -> Rows:
    """Candidates (M rows) that are not likely by themselves, but whose best pair is, corrected for all pairs."""
    log_ratio = state.likelihood.log_ratio_at(state.prediction_scale)[rows]
    log_pairs = 2.0 * np.log(max(len(rows), 1)) - np.log(2.0)
    rows = rows[np.argsort(-log_ratio, kind="stable")[:SEEDS]]
    best = best_pair_log_ratio(state.likelihood, rows, state.prediction_scale, state.images)
    return rows[best > MIN_LOG_RATIO + log_pairs]


def _challenged(screening: Screening, state: Consensus) -> Mask:
    """(L,) kept loops that contradict left-out loops which odometry supports: suspended, they must compete."""
    by_odometry = np.where(state.kept, -np.inf, screening.likelihood.log_ratio_at(screening.scale))
    contenders = np.argsort(-by_odometry, kind="stable")[: int((by_odometry > MIN_LOG_RATIO).sum())]
    if not len(contenders) or not state.kept.any():
        return np.zeros_like(state.kept)
    bound = max_inlier_chi2(state.likelihood.dof) * state.fitted_scale
    return conflicting_loops(screening.condensed.problem, state.poses, state.kept, contenders, bound)


def _fit_inliers(problem: LoopProblem, state: Consensus, use: Mask) -> Consensus:
    """Least squares on the loops in use, without those that do not fit, and the scale of the residuals."""
    poses, kept = least_squares(problem, use, state.poses), use
    for _ in range(_MAX_FITS):
        scale = _residual_scale(problem, state, poses, kept)
        fits = kept & _fits(problem, poses, state.likelihood, scale)
        if np.array_equal(fits, kept):
            break
        # A false loop bends the map round itself, so that true ones seem wrong. All are tested again after
        # graduated non-convexity has taken the weight from large errors.
        poses, _ = gnc(problem, kept, poses, max_inlier_chi2(state.likelihood.dof) * scale)
        kept = kept & _fits(problem, poses, state.likelihood, scale)
        poses = least_squares(problem, kept, poses)
    return replace(state, poses=poses, kept=kept, fitted_scale=scale)


def fitting_loops(problem: LoopProblem, consensus: Consensus, poses: Array) -> Mask:
    """(L,) loops that are likely where a fit (N, n, n) of a problem is taken for the truth.

    Args:
        problem: trusted edges and loops; the consensus may be that of its condensed form.
        consensus: the accepted loops.
        poses: (N, n, n) poses fitted to the trusted edges and to most of the accepted loops, metres.
    """
    likelihood = replace(consensus.likelihood, loops=problem.loops)
    return _fits(problem, poses, likelihood, _residual_scale(problem, consensus, poses, consensus.kept))


def outlying_loops(problem: LoopProblem, consensus: Consensus, poses: Array) -> Mask:
    """(L,) loops with a larger error at a fit (N, n, n) of a problem than true loops have but for one in ten thousand.

    Args: as in `fitting_loops`.
    """
    scale = _residual_scale(problem, consensus, poses, consensus.kept)
    outlying: Mask = problem.loops.chi2(poses) > max_inlier_chi2(problem.loops.group.dof) * scale
    return outlying


def _fits(problem: LoopProblem, poses: Array, likelihood: LoopLikelihood, scale: float) -> Mask:
    """(L,) loops that are likely where the fit is taken for the truth."""
    at_fit = replace(likelihood, errors=problem.loops.errors(poses))
    return at_fit.log_ratio_at_fit(scale) > MIN_LOG_RATIO


def _residual_scale(problem: LoopProblem, state: Consensus, poses: Array, kept: Mask) -> float:
    """Variance factor of the fit, drawn to the initial scale while loops are few.

    Chi-square over redundancy, where loops in the tail have less weight (EM of Student's distribution: Lange et
    al., JASA 1989). Each loop adds `dof` redundancy to a tree of odometry, so odometry's own chi-square is counted
    in the numerator and not in the denominator.
    """
    initial, student_dof = state.initial_scale, state.likelihood.student_dof
    chi2, dof = problem.loops.chi2(poses)[kept], problem.loops.group.dof
    if not len(chi2):
        return initial
    factor = max(float(np.median(chi2)) / dof, 1e-9 * initial)
    odometry = float(problem.trusted.chi2(poses).sum())
    for _ in range(_SCALE_ITERATIONS):
        loops = float(((student_dof + dof) / (student_dof + chi2 / factor) * chi2).sum())
        factor = max((loops + min(odometry, _MAX_ODOMETRY_SHARE * loops)) / (dof * len(chi2)), 1e-9 * initial)
    share = len(chi2) / (_PRIOR_LOOPS_FIT + len(chi2))
    return max(float(factor**share * initial ** (1.0 - share)), state.min_scale)


def conflicting_loops(
    problem: LoopProblem, poses: Array, kept: Mask, contenders: NDArray[np.int64], bound: float
) -> Mask:
    """(L,) kept loops that do not fit the map bent to agree with any one contender.

    A contender that contradicts more kept loops than there are contenders counts for nothing: it could not win.

    Args:
        problem: trusted edges and loops.
        poses: (N, n, n) poses fitted to the kept loops, metres.
        kept: (L,) bool, the accepted loops.
        contenders: (M,) rows of loops that were left out, the most likely first.
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


def _mask(rows: Rows, count: int) -> Mask:
    """(count,) bool, true at rows."""
    mask = np.zeros(count, dtype=bool)
    mask[rows] = True
    return mask
