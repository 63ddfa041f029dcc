"""Graduated non-convexity (GNC) with truncated least squares, one step of Gauss-Newton a stage.

Yang et al., RA-L 2020.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.pose_graph.optimization.gauss_newton import IrlsSchedule, irls
from slam.pose_graph.robust.problem import LoopProblem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MU_FACTOR = 4.0  # a step; the paper takes 1.4, with a full minimisation between two steps
_MAX_MU = 30.0  # weights are then as good as binary
_MAX_STEPS = 40
_MAX_EXPONENT = 60  # keeps mu finite


@dataclass(frozen=True)
class _GncWeights:
    """Weights of trusted edges, always one, and of loops, closer to binary with every step.

    Attributes:
        trusted: number of trusted edges.
        limit: chi-square of an inlier.
        worst: largest chi-square at the start, which sets the first mu.
    """

    trusted: int
    limit: float
    worst: float

    @property
    def stages(self) -> int:
        """Steps until the weights are as good as binary."""
        return int(np.ceil(np.log(_MAX_MU / self._mu(0)) / np.log(_MU_FACTOR)))

    def __call__(self, chi2: Array, step: int) -> Array:
        weights = np.ones(len(chi2))
        weights[self.trusted :] = gnc_tls_weights(chi2[self.trusted :], self.limit, self._mu(step))
        return weights

    def _mu(self, step: int) -> float:
        first = self.limit / max(2.0 * self.worst - self.limit, self.limit)
        return float(first * _MU_FACTOR ** min(step, _MAX_EXPONENT))


def gnc_tls_weights(chi2: Array, limit: float, mu: float) -> Array:
    """(M,) weights of truncated least squares at a stage mu of its graduation (Yang et al., equation 14).

    Args:
        chi2: (M,) chi-squares.
        limit: chi-square of an inlier.
        mu: near 0 the cost is convex; at infinity it is truncated least squares.
    """
    low, high = mu / (mu + 1.0) * limit, (mu + 1.0) / mu * limit
    middle = np.sqrt(limit * mu * (mu + 1.0) / np.maximum(chi2, low)) - mu
    return np.where(chi2 <= low, 1.0, np.where(chi2 >= high, 0.0, middle))


def least_squares(problem: LoopProblem, use: Mask, poses: Array) -> Array:
    """Poses (N, n, n) that fit the trusted edges and the loops in use, by at most eight Gauss-Newton steps."""
    edges = problem.edges_with(use)
    return irls(poses, edges, lambda chi2, step: np.ones(len(chi2)), IrlsSchedule(max_steps=8))


def gnc(problem: LoopProblem, use: Mask, poses: Array, limit: float) -> tuple[Array, Mask]:
    """Poses (N, n, n) and the inliers (L,) among the loops in use.

    Args:
        problem: trusted edges and loops.
        use: (L,) bool, loops to fit to, some of them false.
        poses: (N, n, n) least squares on all loops in use.
        limit: chi-square of an inlier, beyond which a larger error costs no more.
    """
    chi2 = problem.loops.chi2(poses)
    if (chi2[use] > limit).any():
        weights = _GncWeights(len(problem.trusted), limit, float(chi2[use].max()))
        poses = irls(
            poses, problem.edges_with(use), weights, IrlsSchedule(max_steps=_MAX_STEPS, min_steps=weights.stages)
        )
    return poses, use & (problem.loops.chi2(poses) <= limit)
