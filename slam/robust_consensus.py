"""Let loops in by the evidence for them, the surest first, each judged anew by what is already in."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slam.robust_chance import SECOND_RATE, expected, lucky
from slam.robust_contest import opponents
from slam.robust_evidence import LEAST_EVIDENCE, Evidence, evidence, freedom_of, limit
from slam.robust_gnc import fitted_poses, graduated
from slam.robust_pcm import SEEDS, agreeing, fitting, in_company, outvoted
from slam.robust_problem import LoopProblem
from slam.robust_screening import Screening

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Counts = NDArray[np.int64]

_ROUNDS = 50
_FEW = 0.1  # of the kept loops: so few more are no reason to wait with those less sure
_STILL = 0.002  # of the kept loops: so few that move are no reason to go on
_MANY = 100  # loops, of which one in a hundred can be told
_FITS = 4
_SCALE_STEPS = 10
_MOST_BENT = 30.0  # chi-square of odometry over that of the loops that bend it; more is a sign of false loops
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
        thrown: (L,) times that each loop was let in and did not fit, or was luck.
        doubts: (L,) times that each loop was put aside because the others spoke against it.
    """

    poses: Array
    kept: Mask
    found: Evidence
    scale: float
    fitted: float
    thrown: Counts
    doubts: Counts

    @property
    def predicting(self) -> float:
        """Scale for predictions: the fit corrects the first guess as loops come in, and is never undercut."""
        share = self.kept.sum() / (_PRIOR_LINKS + self.kept.sum())
        return float(max(self.fitted, self.fitted**share * self.scale ** (1.0 - share)))


def grown(problem: LoopProblem, screening: Screening) -> Consensus:
    """Grow the set of loops that agree with the trusted edges and with one another."""
    state = _converged(problem, _empty(problem, screening), screening)
    challenged = _challenged(problem, state, screening)
    if challenged.any():
        state = _converged(problem, _changed(problem, state, screening, state.kept & ~challenged), screening)
    for _ in range(_CHANCES):
        lucky = _by_luck(problem, state, screening)
        if not lucky.any():
            break
        state = _changed(problem, state, screening, state.kept & ~lucky)
        state = replace(state, thrown=np.where(lucky, _CHANCES, state.thrown))
        state = _converged(problem, state, screening)
    return state


def _empty(problem: LoopProblem, screening: Screening) -> Consensus:
    count = len(problem.loops)
    none, never = np.zeros(count, dtype=bool), np.zeros(count, dtype=np.int64)
    return Consensus(problem.start, none, screening.found, screening.scale, screening.scale, never, never)


def _converged(problem: LoopProblem, state: Consensus, screening: Screening) -> Consensus:
    """Let loops in and put doubted ones aside until hardly any is left to move."""
    for left in reversed(range(_ROUNDS)):
        offered = _offered(state)
        doubted = _doubted(state, state.doubts < _CHANCES) if left else np.zeros_like(state.kept)
        moving = int((offered | doubted).sum())
        if moving:
            state = replace(state, doubts=state.doubts + doubted)
            state = _changed(problem, state, screening, (state.kept & ~doubted) | offered)
        if moving <= _STILL * state.kept.sum() and not doubted.any():
            break
    return state


def _changed(problem: LoopProblem, state: Consensus, screening: Screening, use: Mask) -> Consensus:
    """Lean on other loops; those that do not fit are out again."""
    after = _settled(problem, state, use)
    after = replace(after, thrown=state.thrown + (use & ~after.kept))
    if not after.kept.any():
        return replace(_empty(problem, screening), thrown=after.thrown, doubts=after.doubts)
    found = evidence(after.poses, problem.using(after.kept), problem.loops)
    chi2 = found.chi2_without_itself[after.kept]
    rare = float(np.quantile(chi2, 0.99)) / after.fitted if len(chi2) >= _MANY else 0.0
    return replace(after, found=replace(found, freedom=freedom_of(chi2, found.dof), rare=rare))


def _by_luck(problem: LoopProblem, state: Consensus, screening: Screening) -> Mask:
    """Kept loops that may be in by luck, by all that speaks for them: odometry, others, the map without them."""
    kept, scale = state.kept, state.predicting
    chance = expected(screening.found.at(screening.scale), kept)
    by_others = expected(np.where(kept, state.found.without_itself(scale), state.found.at(scale)), kept)
    chance = np.where(kept & state.found.supported, np.minimum(chance, by_others), chance)
    luck = lucky(kept, chance)
    if not luck.any():
        return luck
    without = _changed(problem, state, screening, kept & ~luck)
    left = expected(without.found.at(without.predicting), kept)
    return lucky(kept, np.where(luck, np.minimum(chance, left), chance), SECOND_RATE)


