"""Graduated non-convexity with truncated squares, one Gauss-Newton step to a weight (Yang et al., RA-L 2020)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.pose_graph_newton import Schedule, reweighted
from slam.robust_problem import LoopProblem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_HARDENING = 4.0  # factor on mu a step
_HARD = 30.0  # mu at which weights are as good as binary
_STEPS = 40


@dataclass(frozen=True)
class _Weigher:
    """Weights of trusted edges, always one, and of loops, harder with every step.

    Attributes:
        trusted: how many edges are trusted.
        limit: chi-square of an inlier.
        worst: largest chi-square at the start, from which the schedule follows.
    """

    trusted: int
    limit: float
    worst: float

    @property
    def stages(self) -> int:
        """Steps until the weights are as good as binary."""
        return int(np.ceil(np.log(_HARD / self._mu(0)) / np.log(_HARDENING)))

    def __call__(self, chi2: Array, step: int) -> Array:
        weights = np.ones(len(chi2))
        weights[self.trusted :] = truncated(chi2[self.trusted :], self.limit, self._mu(step))
        return weights

    def _mu(self, step: int) -> float:
        first = self.limit / max(2.0 * self.worst - self.limit, self.limit)
        return float(first * _HARDENING ** min(step, 60))


def truncated(chi2: Array, limit: float, mu: float) -> Array:
    """Weights of truncated least squares at a stage mu of its graduation (Yang et al., equation 14)."""
    low, high = mu / (mu + 1.0) * limit, (mu + 1.0) / mu * limit
    middle = np.sqrt(limit * mu * (mu + 1.0) / np.maximum(chi2, low)) - mu
    return np.where(chi2 <= low, 1.0, np.where(chi2 >= high, 0.0, middle))


def fitted_poses(problem: LoopProblem, use: Mask, poses: Array) -> Array:
    """Poses (N, n, n) that fit the trusted edges and the loops in use, by a few steps of least squares."""
    edges = problem.using(use)
    return reweighted(poses, edges, lambda chi2, step: np.ones(len(chi2)), Schedule(steps=8))


def graduated(problem: LoopProblem, use: Mask, poses: Array, limit: float) -> tuple[Array, Mask]:
    """Poses (N, n, n) and the loops (L,) among those in use whose chi-square stays within a limit.

    Args:
        problem: the graph.
        use: (L,) loops to fit to, the wrong ones among them to be found.
        poses: least squares on all of them.
        limit: chi-square beyond which an error counts as much as that, however large.
    """
    chi2 = problem.loops.chi2(poses)
    if (chi2[use] > limit).any():
        weigher = _Weigher(len(problem.trusted), limit, float(chi2[use].max()))
        poses = reweighted(poses, problem.using(use), weigher, Schedule(steps=_STEPS, least=weigher.stages))
    return poses, use & (problem.loops.chi2(poses) <= limit)
