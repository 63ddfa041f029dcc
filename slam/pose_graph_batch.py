"""Batch optimisation of arrays of edges by GTSAM, in the plane and in space, and the starts to do it from."""

from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from slam.errors import GraphError
from slam.pose_graph_edges import Edges
from slam.pose_graph_lie import planar_poses
from slam.pose_graph_solver import ANCHOR_SIGMA, to_poses

Array = NDArray[np.float64]

_TOLERANCE = 1e-6  # relative decrease of the error that ends an optimisation
_PATIENCE = 5  # iterations after which a start that still gains much is doubted
_MUCH = 0.01  # relative decrease in one iteration
_MOST = 100  # iterations


def minimum(edges: Edges, start: Array) -> Array:
    """Poses (N, n, n) of least squared error that Levenberg-Marquardt finds, the first pose held.

    A start that has not settled after a few iterations is compared with a chordal one, and the better goes on.

    Raises:
        GraphError: the edges leave poses undetermined.
    """
    graph = _graph(edges, start[0])
    try:
        search = _Search(graph, _values(start))
        search.run(_PATIENCE)
        if search.gain > _MUCH:
            search = min([search, *_others(graph, start, edges)], key=lambda each: each.error)
        search.run(_MOST)
    except RuntimeError as error:  # GTSAM's "indeterminant linear system"
        raise GraphError(
            "the edges leave some poses undetermined; expected every pose to be joined to the first by edges of "
            f"positive definite information ({str(error).strip().splitlines()[0]})"
        ) from error
    return _poses(search.values, start)


def chordal(edges: Edges, start: Array) -> Array:
    """Poses (N, n, n) from rotations solved for first, without a start (Carlone et al., ICRA 2015; LAGO in the plane).

    Raises:
        RuntimeError: GTSAM finds none, for want of a spanning tree.
    """
    graph = _graph(edges, start[0])
    return _poses(_chordal_values(graph, edges, start), start)


class _Search:
    """Levenberg-Marquardt that can be interrupted and looked at.

    Attributes:
        gain: relative decrease of the error in the last iteration.
    """

    def __init__(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> None:
        self._optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, gtsam.LevenbergMarquardtParams())
        self.gain = 1.0

    @property
    def error(self) -> float:
        return float(self._optimizer.error())

    @property
    def values(self) -> gtsam.Values:
        return self._optimizer.values()

    def run(self, iterations: int) -> None:
        """Iterate until the error settles, so many times at most."""
        for _ in range(iterations):
            if self.gain <= _TOLERANCE:
                break
            before = self.error
            self._optimizer.iterate()
            self.gain = (before - self.error) / max(before, np.finfo(float).tiny)


def _others(graph: gtsam.NonlinearFactorGraph, start: Array, edges: Edges) -> list[_Search]:
    """Searches from a chordal start, if there is one."""
    try:
        return [_Search(graph, _chordal_values(graph, edges, start))]
    except RuntimeError:
        return []


def _chordal_values(graph: gtsam.NonlinearFactorGraph, edges: Edges, start: Array) -> gtsam.Values:
    if start.shape[-1] == 4:
        return gtsam.InitializePose3.initialize(graph)
    diagonal = np.zeros_like(edges.information)
    index = np.arange(3)
    diagonal[:, index, index] = 1.0 / edges.covariance[:, index, index]
    plain = Edges(edges.first, edges.second, edges.motions, diagonal)  # LAGO reads no other noise
    return gtsam.lago.initialize(_graph(plain, start[0]))


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
