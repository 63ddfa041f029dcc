"""Monocular scale: log scales of all frames by loops, and the Sim(3) pose graph of poses and scales.

Scale multiplies along the path, so its logarithm adds up and the graph of log scales is linear; its loops are weighted
robustly (Geman and McClure). Scales are solved before the poses, so that the back ends work on rigid motions in one
common scale. At the end poses and scales are refined together (Strasdat et al., RSS 2010): a node is the similarity
that takes points of a camera, in the unit that its depths had at that time, to the world; an edge measures one node in
the frame and in the unit of another. GTSAM solves this graph from poses and scales that are nearly right already.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from odometry.motion import EXTRAPOLATION_SIGMA_M
from slam.loop_closing.loop_closer import LoopClosure

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
Motion = tuple[Array, Array]  # (4, 4) and its covariance (6, 6)

_PRIOR_SIGMA = 1e-6  # of the first node, which is held: rad, m, log scale
_MIN_STEP = 1e-3  # path length of a camera that stands still: its scale must have a finite information
_UNKNOWN_SIGMA = 10.0  # of the log scale of a loop that does not measure it: e^10 leaves the scale free
_MAX_LOG_CHANGE = 3.0  # of a scale in the refinement, which starts from scales that are nearly right: a factor of 20
# The odometry of one camera states at least this variance, summed over the axes, of a translation that it did not
# measure, and a smaller one of any that it did. The scale may change by half then, as the depth of scenes does.
_GUESSED_VARIANCE, _JUMP_SIGMA = 0.9 * 3 * EXTRAPOLATION_SIGMA_M**2, 0.5
_ITERATIONS = 20  # of reweighting
_KERNEL_CHI2 = 9.0  # chi-square of a loop at which its weight is a quarter: three sigmas


@dataclass(frozen=True)
class SimilarityEdge:
    """A measured similarity between two nodes.

    Attributes:
        first, second: indices of the two nodes.
        T_first_second: (4, 4) second camera in the frame and the unit of the first one.
        log_scale: logarithm of the second camera's unit of length, as a multiple of the first one's.
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


def scale_variances(motions: Sequence[Motion], drift: float) -> Array:
    """Variance (N - 1,) of the log scale's change in each motion.

    Scale drifts over the path. Where a motion was not measured, or depths had to be found anew, it may jump.

    Args:
        motions: (N - 1) motions from each frame to the next.
        drift: standard deviation of the log scale's change over a path of one.
    """
    steps = np.array([max(float(np.linalg.norm(T[:3, 3])), _MIN_STEP) for T, _ in motions])
    guessed = np.array([np.trace(covariance[3:, 3:]) > _GUESSED_VARIANCE for _, covariance in motions], dtype=bool)
    return np.asarray(drift**2 * steps + np.where(guessed, _JUMP_SIGMA**2, 0.0))


def estimate_log_scales(
    steps: Array, loops: Sequence[LoopClosure], drift: float, variances: Array | None = None
) -> Array:
    """Logarithm (N,) of each frame's scale in that of the first frame.

    Args:
        steps: (N - 1,) path length from each frame to the next.
        loops: loops, with the relative scale of their frames where that was measured (sigma above 0).
        drift: standard deviation of the log scale's change over a path of one; 0: the scale never changes.
        variances: (N - 1,) variance of the log scale's change in each step; None for drift alone.
    """
    count = len(steps) + 1
    measuring = [loop for loop in loops if loop.scale.sigma > 0]
    if drift == 0 or not measuring:
        return np.zeros(count)
    match, query = np.array([(loop.match, loop.query) for loop in measuring]).T
    measured = np.array([loop.scale.log for loop in measuring])
    information = 1.0 / np.square([loop.scale.sigma for loop in measuring])
    chain = 1.0 / (drift**2 * np.maximum(steps, _MIN_STEP) if variances is None else variances)
    before = np.arange(count - 1)
    logs, weights = np.zeros(count), _initial_weights(match, query, steps, drift, measured, information)
    for _ in range(_ITERATIONS):
        first, second = np.concatenate([before, match]), np.concatenate([before + 1, query])
        weighted = np.concatenate([chain, weights * information])
        logs = _solve_differences(first, second, np.concatenate([np.zeros(count - 1), measured]), weighted)
        chi2 = information * (logs[query] - logs[match] - measured) ** 2
        weights = 1.0 / (1.0 + chi2 / _KERNEL_CHI2) ** 2
    return logs


