"""Robust back ends by name: which loops the final map uses, and why the others were left out.

A back end is a function of a `LoopProblem` and of the screening of its loops; adding one is one function and
one line in `BACK_ENDS` (docs/add_a_back_end.md). All but `none` start from loops that passed a gate on each alone.
Chi-square is the squared Mahalanobis length of an error.

Robust kernels are weights that fall as a loop's chi-square grows, by iteratively reweighted least squares.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from slam.errors import ConfigError, GraphError
from slam.pose_graph.optimization.gauss_newton import IrlsSchedule, conjugate_gradients, irls
from slam.pose_graph.optimization.gtsam_solver import optimize, refine
from slam.pose_graph.optimization.lie_groups import similarities
from slam.pose_graph.robust.consensus import Consensus, fitting_loops, grow_consensus, outlying_loops
from slam.pose_graph.robust.covariance_calibration import Screening, screen
from slam.pose_graph.robust.gnc import gnc, least_squares
from slam.pose_graph.robust.likelihood_ratio import MIN_LOG_RATIO
from slam.pose_graph.robust.pcm import pairwise_consistent
from slam.pose_graph.robust.problem import MIN_KEPT_WEIGHT, BackEndResult, CondensedProblem, LoopProblem

__all__ = [
    "BACK_ENDS",
    "DEFAULT",
    "BackEndResult",
    "GateResult",
    "LoopProblem",
    "OptimizationResult",
    "back_end",
    "solve",
]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

DEFAULT = "pcm+gnc"

# The whole fit of a long drive starts from that of the condensed problem.
_MAX_LONG_STEPS = 10
_LONG_TOLERANCE = 1e-3  # mean chi-squares of an edge

Kernel = Callable[[Array, float], Array]  # chi-squares (M,), limit -> weights (M,)


@dataclass(frozen=True)
class GateResult:
    """Test of a loop by itself against odometry, before any optimisation.

    Attributes:
        passed: whether the drift that odometry may have can explain the loop.
        residual: square root of the loop's chi-square against odometry.
        reason: the result in a sentence, with the numbers.
    """

    passed: bool
    residual: float
    reason: str


@dataclass(frozen=True)
class OptimizationResult:
    """The corrected trajectory, and the decision on each loop, in the order in which the loops were added.

    Attributes:
        poses: (N, n, n) T_world_camera in space, metres.
        weights: (L,) weight of each loop by the back end, 0 to 1.
        residuals: (L,) square root of each loop's chi-square at `poses`.
        kept: (L,) bool, the loops to which the poses are fitted.
        reasons: (L,) reason why each loop was kept or left out, a sentence each.
        error_initial, error_final: half the chi-square of odometry and kept loops, at odometry and at `poses`.
        seconds: wall-clock time of the optimisation.
        scales: (N,) length of each frame's unit of length in that of `poses`; all one with a stereo camera.
    """

    poses: Array
    weights: Array
    residuals: Array
    kept: Mask
    reasons: tuple[str, ...]
    error_initial: float
    error_final: float
    seconds: float
    scales: Array

    @property
    def similarities(self) -> Array:
        """(N, 4, 4) similarities that take points from a camera, in its own unit, to the world."""
        return similarities(self.poses, self.scales)


def huber(chi2: Array, limit: float) -> Array:
    """Huber (1964): the force of large errors is constant; the width is the square root of the limit."""
    return np.sqrt(limit / np.maximum(chi2, limit))


def dcs(chi2: Array, limit: float) -> Array:
    """Dynamic covariance scaling (Agarwal et al., ICRA 2013, equation 15), phi being the limit."""
    return np.square(np.minimum(1.0, 2.0 * limit / (limit + chi2)))


def switchable(chi2: Array, limit: float) -> Array:
    """Switchable constraints (Sünderhauf and Protzel, IROS 2012) with each switch at its optimum.

    The switch s of a loop minimises s^2 chi^2 + limit (1 - s)^2.
    """
    return np.square(limit / (limit + chi2))


def kernel_poses(problem: LoopProblem, screening: Screening, kernel: Kernel) -> tuple[Array, Array]:
    """Poses (N, n, n) and weights (L,) under a kernel on the loops that passed the gate.

    Starts from Huber's solution: at odometry a kernel that falls faster is saturated and gives every loop up.
    """
    use, trusted = screening.passed, len(problem.trusted)
    weights = np.zeros(len(problem.loops))
    if not use.any():
        return problem.start, weights
    edges, limit = problem.edges_with(use), screening.max_inlier_chi2

    def reweight(by: Kernel) -> Callable[[Array, int], Array]:
        return lambda chi2, step: np.concatenate([np.ones(trusted), by(chi2[trusted:], limit)])

    poses = irls(least_squares(problem, use, problem.start), edges, reweight(huber))
    poses = irls(poses, edges, reweight(kernel))
    weights[use] = kernel(problem.loops.chi2(poses)[use], limit)
    return poses, weights


def _all_loops(problem: LoopProblem, screening: Screening) -> BackEndResult:
    """Least squares on every loop, true or false: the baseline."""
    return _fit_from_odometry(problem, np.ones(len(problem.loops), dtype=bool))


def _with_kernel(kernel: Kernel) -> "BackEnd":
    """Back end of a robust kernel on the gated loops."""

    def run(problem: LoopProblem, screening: Screening) -> BackEndResult:
        return BackEndResult(*kernel_poses(problem, screening, kernel), reasons=())

    return run


def _gnc(problem: LoopProblem, screening: Screening) -> BackEndResult:
    """Graduated non-convexity on the gated loops, odometry taken to be right (Yang et al., RA-L 2020)."""
    use = screening.passed
    if not use.any():
        return _fit_from_odometry(problem, use)
    # From least squares on the gated loops: from odometry the large first residuals set the schedule, and every
    # loop is rejected (docs/decisions/own_gauss_newton.md).
    poses, kept = gnc(problem, use, least_squares(problem, use, problem.start), screening.max_inlier_chi2)
    return _fit_nearby(problem, kept, poses)


def _pcm(problem: LoopProblem, screening: Screening) -> BackEndResult:
    """Pairwise consistent loops among the gated ones, and least squares on them (Mangelson et al., ICRA 2018)."""
    kept = np.zeros(len(problem.loops), dtype=bool)
    kept[pairwise_consistent(screening.likelihood, np.flatnonzero(screening.passed), screening.scale)] = True
    return _fit_from_odometry(problem, kept)


def _pcm_gnc(problem: LoopProblem, screening: Screening) -> BackEndResult:
    """Loops accepted by likelihood ratio and pairwise consistency, misfits removed by GNC, until none follows."""
    is_exact = screening.condensed.is_exact
    consensus = grow_consensus(screening, None if is_exact else problem.online)
    poses = screening.condensed.expand(consensus.poses)
    if is_exact:
        return _fit_nearby(problem, consensus.kept, poses)
    return _without_misfits(problem, screening.condensed, consensus, poses)


def _without_misfits(
    problem: LoopProblem, condensed: CondensedProblem, consensus: Consensus, poses: Array
) -> BackEndResult:
    """Least squares on the accepted loops of a long drive, from poses near the minimum, without misfits.

    Loops that were moved along odometry have larger covariances, in which an error may hide. Those that do not fit
    now leave, and come back if they fit the others.
    """
    whole = _fit_long(problem, condensed, consensus.kept, poses)
    suspects = whole.kept & outlying_loops(problem, consensus, whole.poses)
    if not suspects.any():
        return whole
    others = _fit_long(problem, condensed, whole.kept & ~suspects, whole.poses)
    back = suspects & fitting_loops(problem, consensus, others.poses)
    if (back == suspects).all():
        return whole
    return _fit_long(problem, condensed, others.kept | back, others.poses) if back.any() else others


def _on_condensed(run: "BackEnd") -> "BackEnd":
    """Back end that decides on the condensed problem of a long drive, and fits the whole one by those weights."""

    def run_condensed(problem: LoopProblem, screening: Screening) -> BackEndResult:
        condensed = screening.condensed
        if condensed.is_exact:
            return run(problem, screening)
        small = run(condensed.problem, screening)
        return _fit_long(problem, condensed, small.weights, condensed.expand(small.poses))

    return run_condensed


def _fit_long(
    problem: LoopProblem, condensed: CondensedProblem, loop_weights: Array | Mask, poses: Array
) -> BackEndResult:
    """Weighted least squares on a long drive from poses near the minimum."""
    weights = loop_weights.astype(np.float64)
    use = weights > 0.0
    if not use.any():
        return BackEndResult(problem.start, weights, ())
    factors = np.concatenate([np.ones(len(problem.trusted)), weights[use]])
    schedule = IrlsSchedule(max_steps=_MAX_LONG_STEPS, tolerance=_LONG_TOLERANCE)
    solve_normal = conjugate_gradients(condensed.place_modes(weights >= MIN_KEPT_WEIGHT, poses))
    fitted = irls(poses, problem.edges_with(use), lambda chi2, step: factors, schedule, solve_normal)
    return BackEndResult(fitted, weights, ())


# The problem and the screening of its loops -> poses and weights; `solve` adds the reasons.
BackEnd = Callable[[LoopProblem, Screening], BackEndResult]
BACK_ENDS: dict[str, BackEnd] = {
    "none": _on_condensed(_all_loops),
    "huber": _on_condensed(_with_kernel(huber)),
    "dcs": _on_condensed(_with_kernel(dcs)),
    "switchable": _on_condensed(_with_kernel(switchable)),
    "gnc": _on_condensed(_gnc),
    "pcm": _on_condensed(_pcm),
    "pcm+gnc": _pcm_gnc,
}


def back_end(name: str) -> BackEnd:
    """Back end of a name; ConfigError lists the names there are."""
    if name not in BACK_ENDS:
        raise ConfigError(f"unknown robust back end '{name}': expected one of {', '.join(BACK_ENDS)}")
    return BACK_ENDS[name]


def solve(problem: LoopProblem, name: str = DEFAULT) -> BackEndResult:
    """Solve a problem by the named back end: poses, and a weight and a reason for each loop.

    Raises:
        ConfigError: there is no back end of this name.
        GraphError: the trusted edges do not connect all poses, or an information matrix is not positive definite.
    """
    run = back_end(name)
    _check(problem)
    if not len(problem.loops):
        return _fit_from_odometry(problem, np.zeros(0, dtype=bool))
    screening = screen(problem)  # of `none` too: its reasons need the scale of covariances
    result = run(problem, screening)
    return replace(result, reasons=_reasons(problem, screening, result))


def _check(problem: LoopProblem) -> None:
    """GraphError, one line, for a problem that has no unique solution."""
    trusted, count = problem.trusted, len(problem.start)
    links = sparse.coo_array((np.ones(len(trusted)), (trusted.first, trusted.second)), shape=(count, count))
    part = connected_components(links, directed=False)[1]
    connected = int((part == part[0]).sum())
    if connected < count:
        raise GraphError(
            f"expected trusted edges that connect all poses, but only {connected} poses of {count} are connected to "
            "the first; add the missing edge, or split the graph"
        )
    try:
        _ = trusted.sqrt_information, problem.loops.sqrt_information
    except np.linalg.LinAlgError as error:
        raise GraphError("expected positive definite information in every edge; correct that edge") from error


def _fit_from_odometry(problem: LoopProblem, kept: Mask) -> BackEndResult:
    """Least squares on the kept loops from the better of two starts; without any loop, where the trusted edges lead."""
    poses = optimize(problem.edges_with(kept), problem.start) if kept.any() else problem.start
    return BackEndResult(poses, kept.astype(np.float64), ())


def _fit_nearby(problem: LoopProblem, kept: Mask, poses: Array) -> BackEndResult:
    """Least squares on the kept loops from poses near the minimum; without any loop, where the trusted edges lead."""
    poses = refine(problem.edges_with(kept), poses) if kept.any() else problem.start
    return BackEndResult(poses, kept.astype(np.float64), ())


def _reasons(problem: LoopProblem, screening: Screening, result: BackEndResult) -> tuple[str, ...]:
    """(L,) why each loop was kept or left out, a sentence each."""
    # Residuals on the calibrated scale: stated covariances may be wrong by any factor.
    after = np.sqrt(problem.loops.chi2(result.poses) / screening.scale)
    before = np.sqrt(screening.likelihood.chi2 / screening.scale)
    log_ratio = screening.likelihood.log_ratio_at(screening.scale)
    return tuple(map(_reason, result.weights, after, before, log_ratio))


def _reason(weight: float, after: float, before: float, log_ratio: float) -> str:
    if weight >= MIN_KEPT_WEIGHT:
        return f"kept with weight {weight:.2f}: {after:.1f} sigma from the optimised map"
    if log_ratio < MIN_LOG_RATIO:
        return f"left out: {before:.1f} sigma from odometry, likelier a false loop than its drift"
    return f"left out: {after:.1f} sigma from the map that the kept loops agree on"
