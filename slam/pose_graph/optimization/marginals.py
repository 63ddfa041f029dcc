"""Covariances of poses in an optimised graph: marginals of single poses, and relative poses from posterior samples.

Two parts add up to a marginal. The graph's own marginals (Kaess and Dellaert, RAS 2009) count errors that are
independent from motion to motion. A bias of odometry that lasts for the whole path is not one of the graph's unknowns,
so it shifts the solution; by how much follows from the same linear system (the sandwich formula: covariance of an
estimator under errors that it does not model). Where places are joined many times, the blocks of the inverse come from
the entries of the factors alone (Takahashi et al., PICA 1973).

The covariance of the relative pose of any two poses comes from samples of the posterior. Exact marginals of every
proposed loop would need as many solves as there are loops; a fixed number of samples gives all of them at once
(perturb-and-solve: Papandreou and Yuille, NIPS 2010).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
import scipy.sparse as sparse
from numba import njit
from numpy.typing import NDArray
from scipy.sparse.linalg import SuperLU

from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.optimization import gtsam_solver as factors
from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.gauss_newton import factorize, factorize_jacobian, whitened_jacobian

Array = NDArray[np.float64]
Rows = NDArray[np.int32]

_DOF = 6  # of a pose in space
SAMPLES = 48  # of the posterior: the standard deviation of a variance is then a fifth of it, sqrt(2 / 48)


def marginal_covariances(
    motions: Sequence[tuple[Array, Array]], loops: Sequence[LoopClosure], poses: Array, bias_sigmas: Array
) -> Array:
    """Covariances (N, 6, 6) of the right perturbations of poses, rotation first, frame 0 held.

    Args:
        motions: N - 1 motions T_previous_current (4, 4) with their covariances (6, 6), in order.
        loops: loops to which the poses are fitted.
        poses: T_world_camera (N, 4, 4), metres, the solution of the graph.
        bias_sigmas: (N - 1, 6) standard deviation of the bias's error in each motion; all share its sign.
    """
    graph, values = _graph(motions, loops), factors.to_values(poses)
    linear, marginals = graph.linearize(values), gtsam.Marginals(graph, values)
    independent = np.array([marginals.marginalCovariance(key) for key in range(len(poses))])
    shift = _response(linear, len(poses), bias_sigmas)
    return independent + shift @ np.swapaxes(shift, 1, 2)


def marginals_by_factors(poses: Array, edges: Edges, errors: Array) -> Array:
    """As `marginal_covariances` (N, dof, dof), in a time that grows with the entries of the factors.

    Args:
        poses: (N, n, n) the solution of the graph, metres, the first pose held.
        edges: E edges to which the poses are fitted.
        errors: (E, dof, M) errors of the edges by M causes of one standard deviation.
    """
    dof = edges.group.dof
    jacobian = whitened_jacobian(poses, edges)[:, dof:]
    factors = factorize_jacobian(jacobian)
    whitened = (edges.sqrt_information @ errors).reshape(len(edges) * dof, -1)
    shift = factors.solve(jacobian.T @ whitened).reshape(len(poses) - 1, dof, -1)
    covariances = _diagonal_blocks(factors, dof) + shift @ np.swapaxes(shift, 1, 2)
    return np.concatenate([np.zeros((1, dof, dof)), covariances])


def _diagonal_blocks(factors: SuperLU, dof: int) -> Array:
    """Blocks (N, dof, dof) on the diagonal of the inverse of a symmetric matrix, by its factors."""
    L = factors.L.sorted_indices()
    inverse = sparse.csc_array(
        (_inverse_entries(L.indptr, L.indices, L.data, factors.U.diagonal()), L.indices, L.indptr)
    )
    order = factors.perm_c
    block = np.arange(len(order)).reshape(-1, dof)
    row, column = np.broadcast_arrays(order[block][:, :, None], order[block][:, None, :])
    entries = inverse[np.maximum(row, column).ravel(), np.minimum(row, column).ravel()]
    return np.asarray(entries).reshape(-1, dof, dof)


@njit(cache=True)
def _inverse_entries(begins: Rows, rows: Rows, lower: Array, pivots: Array) -> Array:
    """Entries of the inverse of L D L^T where L has entries, from the last column to the first."""
    inverse, at = np.empty_like(lower), np.full(len(pivots), -1)
    for column in range(len(pivots) - 1, -1, -1):
        first, end = begins[column] + 1, begins[column + 1]  # below the diagonal
        sums = np.zeros(end - first)
        for k in range(first, end):
            at[rows[k]] = k - first
        for k in range(first, end):
            for entry in range(begins[rows[k]], begins[rows[k] + 1]):
                other = at[rows[entry]]
                if other >= 0:
                    sums[other] += inverse[entry] * lower[k]
                    if other != k - first:
                        sums[k - first] += inverse[entry] * lower[first + other]
        inverse[first - 1] = 1.0 / pivots[column]
        for k in range(first, end):
            inverse[k] = -sums[k - first]
            inverse[first - 1] += lower[k] * sums[k - first]
            at[rows[k]] = -1
    return inverse


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
    # The Jacobian of a motion with respect to its second pose is the matrix that whitens its error.
    same_pose = sparse.block_diag([np.ones((_DOF, _DOF))] * count, format="csr")
    whitening = motions.multiply(same_pose).tocsr()
    errors = np.concatenate([np.zeros((1, _DOF)), bias_sigmas])[:, :, None] * np.eye(_DOF)
    right = A[: count * _DOF].T @ (whitening @ errors.reshape(-1, _DOF))
    return factorize((A.T @ A).tocsc()).solve(right).reshape(count, _DOF, _DOF)


@dataclass(frozen=True)
class Posterior:
    """Samples of the Gaussian posterior of a graph around its poses.

    Attributes:
        poses: (N, n, n) mean of the posterior, metres.
        samples: (N, dof, S) right perturbations of the poses, the first pose held.
    """

    poses: Array
    samples: Array

    def relative_covariance(self, edges: Edges) -> Array:
        """Covariances (M, dof, dof) of the relative pose between the ends of each edge, without its own measurement.

        Scaled so that its inverse is unbiased (Hartlap et al., A&A 2007).
        """
        relative = edges.group.inverse(self.poses[edges.second]) @ self.poses[edges.first]
        moved = edges.group.adjoint(relative) @ self.samples[edges.first]
        difference = self.samples[edges.second] - moved
        return difference @ np.swapaxes(difference, 1, 2) / self._divisor

    @property
    def inflation(self) -> float:
        """Expected `relative_covariance` over the true covariance."""
        return self.samples.shape[2] / self._divisor

    @property
    def _divisor(self) -> int:
        return self.samples.shape[2] - self.samples.shape[1] - 1


def sample_posterior(poses: Array, edges: Edges, seed: int = 0) -> Posterior:
    """Sample the posterior of a connected graph at poses (N, n, n), the first pose held."""
    dof = edges.group.dof
    jacobian = whitened_jacobian(poses, edges)[:, dof:]
    # The least-squares solution for unit noise in the whitened errors is a sample of the posterior.
    noise = np.random.default_rng(seed).normal(size=(jacobian.shape[0], SAMPLES))
    moved = factorize_jacobian(jacobian).solve(jacobian.T @ noise)
    samples = np.concatenate([np.zeros((dof, SAMPLES)), moved]).reshape(len(poses), dof, SAMPLES)
    return Posterior(poses, samples)
