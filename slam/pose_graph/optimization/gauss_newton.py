"""Gauss-Newton with iteratively reweighted least squares (IRLS) on arrays of edges.

The inner loop of the back ends, where weights change with every step. GTSAM's optimisers keep weights fixed while they
converge and need each factor built anew for a new weight; here a weight is a factor on rows. The last step to the
minimum is left to GTSAM (`slam.pose_graph.optimization.gtsam_solver`). Why not GTSAM's GNC:
docs/decisions/own_gauss_newton.md.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import SuperLU, splu

from slam.pose_graph.optimization.edges import Edges

Array = NDArray[np.float64]
Reweight = Callable[[Array, int], Array]  # chi-squares (M,), number of the step -> weights (M,)
# Jacobian (M, N dof), right-hand side (N dof,), dof -> solution (N dof,) of the normal equations
NormalSolver = Callable[[sparse.csr_array, Array, int], Array]

_DAMPING = 1e-13  # relative to the diagonal; poses that no weighted edge holds stay where they are
_MAX_HALVINGS = 4  # of a step that makes the fit worse
_CG_TOLERANCE = 1e-5  # of the residual, relative to the right-hand side
_MAX_CG_STEPS = 1000


@dataclass(frozen=True)
class IrlsSchedule:
    """When iteratively reweighted least squares ends."""

    max_steps: int = 25
    # Decrease of the weighted chi-square below which it ends, in mean chi-squares of an edge: an uncertain direction
    # counts as much as a stiff one, which a share of the whole chi-square would hide.
    tolerance: float = 0.1
    min_steps: int = 1  # taken in any case, while a schedule of weights runs


def solve_by_factors(jacobian: sparse.csr_array, right: Array, dof: int) -> Array:
    """Solve normal equations by sparse factors: exact, but places that are joined many times fill the factors."""
    return np.asarray(factorize_jacobian(jacobian).solve(right))


def conjugate_gradients(coarse: sparse.csr_array) -> NormalSolver:
    """Solver of normal equations by conjugate gradients, in memory that grows with the edges alone.

    The preconditioner has two levels (Dryja and Widlund 1987): the blocks between successive poses, which are the chain
    of odometry and each loop's hold on its own two poses, and the modes that are cheap for loops and chain alike.

    Args:
        coarse: (N dof, K) basis of these modes.
    """

    def solve(jacobian: sparse.csr_array, right: Array, dof: int) -> Array:
        H = (jacobian.T @ jacobian).tocsr()
        entries, basis = H.tocoo(), coarse[dof:]
        near = np.abs(entries.row // dof - entries.col // dof) <= 1
        chain = sparse.csc_array((entries.data[near], (entries.row[near], entries.col[near])), shape=H.shape)
        fine, few = factorize_damped(chain), factorize_damped((basis.T @ H @ basis).tocsc())
        restrict = basis.T.tocsr()

        def precondition(residual: Array) -> Array:
            return np.asarray(fine.solve(residual) + basis @ few.solve(restrict @ residual))

        return _conjugate_gradients(H, right, precondition)

    return solve


def _conjugate_gradients(H: sparse.csr_array, right: Array, precondition: Callable[[Array], Array]) -> Array:
    """Solution x (n,) of H x = right."""
    x, residual, direction = np.zeros_like(right), right, precondition(right)
    old, limit = _dot(right, direction), _CG_TOLERANCE**2 * _dot(right, right)
    for _ in range(_MAX_CG_STEPS):
        if _dot(residual, residual) <= limit:
            break
        image = H @ direction
        length = old / _dot(direction, image)
        x, residual = x + length * direction, residual - length * image
        preconditioned = precondition(residual)
        new = _dot(residual, preconditioned)
        direction, old = preconditioned + new / old * direction, new
    return x


def _dot(a: Array, b: Array) -> float:
    """Inner product, whose rounding does not depend on the number of threads as that of BLAS does."""
    return float((a * b).sum())


def irls(
    poses: Array,
    edges: Edges,
    reweight: Reweight,
    schedule: IrlsSchedule | None = None,
    solve: NormalSolver = solve_by_factors,
) -> Array:
    """Poses (N, n, n) by iteratively reweighted least squares; the first pose stays where it is.

    Args:
        poses: (N, n, n) poses to start with.
        edges: M edges of a connected graph.
        reweight: gives the weights (M,) of the edges' chi-squares before every step.
        schedule: when to end.
        solve: solver of the normal equations of each step.
    """
    schedule = schedule or IrlsSchedule()
    for number in range(schedule.max_steps):
        chi2 = edges.chi2(poses)
        weights = reweight(chi2, number)
        before = float(weights @ chi2)
        poses, after = _step(poses, edges, weights, before, solve)
        if number + 1 >= schedule.min_steps and before - after <= schedule.tolerance * before / len(edges):
            break
    return poses


def whitened_jacobian(poses: Array, edges: Edges) -> sparse.csr_array:
    """Jacobian (M dof, N dof) of the whitened errors by right perturbations; exact where the residuals are zero."""
    return _jacobian(poses, edges, edges.sqrt_information)


def jacobian_of_errors(poses: Array, edges: Edges) -> sparse.csr_array:
    """Jacobian (M dof, N dof) of the errors by right perturbations; exact where the residuals are zero."""
    return _jacobian(poses, edges, np.broadcast_to(np.eye(edges.group.dof), edges.information.shape))


def _jacobian(poses: Array, edges: Edges, weight: Array) -> sparse.csr_array:
    """Jacobian (M dof, N dof) of errors times weights (M, dof, dof).

    With e = log(M^-1 T_i^-1 T_j): de/dxi_j = I and de/dxi_i = -Ad(T_j^-1 T_i), the inverse right Jacobian of the
    logarithm taken for the identity (docs/math.md).
    """
    dof, count = edges.group.dof, len(edges)
    relative = edges.group.inverse(poses[edges.second]) @ poses[edges.first]
    blocks = np.concatenate([-weight @ edges.group.adjoint(relative), weight], axis=2)
    ends = np.stack([edges.first, edges.second], axis=1)
    columns = (ends[:, :, None] * dof + np.arange(dof)).reshape(count, 1, 2 * dof)
    columns = np.broadcast_to(columns, (count, dof, 2 * dof))
    rows = np.arange(0, count * dof * 2 * dof + 1, 2 * dof)
    return sparse.csr_array((blocks.ravel(), columns.ravel(), rows), shape=(count * dof, len(poses) * dof))


def factorize_jacobian(jacobian: sparse.csr_array) -> SuperLU:
    """Sparse factors of the normal equations of a Jacobian."""
    return factorize_damped((jacobian.T @ jacobian).tocsc())


def factorize_damped(H: sparse.csc_array) -> SuperLU:
    """Sparse factors of a symmetric, positive semidefinite matrix; what nothing holds stays where it is."""
    return factorize(H + sparse.diags_array(_DAMPING * H.diagonal() + np.finfo(float).tiny, format="csc"))


def factorize(H: sparse.csc_array) -> SuperLU:
    """Sparse factors of a symmetric, positive definite matrix."""
    return splu(H, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def _step(poses: Array, edges: Edges, weights: Array, before: float, solve: NormalSolver) -> tuple[Array, float]:
    """Poses after one step and their weighted chi-square; the poses stay if every length of the step is worse."""
    dof = edges.group.dof
    scale = np.repeat(np.sqrt(weights), dof)
    jacobian = sparse.csr_array(sparse.diags_array(scale) @ whitened_jacobian(poses, edges)[:, dof:])
    errors = scale * np.einsum("mij,mj->mi", edges.sqrt_information, edges.errors(poses)).ravel()
    step = -solve(jacobian, jacobian.T @ errors, dof)
    step = np.concatenate([np.zeros(dof), step]).reshape(len(poses), dof)
    for halving in range(_MAX_HALVINGS):
        moved = poses @ edges.group.exp(0.5**halving * step)
        after = float(weights @ edges.chi2(moved))
        if after <= before:
            return moved, after
    return poses, before
