"""Robust back ends by name: which loops the final map leans on, and why the others were left out.

A back end is a function of a `LoopProblem` and of the screening of its loops; adding one is one function and
one line in `BACK_ENDS`. All but `none` start from loops that passed a gate on each alone. Chi-square is the
squared Mahalanobis length of an error.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slam.errors import ConfigError
from slam.pose_graph_batch import minimum, refined
from slam.robust_consensus import grown
from slam.robust_evidence import LEAST_EVIDENCE
from slam.robust_gnc import fitted_poses, graduated
from slam.robust_kernels import Kernel, dcs, huber, kernel_poses, switchable
from slam.robust_pcm import agreeing
from slam.robust_problem import LoopProblem, Outcome
from slam.robust_screening import Screening, screened

__all__ = ["BACK_ENDS", "DEFAULT", "LoopGate", "LoopProblem", "Optimized", "Outcome", "back_end", "solved"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

DEFAULT = "pcm+gnc"


@dataclass(frozen=True)
class LoopGate:
    """The verdict on a loop by itself, before any optimisation.

    Attributes:
        passed: the loop is possible after the drift that odometry may have had.
        residual: square root of its chi-square against odometry.
        reason: the verdict in plain words.
    """

    passed: bool
    residual: float
    reason: str


@dataclass(frozen=True)
class Optimized:
    """The corrected trajectory and what became of each loop, in the order in which they were added.

    Attributes:
        poses: (N, n, n), T_world_camera in space, metres.
        weights: (L,) the back end's trust, 0 to 1.
        residuals: (L,) square root of chi-square at `poses`.
        kept: (L,) bool, the loops that the poses lean on.
        reasons: (L,) the verdicts in plain words.
        error_initial, error_final: half chi-square of chain and kept loops, at odometry and at `poses`.
        seconds: wall clock of the optimisation.
        units: (N,) length of each frame's own unit, in that of `poses`; None where there is but one.
    """

    poses: Array
    weights: Array
    residuals: Array
    kept: Mask
    reasons: tuple[str, ...]
    error_initial: float
    error_final: float
    seconds: float
    units: Array | None = None

    @property
    def lengths(self) -> Array:
        """(N,) length of each frame's unit in that of `poses`."""
        return np.ones(len(self.poses)) if self.units is None else self.units

    @property
    def similarities(self) -> Array:
        """(N, 4, 4) what takes points from a camera, in its own unit, to the world: scale, rotation, translation."""
        out = self.poses.copy()
        out[:, :3, :3] *= self.lengths[:, None, None]
        return out


def _plain(problem: LoopProblem, screening: Screening) -> Outcome:
    """Least squares on every loop, true or false: the yardstick."""
    return _from_odometry(problem, np.ones(len(problem.loops), dtype=bool))


def _under(kernel: Kernel) -> "BackEnd":
    """Back end of a robust kernel on the gated loops."""

    def judge(problem: LoopProblem, screening: Screening) -> Outcome:
        return Outcome(*kernel_poses(problem, screening, kernel), reasons=())

    return judge


def _gnc(problem: LoopProblem, screening: Screening) -> Outcome:
    """Graduated non-convexity on the gated loops, odometry known to be right (Yang et al., RA-L 2020)."""
    use = screening.passed
    if not use.any():
        return _from_odometry(problem, use)
    poses, kept = graduated(problem, use, fitted_poses(problem, use, problem.start), screening.limit)
    return _leaning_on(problem, kept, poses)


def _pcm(problem: LoopProblem, screening: Screening) -> Outcome:
    """Pairwise consistent loops among the gated ones, and least squares on them (Mangelson et al., ICRA 2018)."""
    kept = np.zeros(len(problem.loops), dtype=bool)
    kept[agreeing(screening.found, np.flatnonzero(screening.passed), screening.scale)] = True
    return _from_odometry(problem, kept)


def _pcm_gnc(problem: LoopProblem, screening: Screening) -> Outcome:
    """Loops let in by evidence, consistent in pairs, cleaned by graduated non-convexity, until none follows."""
    found = grown(screening.small.problem, screening)
    return _leaning_on(problem, found.kept, screening.small.expanded(found.poses))


BackEnd = Callable[[LoopProblem, Screening], Outcome]
BACK_ENDS: dict[str, BackEnd] = {
    "none": _plain,
    "huber": _under(huber),
    "dcs": _under(dcs),
    "switchable": _under(switchable),
    "gnc": _gnc,
    "pcm": _pcm,
    "pcm+gnc": _pcm_gnc,
}


def back_end(name: str) -> BackEnd:
    """Look up a back end; ConfigError names the known ones."""
    if name not in BACK_ENDS:
        raise ConfigError(f"unknown robust back end '{name}': expected one of {', '.join(BACK_ENDS)}")
    return BACK_ENDS[name]


def solved(problem: LoopProblem, name: str = DEFAULT) -> Outcome:
    """Poses, weights and reasons by the named back end.

    Raises:
        ConfigError: the name is not known.
        GraphError: the trusted edges do not hold all poses together.
    """
    judge = back_end(name)
    if not len(problem.loops):
        return _from_odometry(problem, np.zeros(0, dtype=bool))
    screening = screened(problem)
    outcome = judge(problem, screening)
    return replace(outcome, reasons=_reasons(problem, screening, outcome))


def _from_odometry(problem: LoopProblem, kept: Mask) -> Outcome:
    """Least squares on the kept loops from the better of two starts."""
    poses = minimum(problem.using(kept), problem.start) if kept.any() else problem.start
    return Outcome(poses, kept.astype(np.float64), ())


def _leaning_on(problem: LoopProblem, kept: Mask, poses: Array) -> Outcome:
    """Least squares on the kept loops from poses near it; without any loop, where the trusted edges lead."""
    poses = refined(problem.using(kept), poses) if kept.any() else problem.start
    return Outcome(poses, kept.astype(np.float64), ())


def _reasons(problem: LoopProblem, screening: Screening, outcome: Outcome) -> tuple[str, ...]:
    """Say in plain words why each loop was kept or left out."""
    after = np.sqrt(problem.loops.chi2(outcome.poses) / screening.scale)
    before = np.sqrt(screening.found.chi2 / screening.scale)
    nats = screening.found.at(screening.scale)
    return tuple(map(_reason, outcome.weights, after, before, nats))


def _reason(weight: float, after: float, before: float, nats: float) -> str:
    if weight >= 0.5:
        return f"kept with weight {weight:.2f}: {after:.1f} sigma from the optimised map"
    if nats < LEAST_EVIDENCE:
        return f"left out: {before:.1f} sigma from odometry, likelier a false loop than its drift"
    return f"left out: {after:.1f} sigma from the map that the kept loops agree on"
