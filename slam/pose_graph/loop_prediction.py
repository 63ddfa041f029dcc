"""Predictive chi-square of a loop: how far it is from the map that other loops give, by the covariances of both.

The map is solved on the frames that the loops join alone. Between those frames odometry is one edge, whose covariance
takes constant time, so that the graph is small however long the drive.
"""

from collections.abc import Sequence
from itertools import pairwise

import gtsam
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.odometry_chain import OdometryChain
from slam.pose_graph.optimization import gtsam_factors as factors

Array = NDArray[np.float64]

_GAUSS_NEWTON_STEPS = 4  # a first guess; other numbers were not tried


def predictive_chi2_given(
    loop: LoopClosure, others: Sequence[LoopClosure], chain: OdometryChain, huber_width: float, bias: Array
) -> float:
    """Predictive chi-square of a loop against the map that odometry and other loops give.

    Args:
        loop: loop between frames.
        others: loops between frames that make the map.
        chain: odometry of all frames.
        huber_width: Huber width of the other loops, sigmas.
        bias: (6, 6) covariance of T_match_query by odometry's bias, which the graph does not model.
    """
    frames = sorted({0, loop.match, loop.query} | {k for other in others for k in (other.match, other.query)})
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(factors.prior_factor(np.eye(4)))
    for frame in frames:
        values.insert(frame, gtsam.Pose3(chain[frame]))
    for first, second in pairwise(frames):
        between = chain.between_without_bias(first, second)
        graph.add(factors.odometry_factor(first, second, between.T_first_second, between.covariance))
    for other in others:
        graph.add(factors.huber_factor(other, huber_width))
    optimizer = gtsam.GaussNewtonOptimizer(graph, values)
    for _ in range(_GAUSS_NEWTON_STEPS):
        optimizer.iterate()
    values = optimizer.values()
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance([loop.match, loop.query])
    return predictive_chi2(values, joint, loop, bias)


def predictive_chi2(values: gtsam.Values, joint: gtsam.JointMarginal, loop: LoopClosure, bias: Array) -> float:
    """Chi-square of a loop against a graph that does not contain it, by the covariances of both.

    Args:
        values: solution of the graph.
        joint: joint marginal covariance of the loop's two poses.
        loop: loop between nodes of the graph.
        bias: (6, 6) covariance of T_match_query by odometry's bias, which the graph does not model.
    """
    T_world_match, T_world_query = (values.atPose3(key).matrix() for key in (loop.match, loop.query))
    T_match_query = se3.inverse(T_world_match) @ T_world_query
    # The relative pose moves with the query as it is, with the match by the adjoint.
    J = np.hstack([-se3.adjoint(se3.inverse(T_match_query)), np.eye(6)])
    ends = (loop.match, loop.query)
    predicted = J @ np.block([[joint.at(a, b) for b in ends] for a in ends]) @ J.T
    error = se3.log(se3.inverse(loop.T_match_query) @ T_match_query)
    return float(error @ np.linalg.solve(predicted + bias + loop.covariance, error))
