"""The Lie groups of a pose graph, SE(2) and SE(3), as stacks of matrices for graphs with many edges.

Tangent vectors belong to right perturbations, `T @ exp(xi)`, in GTSAM's order: (x, y, theta) in the plane,
rotation first in space, metres and radians. Formulas: Barfoot, State Estimation for Robotics (2017), chapter 7.
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.se3 import inverse as inverse

Array = NDArray[np.float64]

# rad; below it the second-order series are exact to double precision: their next terms are angle^4 / 120 or smaller
_SMALL_ANGLE = 1e-4


class LieGroup(Protocol):
    """The group of a graph's poses."""

    @property
    def size(self) -> int:
        """Rows of a pose matrix, 3 in the plane and 4 in space."""
        ...

    @property
    def dof(self) -> int:
        """Length of a tangent vector."""
        ...

    @property
    def rotation(self) -> slice:
        """Rotation part of a tangent vector."""
        ...

    @property
    def translation(self) -> slice:
        """Translation part of a tangent vector."""
        ...

    def exp(self, xi: Array) -> Array:
        """Motions (M, size, size) of tangent vectors (M, dof)."""
        ...

    def log(self, T: Array) -> Array:
        """Tangent vectors (..., dof) of poses (..., size, size)."""
        ...

    def adjoint(self, T: Array) -> Array:
        """Adjoints (..., dof, dof): `T @ exp(xi) == exp(adjoint(T) @ xi) @ T`."""
        ...


class SE2:
    """Rigid motions of the plane."""

    size, dof = 3, 3
    translation, rotation = slice(0, 2), slice(2, 3)

    def exp(self, xi: Array) -> Array:
        """Motions (M, 3, 3) of tangent vectors (M, 3)."""
        theta = xi[:, 2]
        small = np.abs(theta) < _SMALL_ANGLE
        safe = np.where(small, 1.0, theta)
        a = np.where(small, 1.0 - theta**2 / 6.0, np.sin(theta) / safe)
        b = np.where(small, 0.5 * theta, (1.0 - np.cos(theta)) / safe)
        x, y = a * xi[:, 0] - b * xi[:, 1], b * xi[:, 0] + a * xi[:, 1]
        return planar_poses(np.stack([x, y, theta], axis=1))

    def log(self, T: Array) -> Array:
        """Tangent vectors (..., 3) of poses (..., 3, 3)."""
        theta = np.arctan2(T[..., 1, 0], T[..., 0, 0])
        half = 0.5 * theta
        # half / tan(half), whose series is 1 - half^2 / 3
        small = np.abs(theta) < _SMALL_ANGLE
        a = np.where(small, 1.0 - half**2 / 3.0, half / np.tan(np.where(small, 1.0, half)))
        x, y = T[..., 0, 2], T[..., 1, 2]
        return np.stack([a * x + half * y, a * y - half * x, theta], axis=-1)

    def adjoint(self, T: Array) -> Array:
        """Adjoints (..., 3, 3) of poses (..., 3, 3)."""
        Ad = T.copy()
        Ad[..., 0, 2], Ad[..., 1, 2] = T[..., 1, 2], -T[..., 0, 2]
        return Ad


class SE3:
    """Rigid motions of space; see `odometry.se3`."""

    size, dof = 4, 6
    rotation, translation = slice(0, 3), slice(3, 6)

    def exp(self, xi: Array) -> Array:
        """Motions (M, 4, 4) of tangent vectors (M, 6)."""
        return se3.exp(xi)

    def log(self, T: Array) -> Array:
        """Tangent vectors (..., 6) of poses (..., 4, 4)."""
        return se3.log(T)

    def adjoint(self, T: Array) -> Array:
        """Adjoints (..., 6, 6) of poses (..., 4, 4)."""
        return se3.adjoint(T)


def planar_poses(numbers: Array) -> Array:
    """Poses (M, 3, 3) of the plane of (M, 3): x, y in metres, heading in radians."""
    cosine, sine = np.cos(numbers[:, 2]), np.sin(numbers[:, 2])
    poses = np.tile(np.eye(3), (len(numbers), 1, 1))
    poses[:, :2, 0] = np.stack([cosine, sine], axis=1)
    poses[:, :2, 1] = np.stack([-sine, cosine], axis=1)
    poses[:, :2, 2] = numbers[:, :2]
    return poses


def group_of(poses: Array) -> LieGroup:
    """Group of poses (..., 3, 3) or (..., 4, 4)."""
    return SE2() if poses.shape[-1] == 3 else SE3()


def compose(first: Array, steps: Array) -> Array:
    """Poses (N + 1, n, n) that N steps (N, n, n) lead to from the first (n, n), one after the other."""
    poses = np.empty((len(steps) + 1, *first.shape))
    poses[0] = first
    for k, step in enumerate(steps):
        poses[k + 1] = poses[k] @ step
    return poses
