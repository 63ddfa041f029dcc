"""Let loops in by the evidence for them, the surest first, each judged anew by what is already in."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slam.robust_evidence import LEAST_EVIDENCE, Evidence, calibrated, evidence, limit, roughness
from slam.robust_gnc import graduated
from slam.robust_problem import LoopProblem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ROUNDS = 15
_SURE = 3.0  # nats beyond the logarithm of the number of loops: one in twenty graphs lets a false one in
_STRIDE = 2.0  # nats below the strongest that are let in together where nothing is sure
_CHANCES = 2  # times that a loop may be let in and thrown out
_PRIOR_LOOPS = 10.0  # weight of the first scale against that of the kept loops


@dataclass(frozen=True)
class Consensus:
    """Where the rounds stand.

    Attributes:
        poses: (N, n, n).
        kept: (L,) loops that are in.
        found: evidence for each loop by all the others.
        scale: of covariances, for predictions.
        fitted: the same, for what is left after the fit.
    """

    poses: Array
    kept: Mask
    found: Evidence
    scale: float
    fitted: float


def grown(problem: LoopProblem, trace=None) -> Consensus:
    """Grow the set of loops that agree with the trusted edges and with one another."""
    none = np.zeros(len(problem.loops), dtype=bool)
    found = evidence(problem.start, problem.trusted, problem.loops)
    scale = calibrated(found, roughness(problem.trusted))
    state = Consensus(problem.start, none, found, scale, scale)
    thrown = np.zeros(len(none), dtype=int)
    for _ in range(_ROUNDS):
        offered = _offered(state) & (thrown < _CHANCES)
        if trace: trace('scale',state.scale,'fitted',state.fitted,'kept',trace.t(state.kept),'offered',trace.t(offered))
        if not offered.any():
            break
        after = _settled(problem, state, state.kept | offered)
        thrown += (state.kept | offered) & ~after.kept
        if after.kept.any():
            after = replace(after, found=evidence(after.poses, problem.using(after.kept), problem.loops))
        else:
            after = replace(state, kept=none, poses=problem.start)
        state = after
    return state


def _offered(state: Consensus) -> Mask:
    """Loops that are next: those whose evidence is beyond doubt, else the strongest ones."""
    nats = state.found.at(state.scale)
    able = ~state.kept & (state.found.chi2 <= limit(state.found.dof) * state.scale) & (nats > LEAST_EVIDENCE)
    if not able.any():
        return able
    sure = np.log(len(nats)) + _SURE
    return able & (nats > min(sure, float(nats[able].max()) - _STRIDE))


def _settled(problem: LoopProblem, state: Consensus, use: Mask) -> Consensus:
    """Fit to the loops in use, throw out what does not fit, and learn the scale of what does."""
    poses, kept, fitted = state.poses, use, state.fitted
    for _ in range(4):
        poses, kept = graduated(problem, kept, poses, limit(state.found.dof) * fitted)
        before, fitted = fitted, _fitted(problem, poses, kept, state.scale)
        out = kept & (problem.loops.chi2(poses) > limit(state.found.dof) * fitted)
        if not out.any() or not kept.any():
            break
        kept = kept & ~out
    return replace(state, poses=poses, kept=kept, fitted=fitted)


def _fitted(problem: LoopProblem, poses: Array, kept: Mask, first: float) -> float:
    """Variance factor of the fit (chi-square over redundancy), drawn to a first guess while loops are few."""
    count = int(kept.sum())
    if not count:
        return first
    left = problem.loops.chi2(poses)[kept].sum() + problem.trusted.chi2(poses).sum()
    factor = max(float(left) / (problem.loops.group.dof * count), 1e-9 * first)
    return float(np.exp((_PRIOR_LOOPS * np.log(first) + count * np.log(factor)) / (_PRIOR_LOOPS + count)))
