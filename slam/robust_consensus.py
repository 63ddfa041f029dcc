"""Let loops in by the evidence for them, the surest first, each judged anew by what is already in."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slam.robust_chance import SECOND_RATE, chances, expected, lucky
from slam.robust_evidence import FREEDOM, LEAST_EVIDENCE, Evidence, evidence, limit
from slam.robust_gnc import fitted_poses, graduated
from slam.robust_pcm import agreeing
from slam.robust_problem import LoopProblem
from slam.robust_screening import Screening

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ROUNDS = 50
_FEW = 0.03  # of the kept loops: so few more are no reason to wait with those less sure
_FITS = 4
_SCALE_STEPS = 10
_MOST_BENT = 30.0  # chi-square of odometry over that of the loops that bend it; more is a sign of false loops
_ALONE = 0.35  # share of what is known about a loop that the loop itself said; of samples, which say less
_CHANCES = 2  # times that a loop may be let in and thrown out
_PRIOR_LINKS = 50.0  # weight of the first scale in predictions: odometry's drift persists where a fit hides it
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

    @property
    def predicting(self) -> float:
        """Scale for predictions: the fit corrects the first guess as loops come in, and is never undercut."""
        share = self.kept.sum() / (_PRIOR_LINKS + self.kept.sum())
        return float(max(self.fitted, self.fitted**share * self.scale ** (1.0 - share)))


def grown(problem: LoopProblem, screening: Screening) -> Consensus:
    """Grow the set of loops that agree with the trusted edges and with one another."""
    none = np.zeros(len(problem.loops), dtype=bool)
    state = Consensus(problem.start, none, screening.found, screening.scale, screening.scale)
    thrown, doubts, challenged = np.zeros(len(none), dtype=int), np.zeros(len(none), dtype=int), False
    for left in reversed(range(_ROUNDS)):
        offered = _agreeing(problem, state, _offered(state, thrown < _CHANCES))
        doubted = _doubted(state, doubts < _CHANCES) if left >= _CHANCES else none  # the last word is theirs
        if not (offered | doubted).any():
            if challenged:
                break
            challenged, doubted = True, _challenged(state, screening)
            if not doubted.any():
                break
        use = (state.kept & ~doubted) | offered
        after = _settled(problem, state, use)
        thrown += use & ~after.kept
        doubts += doubted
        if after.kept.any():
            after = replace(after, found=evidence(after.poses, problem.using(after.kept), problem.loops))
        else:
            after = Consensus(problem.start, none, screening.found, screening.scale, screening.scale)
        state = after
    return _beyond_chance(problem, state, screening)


def _beyond_chance(problem: LoopProblem, state: Consensus, screening: Screening) -> Consensus:
    """Leave out the loops that may be in by luck, once the map without them speaks for them no better."""
    kept, chance = state.kept, chances(state.kept, screening.found, state.found)
    luck = lucky(kept, chance)
    if not luck.any():
        return state
    without = _settled(problem, state, kept & ~luck)
    found = evidence(without.poses, problem.using(without.kept), problem.loops)
    chance[luck] = np.minimum(chance, expected(found.chi2, found.chi2[~kept], found.dof))[luck]
    return _settled(problem, state, kept & ~lucky(kept, chance, SECOND_RATE))


def _offered(state: Consensus, allowed: Mask) -> Mask:
    """Loops that are next: those whose evidence outweighs the odds, else all that have some."""
    nats = state.found.at(state.predicting)
    count = max(int(state.kept.sum()), 1)
    odds = float(np.log(max(len(nats) - count, 1) / count))  # of false to true loops, as far as is known
    able, many = allowed & ~state.kept, float(np.log(max(len(nats), 1)))
    for extra in (max(odds, 0.0) + many, max(odds, 0.0) + 0.5 * many, odds):
        offered: Mask = able & (nats > LEAST_EVIDENCE + extra)
        if offered.sum() > _FEW * state.kept.sum():
            return offered
    return able & (nats > LEAST_EVIDENCE + min(odds, 0.0)) if not offered.any() else offered


def _doubted(state: Consensus, allowed: Mask) -> Mask:
    """Kept loops that the others speak against, the worst: without them others may look better."""
    nats = state.found.without_itself(state.predicting)
    against = allowed & state.kept & (nats < LEAST_EVIDENCE)
    return against & (nats <= 0.5 * (nats[against].min(initial=LEAST_EVIDENCE) + LEAST_EVIDENCE))


def _challenged(state: Consensus, screening: Screening) -> Mask:
    """Kept loops that rest on themselves alone, where loops were left out that odometry does not speak against.

    One false loop that holds a stretch of the way by itself shuts out every true one there. Put aside for a
    round, it must compete with them.
    """
    contenders = ~state.kept & screening.passed
    return state.kept & (state.found.reliance > _ALONE) if contenders.any() else np.zeros_like(contenders)


def _agreeing(problem: LoopProblem, state: Consensus, offered: Mask) -> Mask:
    """Those of the offered loops that agree with one another."""
    rows, scale = np.flatnonzero(offered), state.predicting
    if len(rows) > 1:
        nats = np.maximum(state.found.at(scale)[rows], 1e-3)
        good = agreeing(state.found.posterior, problem.loops[rows], nats, scale)
        offered = offered.copy()
        offered[rows[~good]] = False
    return offered


def _settled(problem: LoopProblem, state: Consensus, use: Mask) -> Consensus:
    """Fit to the loops in use, throw out what does not fit, and learn the scale of what does."""
    poses, kept = fitted_poses(problem, use, state.poses), use
    for _ in range(_FITS):
        fitted = _fitted(problem, poses, kept, state.scale)
        fits = kept & _fits(problem, poses, state.found, fitted)
        if np.array_equal(fits, kept):
            break
        # What is wrong bends the rest: who fits is asked again once the large errors have lost their weight.
        poses, _ = graduated(problem, kept, poses, limit(state.found.dof) * fitted)
        kept = kept & _fits(problem, poses, state.found, fitted)
        poses = fitted_poses(problem, kept, poses)
    return replace(state, poses=poses, kept=kept, fitted=fitted)


def _fits(problem: LoopProblem, poses: Array, found: Evidence, scale: float) -> Mask:
    """(L,) loops for which there is evidence where the fit is taken for the truth."""
    at_fit = replace(found, errors=problem.loops.errors(poses))
    return at_fit.alone(scale) > LEAST_EVIDENCE


def _fitted(problem: LoopProblem, poses: Array, kept: Mask, first: float) -> float:
    """Variance factor of the fit, drawn to a first guess while loops are few.

    Chi-square over redundancy, where loops in the tail count less (Student's distribution; Lange et al., 1989).
    """
    chi2, dof = problem.loops.chi2(poses)[kept], problem.loops.group.dof
    if not len(chi2):
        return first
    factor = max(float(np.median(chi2)) / dof, 1e-9 * first)
    trusted = float(problem.trusted.chi2(poses).sum())
    for _ in range(_SCALE_STEPS):
        loops = float(((FREEDOM + dof) / (FREEDOM + chi2 / factor) * chi2).sum())
        factor = max((loops + min(trusted, _MOST_BENT * loops)) / (dof * len(chi2)), 1e-9 * first)
    share = len(chi2) / (_PRIOR_LOOPS + len(chi2))
    return float(factor**share * first ** (1.0 - share))
