"""How sure the optimised trajectory is: marginal covariances of all poses.

Two parts are added. The graph's own marginals (Kaess and Dellaert, RAS 2009) count errors that are independent
from motion to motion. A bias of odometry that lasts all the way is not one of the graph's unknowns, so it shifts
the solution; by how much follows from the same linear system (the sandwich: covariance of an estimator under
errors that it does not model).
"""

import gtsam
import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from slam import pose_graph_solver as solver
from slam.pose_graph_newton import factors

Array = NDArray[np.float64]

_DOF = 6


def marginal_covariances(graph: gtsam.NonlinearFactorGraph, poses: Array, bias: Array) -> Array:
    """Covariances (N, 6, 6) of the right perturbations of poses, rotation first, frame 0 held.

    Args:
        graph: the anchor, then the N - 1 motions in order, then any loops.
        poses: T_world_camera (N, 4, 4), metres, where the graph is solved.
        bias: (N - 1, 6) standard deviation of the lasting error of each motion; all motions share its sign.
    """
    values = solver.to_values(poses)
    linear, marginals = graph.linearize(values), gtsam.Marginals(graph, values)
    own = np.array([marginals.marginalCovariance(key) for key in range(len(poses))])
    shift = _response(linear, len(poses), bias)
    return own + shift @ np.swapaxes(shift, 1, 2)


def _response(linear: gtsam.GaussianFactorGraph, count: int, bias: Array) -> Array:
    """How far (N, 6, 6) each pose moves when each of the six motion errors lasts, one column for each."""
    rows, columns, values = linear.sparseJacobian_()
    shape = (int(rows.max()), count * _DOF + 1)
    # GTSAM counts from 1 and puts the right-hand side last
    A = sparse.csr_array((values, (rows.astype(int) - 1, columns.astype(int) - 1)), shape=shape)[:, :-1]
    moved = sparse.csr_array(A[: count * _DOF].tocoo())
    # the rows of motion k, in the columns of the pose that it leads to, are what whitens its error
    same_pose = sparse.block_diag([np.ones((_DOF, _DOF))] * count, format="csr")
    whitening = moved.multiply(same_pose).tocsr()
    spread = np.concatenate([np.zeros((1, _DOF)), bias])[:, :, None] * np.eye(_DOF)
    right = A[: count * _DOF].T @ (whitening @ spread.reshape(-1, _DOF))
    return factors((A.T @ A).tocsc()).solve(right).reshape(count, _DOF, _DOF)
