"""The pose graph of one camera: similarities Sim(3), so that what corrects the way corrects its scale with it.

A node is what takes points of a camera, in the unit that its depths had then, to the world; an edge measures one
node in the frame and in the unit of another (Strasdat et al., Scale Drift-Aware Large Scale Monocular SLAM, RSS
2010). Solved by GTSAM from poses and units that are nearly right already.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_HELD = 1e-6  # sigma of the first node: rad, m, and of its logarithm of scale


@dataclass(frozen=True)
class SimilarityEdge:
    """A measured similarity between two nodes.

    Attributes:
        first, second: the nodes.
        T_first_second: (4, 4) second camera in the first one's frame and unit.
        log_unit: logarithm of the second one's unit in the first one's.
        covariance: (7, 7) of the right perturbation: rotation, translation, logarithm of scale.
    """

    first: int
    second: int
    T_first_second: Array
    log_unit: float
    covariance: Array


def with_unit(covariance: Array, sigma: float) -> Array:
    """Covariance (7, 7) of a motion's (6, 6) and of the unit's independent error."""
    out = np.zeros((7, 7))
    out[:6, :6], out[6, 6] = covariance, sigma**2
    return out


def optimized(edges: Sequence[SimilarityEdge], poses: Array, units: Array) -> tuple[Array, Array]:
    """Poses (N, 4, 4) and units (N,) of least squared error, the first ones held, from poses and units to start with.

    The edges must join all nodes; one that none reaches stays where it is.
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    held = gtsam.noiseModel.Diagonal.Sigmas(np.full(7, _HELD))
    graph.add(gtsam.PriorFactorSimilarity3(0, _similarity(poses[0], units[0]), held))
    for edge in edges:
        noise = gtsam.noiseModel.Gaussian.Covariance(edge.covariance)
        measured = _similarity(edge.T_first_second, float(np.exp(edge.log_unit)))
        graph.add(gtsam.BetweenFactorSimilarity3(edge.first, edge.second, measured, noise))
    for node, (pose, unit) in enumerate(zip(poses, units, strict=True)):
        values.insert(node, _similarity(pose, unit))
    found = gtsam.LevenbergMarquardtOptimizer(graph, values, gtsam.LevenbergMarquardtParams()).optimize()
    nodes = [found.atSimilarity3(node) for node in range(len(poses))]
    return np.array([_pose(node) for node in nodes]), np.array([node.scale() for node in nodes])


def _similarity(T: Array, unit: float) -> gtsam.Similarity3:
    """GTSAM's similarity takes p to scale * (R p + t): its translation is in the smaller frame's unit."""
    return gtsam.Similarity3(gtsam.Rot3(T[:3, :3]), T[:3, 3] / unit, float(unit))


def _pose(node: gtsam.Similarity3) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = node.rotation().matrix(), node.scale() * node.translation()
    return T
