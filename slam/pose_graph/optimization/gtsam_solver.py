"""GTSAM behind NumPy arrays: factors of poses in space, and batch optimisation of edges of any group.

Keys are frame indices; Pose3's tangent space is that of this package (rotation first, right perturbation).
"""

from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from slam.errors import GraphError
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.lie_groups import planar_poses, rigid_and_scale, similarities

Array = NDArray[np.float64]
ANCHOR_SIGMA = 1e-6  # rad and m; tight enough to hold the first pose, loose enough for the conditioning
_PLANAR, _SPATIAL, _SIMILARITY = 3, 6, 7  # degrees of freedom of a pose
_MAX_LOG_CHANGE = 3.0  # of a scale from a start near the minimum: a factor of 20
_FACTORS = {
    _PLANAR: (gtsam.PriorFactorPose2, gtsam.BetweenFactorPose2),
    _SPATIAL: (gtsam.PriorFactorPose3, gtsam.BetweenFactorPose3),
    _SIMILARITY: (gtsam.PriorFactorSimilarity3, gtsam.BetweenFactorSimilarity3),
}


def prior_factor(T_world_first: Array) -> gtsam.PriorFactorPose3:
    """Prior that holds frame 0 at a pose (4, 4)."""
    noise = gtsam.noiseModel.Isotropic.Sigma(6, ANCHOR_SIGMA)
    return gtsam.PriorFactorPose3(0, gtsam.Pose3(T_world_first), noise)


def odometry_factor(first: int, second: int, T_first_second: Array, covariance: Array) -> gtsam.BetweenFactorPose3:
    """Factor of a motion (4, 4) between two keys, covariance (6, 6) rotation first."""
    noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
    return gtsam.BetweenFactorPose3(first, second, gtsam.Pose3(T_first_second), noise)


def loop_factor(closure: LoopClosure) -> gtsam.BetweenFactorPose3:
    """Factor of a loop with Gaussian noise."""
    return odometry_factor(closure.match, closure.query, closure.T_match_query, closure.covariance)


def huber_factor(closure: LoopClosure, huber_width_sigma: float) -> gtsam.BetweenFactorPose3:
    """Factor of a loop with Huber's kernel: its pull grows no further beyond a width in sigmas."""
    kernel = gtsam.noiseModel.mEstimator.Huber.Create(huber_width_sigma)
    noise = gtsam.noiseModel.Robust.Create(kernel, gtsam.noiseModel.Gaussian.Covariance(closure.covariance))
    return gtsam.BetweenFactorPose3(closure.match, closure.query, gtsam.Pose3(closure.T_match_query), noise)


def to_values(poses: Array) -> gtsam.Values:
    """GTSAM Values of poses (N, 4, 4), keyed from 0."""
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


def optimize(edges: Edges, start: Array) -> Array:
    """Poses (N, n, n) of least chi-square by Levenberg-Marquardt, the first pose held.

    Starts from `start` (N, n, n) or from chordal initialisation, whichever fits better.

    Raises:
        GraphError: the edges leave poses undetermined.
    """
    graph = _graph(edges, start[0])
    # Drifted odometry may lie in a local minimum that the chordal start, which needs no start, avoids.
    starts = [_values(start, edges.group.dof), *_chordal_starts(graph, start, edges)]
    return _poses(_levenberg_marquardt(graph, min(starts, key=graph.error)), edges.group.dof)


def refine(edges: Edges, start: Array) -> Array:
    """Poses (N, n, n) of least chi-square by Levenberg-Marquardt from a start (N, n, n) near the minimum.

    Similarities stay as they are where the system cannot be solved or a scale runs away: steps of very different
    lengths leave a scale free.

    Raises:
        GraphError: the edges leave poses undetermined.
    """
    dof = edges.group.dof
    try:
        found = _poses(_levenberg_marquardt(_graph(edges, start[0]), _values(start, dof)), dof)
    except GraphError:
        if dof != _SIMILARITY:
            raise
        return start
    return start if dof == _SIMILARITY and _runs_away(found, start) else found


def _runs_away(found: Array, start: Array) -> bool:
    """Whether similarities (N, 4, 4) are not finite, or a scale is far from where it started."""
    if not np.isfinite(found).all():
        return True
    changes = np.log(rigid_and_scale(found)[1] / rigid_and_scale(start)[1])
    return not bool(np.abs(changes).max() < _MAX_LOG_CHANGE)


