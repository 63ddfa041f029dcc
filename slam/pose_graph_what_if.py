"""The map that some loops would give, solved at once on the frames that they join and on no others.

Between those frames odometry is one edge, whose covariance comes in constant time, so that the graph is small
however long the drive.
"""

from collections.abc import Sequence
from itertools import pairwise

import gtsam
import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam import pose_graph_solver as solver
from slam.loop_closing import LoopClosure
from slam.pose_graph_drift import OdometryChain

Array = NDArray[np.float64]

_STEPS = 4  # of Gauss and Newton; a first guess, other numbers were not tried


def surprise_by_others(
    loop: LoopClosure, others: Sequence[LoopClosure], chain: OdometryChain, width: float, drift: Array
) -> float:
    """Chi-square of a loop against the map that odometry and other loops give, as sure as that map is.

    Args:
        loop: between frames.
        others: likewise.
        chain: odometry.
        width: Huber width of the other loops, sigmas.
        drift: (6, 6) covariance of T_match_query that the map knows nothing of.
    """
    frames = sorted({0, loop.match, loop.query} | {k for other in others for k in (other.match, other.query)})
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(solver.anchor(np.eye(4)))
    for frame in frames:
        values.insert(frame, gtsam.Pose3(chain[frame]))
    for first, second in pairwise(frames):
        between = chain.passing(first, second)
        graph.add(solver.odometry_factor(first, second, between.T_first_second, between.covariance))
    for other in others:
        graph.add(solver.doubted_factor(other, width))
    optimizer = gtsam.GaussNewtonOptimizer(graph, values)
    for _ in range(_STEPS):
        optimizer.iterate()
    values = optimizer.values()
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance([loop.match, loop.query])
    return surprise(values, joint, loop, drift)


def surprise(values: gtsam.Values, joint: gtsam.JointMarginal, loop: LoopClosure, drift: Array) -> float:
    """Chi-square of a loop that is not in a graph against the graph, as sure as that is.

    Args:
        values: where the graph is solved.
        joint: marginal of the loop's two poses.
        loop: with its own covariance.
        drift: (6, 6) covariance of T_match_query that the graph knows nothing of.
    """
    T_world_match, T_world_query = (values.atPose3(key).matrix() for key in (loop.match, loop.query))
    T_match_query = se3.inverse(T_world_match) @ T_world_query
    J = np.hstack([-se3.adjoint(se3.inverse(T_match_query)), np.eye(6)])
    ends = (loop.match, loop.query)
    sure = J @ np.block([[joint.at(a, b) for b in ends] for a in ends]) @ J.T
    error = se3.log(se3.inverse(loop.T_match_query) @ T_match_query)
    return float(error @ np.linalg.solve(sure + drift + loop.covariance, error))
