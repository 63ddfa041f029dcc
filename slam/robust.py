"""Robust back ends by name: which loops the final map leans on, and why the others were left out.

A back end is a function of a `LoopProblem`, which hides the optimiser; adding one is one function and one
line in `BACK_ENDS`. Chi-square is the squared Mahalanobis length of a loop's six errors.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from slam.errors import ConfigError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

DEFAULT = "gnc"
_REPAIRS = 4  # rounds of dropping and taking back loops; measured: none changes after two


@dataclass(frozen=True)
class Limits:
    """Chi-squares (6 degrees of freedom) that separate true loops from false ones."""

    gate: float  # against odometry and its drift budget
    inlier: float  # against the optimised map, where only the loop's own error should be left


class LoopProblem(Protocol):
    """A chain of odometry and L loops, and the ways to optimise them. The first pose stays where it is."""

    @property
    def odometry(self) -> Array:
        """T_world_camera (N, 4, 4) of the chain alone."""
        ...

    @property
    def gate(self) -> Array:
        """(L,) chi-square of each loop against the chain."""
        ...

    def least_squares(self, use: Mask, start: Array) -> Array:
        """Poses (N, 4, 4) that fit chain and loops in use (L,), found from start; `odometry` if none is."""
        ...

    def kernel(self, name: str, width: float, start: Array, use: Mask) -> Array:
        """Solve under a robust kernel: `huber` (width in sigmas) or `dcs` (width a chi-square)."""
        ...

    def graduated(self, limit: float, use: Mask) -> Array:
        """Weights (L,) of graduated non-convexity with squares truncated at a chi-square; 0 if not in use.

        It starts from least squares on the loops in use.
        """
        ...

    def chi2(self, poses: Array) -> Array:
        """(L,) chi-square of each loop at poses (N, 4, 4)."""
        ...


@dataclass(frozen=True)
class Outcome:
    """What a back end decided.

    Attributes:
        poses: T_world_camera (N, 4, 4), metres.
        weights: (L,) trust in each loop, 0 to 1; a loop is kept from one half upwards.
    """

    poses: Array
    weights: Array


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
        poses: T_world_camera (N, 4, 4), metres.
        weights: (L,) the back end's trust, 0 to 1.
        residuals: (L,) square root of chi-square at `poses`.
        kept: (L,) bool, the loops that the poses lean on.
        reasons: (L,) the verdicts in plain words.
        error_initial, error_final: half chi-square of chain and kept loops, at odometry and at `poses`.
        seconds: wall clock of the optimisation.
    """

    poses: Array
    weights: Array
    residuals: Array
    kept: Mask
    reasons: tuple[str, ...]
    error_initial: float
    error_final: float
    seconds: float


def plain(problem: LoopProblem, limits: Limits) -> Outcome:
    """Least squares on every loop, true or false: the yardstick."""
    use = np.ones(len(problem.gate), dtype=bool)
    return _solved(problem, use, problem.odometry)


def huber(problem: LoopProblem, limits: Limits) -> Outcome:
    """Huber's kernel on the gated loops: large errors pull with constant force (Huber 1964)."""
    width = float(np.sqrt(limits.inlier))
    use = problem.gate <= limits.gate
    poses = problem.kernel("huber", width, problem.odometry, use)
    residuals = np.sqrt(problem.chi2(poses))
    return Outcome(poses, np.where(use, width / np.maximum(residuals, width), 0.0))


def dcs(problem: LoopProblem, limits: Limits) -> Outcome:
    """Dynamic covariance scaling on the gated loops (Agarwal et al., ICRA 2013, equation 15).

    Started from the Huber solution: from odometry its kernel is saturated and lets go of every loop.
    """
    use = problem.gate <= limits.gate
    poses = problem.kernel("dcs", limits.inlier, huber(problem, limits).poses, use)
    scale = np.minimum(1.0, 2.0 * limits.inlier / (limits.inlier + problem.chi2(poses)))
    return Outcome(poses, np.where(use, scale**2, 0.0))


def gnc(problem: LoopProblem, limits: Limits) -> Outcome:
    """Graduated non-convexity on the gated loops (Yang et al., RA-L 2020), odometry known to be right.

    Started from least squares on the gated loops, because the schedule follows from the largest initial
    residual and a real drive's drift would make it reject everything. Its verdict is then repaired against
    the poses that it leads to, and those are always solved anew on the kept loops alone.
    """
    use = problem.gate <= limits.gate
    if not use.any():
        return _solved(problem, use, problem.odometry)
    kept = problem.graduated(limits.inlier, use) >= 0.5
    return repaired(problem, kept, limits)


BackEnd = Callable[[LoopProblem, Limits], Outcome]
BACK_ENDS: dict[str, BackEnd] = {"none": plain, "huber": huber, "dcs": dcs, "gnc": gnc}


def back_end(name: str) -> BackEnd:
    """Look up a back end; ConfigError names the known ones."""
    if name not in BACK_ENDS:
        raise ConfigError(f"unknown robust back end '{name}': expected one of {', '.join(BACK_ENDS)}")
    return BACK_ENDS[name]


def repaired(problem: LoopProblem, kept: Mask, limits: Limits) -> Outcome:
    """Solve on the kept loops, drop those that disagree, take back those that agree, until it settles."""
    outcome = _solved(problem, kept, problem.odometry)
    for _ in range(_REPAIRS):
        agree = problem.chi2(outcome.poses) <= limits.inlier
        # Without a kept loop the map is odometry alone, and the gate has already been asked about that.
        if not kept.any() or np.array_equal(agree, kept):
            break
        kept = agree
        outcome = _solved(problem, kept, outcome.poses)
    return outcome


def _solved(problem: LoopProblem, kept: Mask, start: Array) -> Outcome:
    """Least squares on the kept loops."""
    return Outcome(problem.least_squares(kept, start), kept.astype(np.float64))


def reasons(problem: LoopProblem, outcome: Outcome, limits: Limits) -> tuple[str, ...]:
    """Say in plain words why each loop was kept or left out."""
    chi2 = problem.chi2(outcome.poses)
    return tuple(
        _reason(weight, float(np.sqrt(after)), float(np.sqrt(before)), limits)
        for weight, after, before in zip(outcome.weights, chi2, problem.gate, strict=True)
    )


def _reason(weight: float, residual: float, gate_residual: float, limits: Limits) -> str:
    if weight >= 0.5:
        return f"kept with weight {weight:.2f}: {residual:.1f} sigma from the optimised map"
    if gate_residual > np.sqrt(limits.gate):
        limit = np.sqrt(limits.gate)
        return f"left out: {gate_residual:.1f} sigma from odometry, more than drift explains ({limit:.1f})"
    return f"left out: {residual:.1f} sigma from the optimised map (limit {np.sqrt(limits.inlier):.1f})"