def chordal_initialization(edges: Edges, start: Array) -> Array:
    """Poses (N, n, n) by solving for rotations first, without a start (Carlone et al., ICRA 2015; LAGO in the plane).

    Raises:
        RuntimeError: GTSAM finds no spanning tree, or the poses have scales.
    """
    graph = _graph(edges, start[0])
    return _poses(_chordal_values(graph, edges, start), edges.group.dof)


def _levenberg_marquardt(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.Values:
    try:
        return gtsam.LevenbergMarquardtOptimizer(graph, values, gtsam.LevenbergMarquardtParams()).optimize()
    except RuntimeError as error:  # GTSAM's "indeterminant linear system"
        raise GraphError(
            "the edges leave some poses undetermined; expected every pose to be joined to the first by edges of "
            f"positive definite information ({str(error).strip().splitlines()[0]})"
        ) from error


def _chordal_starts(graph: gtsam.NonlinearFactorGraph, start: Array, edges: Edges) -> list[gtsam.Values]:
    """The chordal start in a list, which is empty where GTSAM finds none."""
    try:
        return [_chordal_values(graph, edges, start)]
    except RuntimeError:
        return []


def _chordal_values(graph: gtsam.NonlinearFactorGraph, edges: Edges, start: Array) -> gtsam.Values:
    dof = edges.group.dof
    if dof == _SIMILARITY:
        raise RuntimeError("GTSAM has no chordal initialisation of similarities")
    if dof == _SPATIAL:
        return gtsam.InitializePose3.initialize(graph)
    diagonal = np.zeros_like(edges.information)
    index = np.arange(3)
    diagonal[:, index, index] = 1.0 / edges.covariance[:, index, index]
    diagonal_only = Edges(edges.first, edges.second, edges.motions, diagonal)  # LAGO reads diagonal noise only
    return gtsam.lago.initialize(_graph(diagonal_only, start[0]))


def _graph(edges: Edges, first: Array) -> gtsam.NonlinearFactorGraph:
    dof = edges.group.dof
    prior, between = _FACTORS[dof]
    graph = gtsam.NonlinearFactorGraph()
    held = gtsam.noiseModel.Diagonal.Sigmas(np.full(dof, ANCHOR_SIGMA))
    graph.add(prior(0, _gtsam_poses(first[None], dof)[0], held))
    measured = _gtsam_poses(edges.motions, dof)
    rows = zip(edges.first.tolist(), edges.second.tolist(), measured, edges.information, strict=True)
    for i, j, motion, information in rows:
        graph.add(between(i, j, motion, gtsam.noiseModel.Gaussian.Information(information)))
    return graph


def _gtsam_poses(poses: Array, dof: int) -> list[Any]:
    if dof == _SPATIAL:
        return [gtsam.Pose3(T) for T in poses]
    if dof == _SIMILARITY:  # GTSAM's takes p to scale * (R p + t), so its translation is in the camera's unit
        rigid, scales = rigid_and_scale(poses)
        return [gtsam.Similarity3(gtsam.Rot3(T[:3, :3]), T[:3, 3] / s, s) for T, s in zip(rigid, scales, strict=True)]
    angles = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    return [gtsam.Pose2(x, y, a) for x, y, a in zip(poses[:, 0, 2], poses[:, 1, 2], angles, strict=True)]


def _values(poses: Array, dof: int) -> gtsam.Values:
    values = gtsam.Values()
    for key, pose in enumerate(_gtsam_poses(poses, dof)):
        values.insert(key, pose)
    return values


def _poses(values: gtsam.Values, dof: int) -> Array:
    if dof == _PLANAR:
        return planar_poses(gtsam.utilities.extractPose2(values))
    if dof == _SPATIAL:
        return to_poses(values)
    nodes = [values.atSimilarity3(key) for key in range(values.size())]
    scales, poses = np.array([node.scale() for node in nodes]), np.tile(np.eye(4), (len(nodes), 1, 1))
    poses[:, :3, :3] = [node.rotation().matrix() for node in nodes]
    poses[:, :3, 3] = scales[:, None] * np.array([node.translation() for node in nodes])
    return similarities(poses, scales)
