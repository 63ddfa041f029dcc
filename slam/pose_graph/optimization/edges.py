"""Edges of a pose graph as arrays: measured relative poses and their residuals.

The residual of an edge is log(measured^-1 T_first_second), a right perturbation; docs/math.md derives it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from slam.pose_graph.optimization.lie_groups import LieGroup, group_of

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


@dataclass(frozen=True)
class Edges:
    """Measured relative poses: in the plane (n = 3, dof 3), in space (n = 4, dof 6), or in space with a scale (dof 7).

    Attributes:
        first, second: (M,) rows of the two poses of each edge.
        motions: (M, n, n) T_first_second, metres.
        information: (M, dof, dof) inverse covariances of right perturbations, in GTSAM's order.
    """

    first: Rows
    second: Rows
    motions: Array
    information: Array

    def __len__(self) -> int:
        return len(self.first)

    def __getitem__(self, chosen: NDArray[np.bool_] | Rows | slice) -> "Edges":
        return Edges(self.first[chosen], self.second[chosen], self.motions[chosen], self.information[chosen])

    @property
    def group(self) -> LieGroup:
        """SE2, SE3 or Sim3."""
        return group_of(self.information.shape[-1])

    @cached_property
    def sqrt_information(self) -> Array:
        """(M, dof, dof) upper triangular square roots of the information, which whiten errors."""
        # With information L L^T, chi-square is |L^T e|^2.
        return np.asarray(np.linalg.cholesky(self.information).swapaxes(1, 2), dtype=np.float64)

    @cached_property
    def covariance(self) -> Array:
        """(M, dof, dof) inverse of the information."""
        return np.asarray(np.linalg.inv(self.information), dtype=np.float64)

    def errors(self, poses: Array) -> Array:
        """(M, dof) log of measured^-1 @ T_first_second at poses (N, n, n)."""
        inverse = self.group.inverse
        relative = inverse(poses[self.first]) @ poses[self.second]
        return self.group.log(inverse(self.motions) @ relative)

    def chi2(self, poses: Array) -> Array:
        """(M,) squared Mahalanobis norms of the errors at poses (N, n, n)."""
        errors = self.errors(poses)
        return np.einsum("mi,mij,mj->m", errors, self.information, errors)


def concatenate(one: Edges, other: Edges) -> Edges:
    """Edges of two sets, in that order."""
    return Edges(
        np.concatenate([one.first, other.first]),
        np.concatenate([one.second, other.second]),
        np.concatenate([one.motions, other.motions]),
        np.concatenate([one.information, other.information]),
    )


def from_measurements(ends: Rows, measured: Sequence[tuple[Array, Array]]) -> Edges:
    """Edges in space from their ends (M, 2) and from M measured poses (4, 4) with covariances (6, 6)."""
    ends = ends.reshape(-1, 2).astype(np.int64)
    covariances = np.array([covariance for _, covariance in measured]).reshape(-1, 6, 6)
    motions = np.array([T for T, _ in measured]).reshape(-1, 4, 4)
    return Edges(ends[:, 0], ends[:, 1], motions, np.linalg.inv(covariances))
