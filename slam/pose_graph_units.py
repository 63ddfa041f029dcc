"""Edges whose unit of length drifts: brought to one unit, and corrected with their poses."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam import pose_graph_similarity as similarity
from slam.loop_closing import LoopClosure

Array = NDArray[np.float64]
Motion = tuple[Array, Array]  # (4, 4) and its covariance (6, 6)


def levelled(
    motions: Sequence[Motion], loops: Sequence[LoopClosure], units: Array
) -> tuple[list[Motion], list[LoopClosure]]:
    """Motions and loops in one unit, of which the own unit of each frame is so much, (N,)."""
    even = [resized(*motion, unit) for motion, unit in zip(motions, units[:-1], strict=True)]
    return even, [_resized_loop(loop, units[loop.match]) for loop in loops]


def resized(T: Array, covariance: Array, unit: float) -> Motion:
    """Express a motion (4, 4) with its covariance (6, 6) in a unit of which its own is so much."""
    T, rate = T.copy(), np.repeat([1.0, unit], 3)
    T[:3, 3] *= unit
    return T, covariance * np.outer(rate, rate)


def _resized_loop(loop: LoopClosure, unit: float) -> LoopClosure:
    T, covariance = resized(loop.T_match_query, loop.covariance, unit)
    return replace(loop, T_match_query=T, covariance=covariance)


def corrected(
    motions: Sequence[Motion], loops: Sequence[LoopClosure], poses: Array, units: Array, drift: float
) -> tuple[Array, Array]:
    """Poses (N, 4, 4) and units (N,) that agree best with everything, from those that nearly do.

    Args:
        motions: from each frame to the next, in its own unit.
        loops: all believed, in the unit of the match.
        poses: (N, 4, 4) to start with, in the unit of the first frame.
        units: (N,) likewise.
        drift: standard deviation of the logarithm of the unit over a way of one; it grows with the way's root.
    """
    edges = []
    for k, (T, covariance) in enumerate(motions):
        way = max(float(np.linalg.norm(T[:3, 3])), _STANDING)
        edges.append(_edge(k, k + 1, T, 0.0, covariance, drift * np.sqrt(way)))
    for loop in loops:
        sigma = loop.unit.sigma or _UNKNOWN
        edges.append(_edge(loop.match, loop.query, loop.T_match_query, loop.unit.log, loop.covariance, sigma))
    return similarity.optimized(edges, poses, units)


_STANDING = 1e-3  # way of a camera that stands
_UNKNOWN = 10.0  # sigma of a unit that a loop does not compare


def _edge(
    first: int, second: int, T: Array, log_unit: float, covariance: Array, sigma: float
) -> similarity.SimilarityEdge:
    return similarity.SimilarityEdge(first, second, T, log_unit, similarity.with_unit(covariance, sigma))
