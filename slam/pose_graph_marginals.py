"""Marginal covariances of all poses of an optimised trajectory.

Two parts are added. The graph's own marginals (Kaess and Dellaert, RAS 2009) count errors that are independent
from motion to motion. A bias of odometry that lasts for the whole path is not one of the graph's unknowns, so it shifts
the solution; by how much follows from the same linear system (the sandwich formula: covariance of an estimator under
errors that it does not model).
"""

from collections.abc import Sequence

import gtsam
import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from slam import pose_graph_solver as factors
from slam.loop_closing import LoopClosure
from slam.pose_graph_newton import factorize

Array = NDArray[np.float64]

_DOF = 6


def marginal_covariances(
    motions: Sequence[tuple[Array, Array]], loops: Sequence[LoopClosure], poses: Array, bias_sigmas: Array
) -> Array:
    """Covariances (N, 6, 6) of the right perturbations of poses, rotation first, frame 0 held.

    Args:
        motions: N - 1 motions T_previous_current (4, 4) with their covariances (6, 6), in order.
        loops: loops that the poses are fitted to.
        poses: T_world_camera (N, 4, 4), metres, the solution of the graph.
        bias_sigmas: (N - 1, 6) standard deviation of the bias's error in each motion; all share its sign.
    """
    graph, values = _graph(motions, loops), factors.to_values(poses)
    linear, marginals = graph.linearize(values), gtsam.Marginals(graph, values)
    independent = np.array([marginals.marginalCovariance(key) for key in range(len(poses))])
    shift = _response(linear, len(poses), bias_sigmas)
    return independent + shift @ np.swapaxes(shift, 1, 2)


def _graph(motions: Sequence[tuple[Array, Array]], loops: Sequence[LoopClosure]) -> gtsam.NonlinearFactorGraph:
    """Prior, motions, loops, in the order on which `_response` relies."""
    graph = gtsam.NonlinearFactorGraph()
    graph.add(factors.prior_factor(np.eye(4)))
    for k, (T, covariance) in enumerate(motions):
        graph.add(factors.odometry_factor(k, k + 1, T, covariance))
    for loop in loops:
        graph.add(factors.loop_factor(loop))
    return graph


def _response(linear: gtsam.GaussianFactorGraph, count: int, bias_sigmas: Array) -> Array:
    """Shift (N, 6, 6) of each pose by a bias of one sigma, one column for each of the six errors."""
    rows, columns, values = linear.sparseJacobian_()
    shape = (int(rows.max()), count * _DOF + 1)
    # GTSAM counts from 1 and puts the right-hand side last.
    A = sparse.csr_array((values, (rows.astype(int) - 1, columns.astype(int) - 1)), shape=shape)[:, :-1]
    motions = sparse.csr_array(A[: count * _DOF].tocoo())
    # The Jacobian of a motion by the pose that it leads to is what whitens its error.
    same_pose = sparse.block_diag([np.ones((_DOF, _DOF))] * count, format="csr")
    whitening = motions.multiply(same_pose).tocsr()
    errors = np.concatenate([np.zeros((1, _DOF)), bias_sigmas])[:, :, None] * np.eye(_DOF)
    right = A[: count * _DOF].T @ (whitening @ errors.reshape(-1, _DOF))
    return factorize((A.T @ A).tocsc()).solve(right).reshape(count, _DOF, _DOF)
