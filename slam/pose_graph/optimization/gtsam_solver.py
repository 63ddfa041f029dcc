"""GTSAM behind NumPy arrays: factors of poses in space, and batch optimisation of edges in the plane and in space.

Keys are frame indices; Pose3's tangent space is that of this package (rotation first, right perturbation).
"""

from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from slam.errors import GraphError
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.planar_or_spatial import planar_poses

Array = NDArray[np.float64]
ANCHOR_SIGMA = 1e-6  # rad and m; tight enough to hold the first pose, loose enough for the conditioning


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
    starts = [_values(start), *_chordal_starts(graph, start, edges)]
    return _poses(_levenberg_marquardt(graph, min(starts, key=graph.error)), start)


def refine(edges: Edges, start: Array) -> Array:
    """Poses (N, n, n) of least chi-square by Levenberg-Marquardt from a start (N, n, n) near the minimum.

    Raises:
        GraphError: the edges leave poses undetermined.
    """
    return _poses(_levenberg_marquardt(_graph(edges, start[0]), _values(start)), start)


def chordal_initialization(edges: Edges, start: Array) -> Array:
    """Poses (N, n, n) by solving for rotations first, without a start (Carlone et al., ICRA 2015; LAGO in the plane).

    Raises:
        RuntimeError: GTSAM finds no spanning tree.
    """
    graph = _graph(edges, start[0])
    return _poses(_chordal_values(graph, edges, start), start)


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
    if start.shape[-1] == 4:
        return gtsam.InitializePose3.initialize(graph)
    diagonal = np.zeros_like(edges.information)
    index = np.arange(3)
    diagonal[:, index, index] = 1.0 / edges.covariance[:, index, index]
    diagonal_only = Edges(edges.first, edges.second, edges.motions, diagonal)  # LAGO reads diagonal noise only
    return gtsam.lago.initialize(_graph(diagonal_only, start[0]))


def _graph(edges: Edges, first: Array) -> gtsam.NonlinearFactorGraph:
    flat = first.shape[0] == 3
    between = gtsam.BetweenFactorPose2 if flat else gtsam.BetweenFactorPose3
    prior = gtsam.PriorFactorPose2 if flat else gtsam.PriorFactorPose3
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.full(edges.group.dof, ANCHOR_SIGMA))
    graph = gtsam.NonlinearFactorGraph()
    graph.add(prior(0, _gtsam_poses(first[None])[0], noise))
    rows = zip(edges.first.tolist(), edges.second.tolist(), _gtsam_poses(edges.motions), edges.information, strict=True)
    for i, j, motion, information in rows:
        graph.add(between(i, j, motion, gtsam.noiseModel.Gaussian.Information(information)))
    return graph


def _gtsam_poses(poses: Array) -> list[Any]:
    if poses.shape[-1] == 4:
        return [gtsam.Pose3(T) for T in poses]
    angles = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    return [gtsam.Pose2(x, y, a) for x, y, a in zip(poses[:, 0, 2], poses[:, 1, 2], angles, strict=True)]


def _values(poses: Array) -> gtsam.Values:
    values = gtsam.Values()
    for key, pose in enumerate(_gtsam_poses(poses)):
        values.insert(key, pose)
    return values


def _poses(values: gtsam.Values, like: Array) -> Array:
    if like.shape[-1] == 3:
        return planar_poses(gtsam.utilities.extractPose2(values))
    return to_poses(values)
