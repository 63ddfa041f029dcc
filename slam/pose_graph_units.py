"""Motions and loops of one camera, whose scale drifts: brought to a common scale, and refined with their poses."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam import pose_graph_similarity as similarity
from slam.loop_closing import LoopClosure

Array = NDArray[np.float64]
Motion = tuple[Array, Array]  # (4, 4) and its covariance (6, 6)

_MIN_STEP = 1e-3  # path length of a camera that stands still: its scale must have a finite information
_UNKNOWN_SIGMA = 10.0  # of the log scale of a loop that does not measure it: a factor of e^10 means nothing


def in_common_scale(
    motions: Sequence[Motion], loops: Sequence[LoopClosure], scales: Array
) -> tuple[list[Motion], list[LoopClosure]]:
    """Motions and loops in one unit of length.

    Args:
        motions: (N - 1) motions from each frame to the next, each in the unit of its first frame.
        loops: loops, each in the unit of its match.
        scales: (N,) length of each frame's unit in the common one.
    """
    scaled = [scale_motion(*motion, scale) for motion, scale in zip(motions, scales[:-1], strict=True)]
    return scaled, [_scale_loop(loop, scales[loop.match]) for loop in loops]


def scale_motion(T: Array, covariance: Array, scale: float) -> Motion:
    """A motion (4, 4) and its covariance (6, 6) with all lengths multiplied by a scale."""
    T, factor = T.copy(), np.repeat([1.0, scale], 3)
    T[:3, 3] *= scale
    return T, covariance * np.outer(factor, factor)


def _scale_loop(loop: LoopClosure, scale: float) -> LoopClosure:
    T, covariance = scale_motion(loop.T_match_query, loop.covariance, scale)
    return replace(loop, T_match_query=T, covariance=covariance)


def refine_sim3(
    motions: Sequence[Motion], loops: Sequence[LoopClosure], poses: Array, scales: Array, drift: float
) -> tuple[Array, Array]:
    """Poses (N, 4, 4) and scales (N,) of least squared error in Sim(3), from ones that are nearly right.

    Args:
        motions: (N - 1) motions from each frame to the next, each in the unit of its first frame.
        loops: accepted loops, each in the unit of its match.
        poses: (N, 4, 4) poses to start with, in the unit of the first frame.
        scales: (N,) scales to start with, in the unit of the first frame.
        drift: standard deviation of the log scale over a path of one; it grows with the root of the path.
    """
    edges = []
    for k, (T, covariance) in enumerate(motions):
        step = max(float(np.linalg.norm(T[:3, 3])), _MIN_STEP)
        edges.append(_edge(k, k + 1, T, 0.0, covariance, drift * np.sqrt(step)))
    for loop in loops:
        sigma = loop.scale.sigma or _UNKNOWN_SIGMA
        edges.append(_edge(loop.match, loop.query, loop.T_match_query, loop.scale.log, loop.covariance, sigma))
    return similarity.optimize_sim3(edges, poses, scales)


def _edge(
    first: int, second: int, T: Array, log_scale: float, covariance: Array, sigma: float
) -> similarity.SimilarityEdge:
    return similarity.SimilarityEdge(first, second, T, log_scale, similarity.with_scale_variance(covariance, sigma))
