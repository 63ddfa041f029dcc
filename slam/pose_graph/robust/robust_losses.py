"""Robust kernels: weights that fall as a loop's chi-square grows, by iteratively reweighted least squares."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from slam.pose_graph.optimization.gauss_newton import irls
from slam.pose_graph.robust.covariance_calibration import Screening
from slam.pose_graph.robust.gnc import least_squares
from slam.pose_graph.robust.problem import LoopProblem

Array = NDArray[np.float64]

Kernel = Callable[[Array, float], Array]  # chi-squares (M,), limit -> weights (M,)


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