def _offered(state: Consensus) -> Mask:
    """Loops that are next, of one mind: loops left out next to them do not speak against them."""
    offered, scale = state.thrown < _CHANCES, state.predicting
    offered &= ~state.kept
    able = np.flatnonzero(offered & (state.found.at(scale) > -LEAST_EVIDENCE))
    offered[outvoted(state.found, able, scale)] = False
    rows = np.flatnonzero(_surest(state, offered))
    if not len(rows):
        rows = _in_company(state, np.flatnonzero(offered & fitting(state.found, scale)))
    offered[:] = False
    offered[agreeing(state.found, rows, scale)] = True
    return offered


def _surest(state: Consensus, able: Mask) -> Mask:
    """Loops whose evidence outweighs the odds, else all that have some."""
    nats = state.found.at(state.predicting)
    count = max(int(state.kept.sum()), 1)
    odds = float(np.log(max(len(nats) - count, 1) / count))  # of false to true loops, as far as is known
    many = float(np.log(max(len(nats), 1)))
    for extra in (max(odds, 0.0) + many, max(odds, 0.0) + 0.5 * many, odds):
        surest: Mask = able & (nats > LEAST_EVIDENCE + extra)
        if surest.sum() > _FEW * state.kept.sum():
            return surest
    return able & (nats > LEAST_EVIDENCE + min(odds, 0.0)) if not surest.any() else surest


def _in_company(state: Consensus, able: NDArray[np.int64]) -> NDArray[np.int64]:
    """Loops of which each by itself could be luck, but not the best of all pairs."""
    nats = state.found.at(state.predicting)[able]
    pairs = 2.0 * np.log(max(len(able), 1)) - np.log(2.0)
    able = able[np.argsort(-nats, kind="stable")[:SEEDS]]
    return able[in_company(state.found, able, state.predicting) > LEAST_EVIDENCE + pairs]


def _doubted(state: Consensus, allowed: Mask) -> Mask:
    """Kept loops that the others speak against, the worst: without them others may look better."""
    nats = state.found.without_itself(state.predicting)
    against = allowed & state.kept & (nats < LEAST_EVIDENCE)
    return against & (nats <= 0.5 * (nats[against].min(initial=LEAST_EVIDENCE) + LEAST_EVIDENCE))


def _challenged(problem: LoopProblem, state: Consensus, screening: Screening) -> Mask:
    """Kept loops that shut out others for which odometry alone speaks: put aside, they must compete with them."""
    nats = np.where(state.kept, -np.inf, screening.found.at(screening.scale))
    contenders = np.argsort(-nats, kind="stable")[: int((nats > LEAST_EVIDENCE).sum())]
    if not len(contenders) or not state.kept.any():
        return np.zeros_like(state.kept)
    return opponents(problem, state.poses, state.kept, contenders, limit(state.found.dof) * state.fitted)


def _settled(problem: LoopProblem, state: Consensus, use: Mask) -> Consensus:
    """Fit to the loops in use, throw out what does not fit, and learn the scale of what does."""
    poses, kept = fitted_poses(problem, use, state.poses), use
    for _ in range(_FITS):
        fitted = _fitted(problem, state, poses, kept)
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


def _fitted(problem: LoopProblem, state: Consensus, poses: Array, kept: Mask) -> float:
    """Variance factor of the fit, drawn to a first guess while loops are few.

    Chi-square over redundancy, where loops in the tail count less (Student's distribution; Lange et al., 1989).
    """
    first, freedom = state.scale, state.found.freedom
    chi2, dof = problem.loops.chi2(poses)[kept], problem.loops.group.dof
    if not len(chi2):
        return first
    factor = max(float(np.median(chi2)) / dof, 1e-9 * first)
    trusted = float(problem.trusted.chi2(poses).sum())
    for _ in range(_SCALE_STEPS):
        loops = float(((freedom + dof) / (freedom + chi2 / factor) * chi2).sum())
        factor = max((loops + min(trusted, _MOST_BENT * loops)) / (dof * len(chi2)), 1e-9 * first)
    share = len(chi2) / (_PRIOR_LOOPS + len(chi2))
    return float(factor**share * first ** (1.0 - share))
