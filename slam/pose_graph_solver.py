"""The pose graph in GTSAM's terms: numpy in, numpy out.

Keys are frame indices; Pose3's tangent space is ours (rotation first, right perturbation).
"""

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.loop_closing import LoopClosure

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ANCHOR_SIGMA = 1e-6  # rad and m; holds the first pose without disturbing the numerics
_ROUGH, _FINE = 1e-3, 1e-6  # relative decrease of the error that ends an optimisation
_KERNELS = {
    "huber": gtsam.noiseModel.mEstimator.Huber.Create,
    "dcs": gtsam.noiseModel.mEstimator.DCS.Create,
}


def anchor(T_world_first: Array) -> gtsam.PriorFactorPose3:
    """Prior that holds frame 0 at a pose (4, 4)."""
    noise = gtsam.noiseModel.Isotropic.Sigma(6, _ANCHOR_SIGMA)
    return gtsam.PriorFactorPose3(0, gtsam.Pose3(T_world_first), noise)


def motion_factor(current: int, T_previous_current: Array, covariance: Array) -> gtsam.BetweenFactorPose3:
    """Odometry from frame current - 1 to current, covariance (6, 6) rotation first."""
    noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
    return gtsam.BetweenFactorPose3(current - 1, current, gtsam.Pose3(T_previous_current), noise)


def loop_factor(closure: LoopClosure, kernel: str | None = None, width: float = 0.0) -> gtsam.BetweenFactorPose3:
    """Factor of a loop, plain or under a robust kernel (`huber`: width in sigmas, `dcs`: a chi-square)."""
    noise: gtsam.noiseModel.Base = gtsam.noiseModel.Gaussian.Covariance(closure.covariance)
    if kernel is not None:
        noise = gtsam.noiseModel.Robust.Create(_KERNELS[kernel](width), noise)
    return gtsam.BetweenFactorPose3(closure.match, closure.query, gtsam.Pose3(closure.T_match_query), noise)


def to_values(poses: Array) -> gtsam.Values:
    """GTSAM's Values of poses (N, 4, 4), keyed from 0."""
    values = gtsam.Values()
    for key, T in enumerate(poses):
        values.insert(key, gtsam.Pose3(T))
    return values


def to_poses(values: gtsam.Values) -> Array:
    """Poses (N, 4, 4) of Values, by key."""
    rows = gtsam.utilities.extractPose3(values)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3] = rows[:, :9].reshape(-1, 3, 3)
    poses[:, :3, 3] = rows[:, 9:]
    return poses


def loop_chi2(closures: Sequence[LoopClosure], poses: Array) -> Array:
    """(L,) squared Mahalanobis length of each loop's error at poses (N, 4, 4)."""
    out = np.empty(len(closures))
    for k, c in enumerate(closures):
        T_match_query = se3.inverse(poses[c.match]) @ poses[c.query]
        error = se3.log(se3.inverse(c.T_match_query) @ T_match_query)
        out[k] = error @ np.linalg.solve(c.covariance, error)
    return out


class GraphProblem:
    """A chain of odometry with loops, for the back ends (`slam.robust.LoopProblem`)."""

    def __init__(
        self,
        odometry: Array,
        motions: gtsam.NonlinearFactorGraph,
        closures: Sequence[LoopClosure],
        gate: Array,
    ) -> None:
        self.odometry, self.gate = odometry, gate
        self._motions, self._closures = motions, tuple(closures)

    def least_squares(self, use: Mask, start: Array) -> Array:
        """Poses (N, 4, 4) that fit the chain and the loops in use, by Levenberg-Marquardt from start."""
        return self._levenberg(self._graph(use), start) if use.any() else self.odometry

    def kernel(self, name: str, width: float, start: Array, use: Mask) -> Array:
        """Poses (N, 4, 4) under a robust kernel on the loops in use."""
        return self._levenberg(self._graph(use, name, width), start) if use.any() else self.odometry

    def graduated(self, limit: float, use: Mask) -> Array:
        """Weights (L,) of GTSAM's GNC, all but the loops known to be inliers; 0 for loops not in use.

        Roughly solved steps are enough for weights: the same verdicts in a third of the time.
        """
        graph, first = self._graph(use), self._motions.size()
        start = gtsam.LevenbergMarquardtOptimizer(graph, to_values(self.odometry), _tolerance(_ROUGH)).optimize()
        params = gtsam.GncLMParams(_tolerance(_ROUGH))
        params.setKnownInliers(list(range(first)))
        optimizer = gtsam.GncLMOptimizer(graph, start, params)
        optimizer.setInlierCostThresholds(0.5 * limit)  # GTSAM's costs are half chi-squares
        optimizer.optimize()
        weights = np.zeros(len(self._closures))
        weights[use] = np.asarray(optimizer.getWeights())[first:]  # weights count all factors
        return weights

    def chi2(self, poses: Array) -> Array:
        """(L,) chi-square of each loop at poses (N, 4, 4)."""
        return loop_chi2(self._closures, poses)

    def error(self, use: Mask, poses: Array) -> float:
        """Half chi-square of the chain and the loops in use, at poses (N, 4, 4)."""
        return float(self._graph(use).error(to_values(poses)))

    def _graph(self, use: Mask, kernel: str | None = None, width: float = 0.0) -> gtsam.NonlinearFactorGraph:
        graph = gtsam.NonlinearFactorGraph()
        graph.push_back(self._motions)
        for k in np.flatnonzero(use):
            graph.add(loop_factor(self._closures[k], kernel, width))
        return graph

    @staticmethod
    def _levenberg(graph: gtsam.NonlinearFactorGraph, start: Array) -> Array:
        return to_poses(gtsam.LevenbergMarquardtOptimizer(graph, to_values(start), _tolerance(_FINE)).optimize())


def _tolerance(relative: float) -> gtsam.LevenbergMarquardtParams:
    """Parameters that stop when an iteration takes less than this share off the error."""
    params = gtsam.LevenbergMarquardtParams()
    params.setRelativeErrorTol(relative)
    return params