def _initial_weights(
    match: Rows, query: Rows, steps: Array, drift: float, measured: Array, information: Array
) -> Array:
    """Weights (L,) of the loops by what drift alone explains: the kernel must not start at no drift at all."""
    path_length = np.concatenate([[0.0], np.cumsum(steps)])
    variance = 1.0 / information + drift**2 * (path_length[query] - path_length[match])
    return np.asarray(1.0 / (1.0 + measured**2 / variance / _KERNEL_CHI2) ** 2)


def _solve_differences(first: Rows, second: Rows, measured: Array, weights: Array) -> Array:
    """Values (N,), the first 0, whose differences fit measured ones (M,) best under weights (M,)."""
    count = int(second.max()) + 1
    rows = np.concatenate([first, second, first, second])
    columns = np.concatenate([first, second, second, first])
    H = coo_matrix((np.concatenate([weights, weights, -weights, -weights]), (rows, columns)), (count, count)).tocsc()
    b = np.bincount(second, weights * measured, count) - np.bincount(first, weights * measured, count)
    return np.concatenate([[0.0], spsolve(H[1:, 1:], b[1:])])


def in_common_scale(
    motions: Sequence[Motion], loops: Sequence[LoopClosure], scales: Array
) -> tuple[list[Motion], list[LoopClosure]]:
    """Convert motions and loops to one unit of length.

    Args:
        motions: (N - 1) motions from each frame to the next, each in the unit of its first frame.
        loops: loops, each in the unit of its match.
        scales: (N,) unit of length of each frame, as a multiple of the common one.
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
    for k, (motion, variance) in enumerate(zip(motions, scale_variances(motions, drift), strict=True)):
        edges.append(_edge(k, k + 1, motion[0], 0.0, motion[1], float(np.sqrt(variance))))
    for loop in loops:
        sigma = loop.scale.sigma or _UNKNOWN_SIGMA
        edges.append(_edge(loop.match, loop.query, loop.T_match_query, loop.scale.log, loop.covariance, sigma))
    return optimize_sim3(edges, poses, scales)


def _edge(first: int, second: int, T: Array, log_scale: float, covariance: Array, sigma: float) -> SimilarityEdge:
    return SimilarityEdge(first, second, T, log_scale, with_scale_variance(covariance, sigma))


def optimize_sim3(edges: Sequence[SimilarityEdge], poses: Array, scales: Array) -> tuple[Array, Array]:
    """Poses (N, 4, 4) and scales (N,) of least squared error, the first node held.

    Args:
        edges: measured similarities; a node without any edge stays where it is.
        poses: (N, 4, 4) poses to start with.
        scales: (N,) scales to start with.

    Returns:
        The start where the system cannot be solved, or where a scale runs away.
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
    try:
        found = gtsam.LevenbergMarquardtOptimizer(graph, values, gtsam.LevenbergMarquardtParams()).optimize()
    except RuntimeError:  # an indeterminate system: steps of very different lengths leave a scale free
        return poses, scales
    nodes = [found.atSimilarity3(node) for node in range(len(poses))]
    refined = np.array([_pose(node) for node in nodes]), np.array([node.scale() for node in nodes])
    return refined if _is_plausible(*refined, scales) else (poses, scales)


def _is_plausible(poses: Array, scales: Array, start: Array) -> bool:
    """Whether poses (N, 4, 4) are finite and no scale (N,) has run away from where it started (N,)."""
    if not (np.isfinite(poses).all() and np.isfinite(scales).all() and (scales > 0).all()):
        return False
    return bool(np.abs(np.log(scales / start)).max() < _MAX_LOG_CHANGE)


def _similarity(T: Array, scale: float) -> gtsam.Similarity3:
    """GTSAM's similarity of a pose and a scale.

    It takes p to scale * (R p + t), so its translation is in the camera's unit.
    """
    return gtsam.Similarity3(gtsam.Rot3(T[:3, :3]), T[:3, 3] / scale, float(scale))


def _pose(node: gtsam.Similarity3) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = node.rotation().matrix(), node.scale() * node.translation()
    return T
