"""Graduated non-convexity with truncated squares, one Gauss-Newton step to a weight (Yang et al., RA-L 2020)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.pose_graph_newton import Schedule, reweighted
from slam.robust_problem import LoopProblem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_PLAIN_STEPS = 4  # of least squares before weights change: the schedule follows from their residuals
_HARDENING = 4.0  # factor on mu a step
_STEPS = 30


@dataclass
class _Weigher:
    """Weights of the loops, harder with every step once the largest residual is known."""

    trusted: int
    limit: float
    mu: float = 0.0

    def __call__(self, chi2: Array, step: int) -> Array:
        weights = np.ones(len(chi2))
        loops = chi2[self.trusted :]
        if step >= _PLAIN_STEPS and len(loops):
            worst = float(loops.max())
            if self.mu == 0.0:
                self.mu = self.limit / max(2.0 * worst - self.limit, self.limit)
            weights[self.trusted :] = truncated(loops, self.limit, self.mu)
            self.mu *= _HARDENING
        return weights


def truncated(chi2: Array, limit: float, mu: float) -> Array:
    """Weights of truncated least squares at a stage mu of its graduation (Yang et al., equation 14)."""
    low, high = mu / (mu + 1.0) * limit, (mu + 1.0) / mu * limit
    middle = np.sqrt(limit * mu * (mu + 1.0) / np.maximum(chi2, low)) - mu
    return np.where(chi2 <= low, 1.0, np.where(chi2 >= high, 0.0, middle))


def graduated(problem: LoopProblem, use: Mask, poses: Array, limit: float) -> tuple[Array, Mask]:
    """Poses (N, n, n) and the loops (L,) among those in use whose chi-square stays within a limit."""
    edges = problem.using(use)
    weigher = _Weigher(len(problem.trusted), limit)
    poses = reweighted(poses, edges, weigher, Schedule(steps=_PLAIN_STEPS))
    if (problem.loops.chi2(poses)[use] > limit).any():
        shifted = lambda chi2, step: weigher(chi2, step + _PLAIN_STEPS)  # noqa: E731
        needed = int(np.ceil(np.log(1e6) / np.log(_HARDENING)))
        poses = reweighted(poses, edges, shifted, Schedule(steps=_STEPS, least=needed))
    return poses, use & (problem.loops.chi2(poses) <= limit)
