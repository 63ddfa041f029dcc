"""The map that some loops would give, solved at once on the frames that they join and on no others.

Between those frames odometry is one edge, whose covariance comes in constant time, so that the graph is small
however long the drive.
"""

from collections.abc import Sequence
from itertools import pairwise

import gtsam
import numpy as np
from numpy.typing import NDArray

from slam import pose_graph_solver as solver
from slam.loop_closing import LoopClosure
from slam.pose_graph_drift import OdometryChain

Array = NDArray[np.float64]

_STEPS = 4  # of Gauss and Newton; measured: more change no verdict


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
        graph.add(solver.between_factor(first, second, chain.passing(first, second)))
    for other in others:
        graph.add(solver.loop_factor(other, "huber", width))
    optimizer = gtsam.GaussNewtonOptimizer(graph, values)
    for _ in range(_STEPS):
        optimizer.iterate()
    values = optimizer.values()
    joint = gtsam.Marginals(graph, values).jointMarginalCovariance([loop.match, loop.query])
    return solver.surprise(values, joint, loop, drift)
