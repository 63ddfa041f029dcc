"""Scale of one camera: motions and loops as measured similarities, Sim(3).

The unit of length of one camera drifts. So a node of the pose graph is the similarity that takes points of a camera, in
the unit that its depths had at that time, to the world; an edge measures one node in the frame and in the unit of
another (Strasdat et al., RSS 2010). The back ends work on these as on rigid motions.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from odometry.motion import EXTRAPOLATION_SIGMA_M
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.lie_groups import similarities

Array = NDArray[np.float64]
Motion = tuple[Array, Array]  # (4, 4) and its covariance (6, 6)

_MIN_STEP = 1e-3  # path length of a camera that stands still: its scale must have a finite information
_UNKNOWN_SIGMA = 10.0  # of the log scale of a loop that does not measure it: e^10 leaves the scale free
# The odometry of one camera states at least this variance, summed over the axes, of a translation that it did not
# measure, and a smaller one of any that it did. The scale may change by half then, as the depth of scenes does.
_GUESSED_VARIANCE, _JUMP_SIGMA = 0.9 * 3 * EXTRAPOLATION_SIGMA_M**2, 0.5
_LASTING_SHARE = 0.3  # of the relative error of a step's length: measured 0.04 to 0.05, in the worst turns up to 0.3


def similarity_motions(motions: Sequence[Motion], variances: Array) -> Edges:
    """Edges from each of N frames to the next, by which the scale changes by as much as its variance (N - 1,) says.

    Args:
        motions: (N - 1) motions, each in the unit of its first frame.
        variances: (N - 1,) of the change of the log scale.
    """
    before = np.arange(len(motions))
    T = np.array([motion for motion, _ in motions]).reshape(-1, 4, 4)
    return Edges(before, before + 1, T, _information([covariance for _, covariance in motions], variances))


def similarity_loops(loops: Sequence[LoopClosure]) -> Edges:
    """Edges of loops, each in the unit of its match, with the scale of the query's unit where that was measured."""
    ends = np.array([(loop.match, loop.query) for loop in loops], np.int64).reshape(-1, 2)
    T = np.array([loop.T_match_query for loop in loops]).reshape(-1, 4, 4)
    measured = similarities(T, np.exp([loop.scale.log for loop in loops]))
    variances = np.square([loop.scale.sigma or _UNKNOWN_SIGMA for loop in loops])
    return Edges(ends[:, 0], ends[:, 1], measured, _information([loop.covariance for loop in loops], variances))


def _information(covariances: Sequence[Array], variances: Array) -> Array:
    """Information (M, 7, 7) of motions with covariances (6, 6) and independent variances (M,) of the log scale."""
    out = np.zeros((len(covariances), 7, 7))
    out[:, :6, :6] = np.linalg.inv(np.array(covariances).reshape(-1, 6, 6))
    out[:, 6, 6] = 1.0 / np.asarray(variances)
    return out


def scale_variances(motions: Sequence[Motion], drift: float) -> Array:
    """Variance (N - 1,) of the log scale's change in each motion.

    Scale drifts over the path, and with the error of the step's own length: in a turn on the spot, where depths and
    translation are hardly known. Where a motion was not measured, or depths had to be found anew, it may jump.

    Args:
        motions: (N - 1) motions from each frame to the next.
        drift: standard deviation of the log scale's change over a path of one.
    """
    translations = np.array([T[:3, 3] for T, _ in motions]).reshape(-1, 3)
    covariances = np.array([covariance[3:, 3:] for _, covariance in motions]).reshape(-1, 3, 3)
    steps = np.maximum(np.linalg.norm(translations, axis=1), _MIN_STEP)
    along = translations / steps[:, None]
    length_errors = np.sqrt(np.einsum("ni,nij,nj->n", along, covariances, along)) / steps
    is_guessed = np.trace(covariances, axis1=1, axis2=2) > _GUESSED_VARIANCE
    changes = np.where(is_guessed, _JUMP_SIGMA, np.minimum(_LASTING_SHARE * length_errors, _JUMP_SIGMA))
    return np.asarray(drift**2 * steps + changes**2)


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
