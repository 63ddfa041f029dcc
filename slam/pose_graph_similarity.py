"""Sim(3) pose graph of one camera: poses and scales are optimised together (Strasdat et al., RSS 2010).

A node is the similarity that takes points of a camera, in the unit that its depths had at that time, to the world. An
edge measures one node in the frame and in the unit of another. Solved by GTSAM from poses and scales that are nearly
right already.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_PRIOR_SIGMA = 1e-6  # of the first node, which is held: rad, m, log scale


@dataclass(frozen=True)
class SimilarityEdge:
    """A measured similarity between two nodes.

    Attributes:
        first, second: indices of the two nodes.
        T_first_second: (4, 4) second camera in the frame and the unit of the first one.
        log_scale: logarithm of the length of the second camera's unit in that of the first.
        covariance: (7, 7) of the right perturbation: rotation, translation, log scale.
    """

    first: int
    second: int
    T_first_second: Array
    log_scale: float
    covariance: Array


def with_scale_variance(covariance: Array, sigma: float) -> Array:
    """Covariance (7, 7) of a motion's (6, 6) and an independent error of the log scale."""
    out = np.zeros((7, 7))
    out[:6, :6], out[6, 6] = covariance, sigma**2
    return out


def optimize_sim3(edges: Sequence[SimilarityEdge], poses: Array, scales: Array) -> tuple[Array, Array]:
    """Poses (N, 4, 4) and scales (N,) of least squared error, the first node held.

    Args:
        edges: measured similarities; a node without any edge stays where it is.
        poses: (N, 4, 4) poses to start with.
        scales: (N,) scales to start with.
    """
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    held = gtsam.noiseModel.Diagonal.Sigmas(np.full(7, _PRIOR_SIGMA))
    graph.add(gtsam.PriorFactorSimilarity3(0, _similarity(poses[0], scales[0]), held))
    for edge in edges:
        noise = gtsam.noiseModel.Gaussian.Covariance(edge.covariance)
        measured = _similarity(edge.T_first_second, float(np.exp(edge.log_scale)))
        graph.add(gtsam.BetweenFactorSimilarity3(edge.first, edge.second, measured, noise))
    for node, (pose, scale) in enumerate(zip(poses, scales, strict=True)):
        values.insert(node, _similarity(pose, scale))
    found = gtsam.LevenbergMarquardtOptimizer(graph, values, gtsam.LevenbergMarquardtParams()).optimize()
    nodes = [found.atSimilarity3(node) for node in range(len(poses))]
    return np.array([_pose(node) for node in nodes]), np.array([node.scale() for node in nodes])


def _similarity(T: Array, scale: float) -> gtsam.Similarity3:
    """GTSAM's similarity of a pose and a scale.

    It takes p to scale * (R p + t), so its translation is in the camera's unit.
    """
    return gtsam.Similarity3(gtsam.Rot3(T[:3, :3]), T[:3, 3] / scale, float(scale))


def _pose(node: gtsam.Similarity3) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = node.rotation().matrix(), node.scale() * node.translation()
    return T
