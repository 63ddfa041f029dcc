"""GTSAM factors and values of poses in space: NumPy in, NumPy out.

Keys are frame indices; Pose3's tangent space is ours (rotation first, right perturbation).
"""

import gtsam
import numpy as np
from numpy.typing import NDArray

from slam.loop_closing.loop_closer import LoopClosure

Array = NDArray[np.float64]

ANCHOR_SIGMA = 1e-6  # rad and m; tight enough to hold the first pose, loose enough for the conditioning


def prior_factor(T_world_first: Array) -> gtsam.PriorFactorPose3:
    """Prior that holds frame 0 at a pose (4, 4)."""
    noise = gtsam.noiseModel.Isotropic.Sigma(6, ANCHOR_SIGMA)
    return gtsam.PriorFactorPose3(0, gtsam.Pose3(T_world_first), noise)


def odometry_factor(first: int, second: int, T_first_second: Array, covariance: Array) -> gtsam.BetweenFactorPose3:
    """Factor of a motion (4, 4) between two keys, covariance (6, 6) rotation first."""
    noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
    return gtsam.BetweenFactorPose3(first, second, gtsam.Pose3(T_first_second), noise)


def loop_factor(closure: LoopClosure) -> gtsam.BetweenFactorPose3:
    """Factor of a loop that is taken to be right."""
    return odometry_factor(closure.match, closure.query, closure.T_match_query, closure.covariance)


def huber_factor(closure: LoopClosure, huber_width: float) -> gtsam.BetweenFactorPose3:
    """Factor of a loop whose force does not grow beyond a width in sigmas (Huber)."""
    kernel = gtsam.noiseModel.mEstimator.Huber.Create(huber_width)
    noise = gtsam.noiseModel.Robust.Create(kernel, gtsam.noiseModel.Gaussian.Covariance(closure.covariance))
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
