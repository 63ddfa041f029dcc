"""Batch optimisation of arrays of edges by GTSAM, in the plane and in space, and chordal initialisation."""

from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from slam.errors import GraphError
from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.gtsam_factors import ANCHOR_SIGMA, to_poses
from slam.pose_graph.optimization.lie_groups import planar_poses

Array = NDArray[np.float64]


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
    """The chordal start in a list; an empty list if there is none."""
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
    diagonal_only = Edges(edges.first, edges.second, edges.motions, diagonal)  # LAGO reads no other noise
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
