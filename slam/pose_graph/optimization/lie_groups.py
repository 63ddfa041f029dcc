"""The Lie groups of a pose graph, SE(2), SE(3) and Sim(3), as stacks of matrices for graphs with many edges.

Tangent vectors belong to right perturbations, `T @ exp(xi)`, in GTSAM's order: (x, y, theta) in the plane,
rotation first in space, metres and radians, and the logarithm of the scale last. Formulas: Barfoot, State Estimation
for Robotics (2017), chapter 7; Strasdat, Local accuracy and global consistency (2012), appendix A, for Sim(3).
"""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.se3 import inverse as inverse

Array = NDArray[np.float64]

# rad; below it the second-order series are exact to double precision: their next terms are angle^4 / 120 or smaller
_SMALL_ANGLE = 1e-4

# Nodes and weights on (0, 1) for the integral in the exponential map of Sim(3), exact to double precision for rotations
# up to pi and scales up to a factor of a hundred.
_NODES, _WEIGHTS = (part / 2 for part in np.polynomial.legendre.leggauss(12))
_NODES = _NODES + 0.5


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

    @property
    def volume_of_rotations(self) -> float:
        """Volume of all rotations, radians; of a similarity also of the scales that a false loop may have."""
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

    def inverse(self, T: Array) -> Array:
        """Inverses (..., size, size) of poses (..., size, size)."""
        ...


class SE2:
    """Rigid motions of the plane."""

    size, dof = 3, 3
    translation, rotation = slice(0, 2), slice(2, 3)
    volume_of_rotations = 2.0 * np.pi

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

    def inverse(self, T: Array) -> Array:
        """Inverses (..., 3, 3) of poses (..., 3, 3)."""
        return inverse(T)


class SE3:
    """Rigid motions of space; see `odometry.se3`."""

    size, dof = 4, 6
    rotation, translation = slice(0, 3), slice(3, 6)
    volume_of_rotations = 8.0 * np.pi**2

    def exp(self, xi: Array) -> Array:
        """Motions (M, 4, 4) of tangent vectors (M, 6)."""
        return se3.exp(xi)

    def log(self, T: Array) -> Array:
        """Tangent vectors (..., 6) of poses (..., 4, 4)."""
        return se3.log(T)

    def adjoint(self, T: Array) -> Array:
        """Adjoints (..., 6, 6) of poses (..., 4, 4)."""
        return se3.adjoint(T)

    def inverse(self, T: Array) -> Array:
        """Inverses (..., 4, 4) of poses (..., 4, 4)."""
        return inverse(T)


class Sim3:
    """Similarities of space: rotation times scale, and translation, in a matrix (4, 4).

    That of a camera takes points, in the unit of length that its depths have, to the world.
    """

    size, dof = 4, 7
    rotation, translation = slice(0, 3), slice(3, 6)
    volume_of_rotations = SE3.volume_of_rotations * 2.0 * np.log(2.0)  # scales within a factor of two either way

    def exp(self, xi: Array) -> Array:
        """Similarities (M, 4, 4) of tangent vectors (M, 7)."""
        T = np.zeros((len(xi), 4, 4))
        T[:, :3, :3] = np.exp(xi[:, 6])[:, None, None] * se3.exp(xi[:, :6])[:, :3, :3]
        T[:, :3, 3] = (_mean_turned(xi[:, :3], xi[:, 6]) @ xi[:, 3:6, None])[..., 0]
        T[:, 3, 3] = 1.0
        return T

    def log(self, T: Array) -> Array:
        """Tangent vectors (..., 7) of similarities (..., 4, 4)."""
        flat = T.reshape(-1, 4, 4)
        poses, scales = rigid_and_scale(flat)
        w, log_scale = se3.log(poses)[:, :3], np.log(scales)
        u = np.linalg.solve(_mean_turned(w, log_scale), flat[:, :3, 3:])[..., 0]
        return np.concatenate([w, u, log_scale[:, None]], axis=1).reshape(*T.shape[:-2], 7)

    def adjoint(self, T: Array) -> Array:
        """Adjoints (..., 7, 7) of similarities (..., 4, 4)."""
        poses, scales = rigid_and_scale(T)
        Ad = np.zeros((*T.shape[:-2], 7, 7))
        Ad[..., :6, :6] = se3.adjoint(poses)
        Ad[..., 3:6, 3:6] *= scales[..., None, None]
        Ad[..., 3:6, 6] = -T[..., :3, 3]
        Ad[..., 6, 6] = 1.0
        return Ad

    def inverse(self, T: Array) -> Array:
        """Inverses (..., 4, 4) of similarities (..., 4, 4)."""
        poses, scales = rigid_and_scale(T)
        out = inverse(poses)
        out[..., :3, :] /= scales[..., None, None]
        return out


def rigid_and_scale(T: Array) -> tuple[Array, Array]:
    """Rigid motions (..., 4, 4), with the same translation, and scales (...) of similarities (..., 4, 4)."""
    scales = np.cbrt(np.linalg.det(T[..., :3, :3]))
    poses = T.copy()
    poses[..., :3, :3] /= scales[..., None, None]
    return poses, scales


def similarities(poses: Array, scales: Array) -> Array:
    """Similarities (..., 4, 4) of rigid motions (..., 4, 4) and scales (...)."""
    out = poses.copy()
    out[..., :3, :3] *= scales[..., None, None]
    return out


def _mean_turned(w: Array, log_scale: Array) -> Array:
    """(M, 3, 3) mean of the rotations and scales on the way to rotation vectors (M, 3) and log scales (M,).

    The integral of exp(x log_scale) exp(x skew(w)) over x from 0 to 1, which takes the translation of a tangent vector
    to that of a similarity.
    """
    angle = np.linalg.norm(w, axis=1)[:, None]
    weights = _WEIGHTS * np.exp(_NODES * log_scale[:, None])
    # sin(x a) / a and (1 - cos(x a)) / a^2 by sinc, which is smooth where the angle a is zero
    one = (weights * _NODES * np.sinc(_NODES * angle / np.pi)).sum(axis=1)
    two = (weights * 0.5 * np.square(_NODES * np.sinc(0.5 * _NODES * angle / np.pi))).sum(axis=1)
    W = se3.skew(w)
    return np.asarray(
        weights.sum(axis=1)[:, None, None] * np.eye(3) + one[:, None, None] * W + two[:, None, None] * W @ W
    )


def planar_poses(numbers: Array) -> Array:
    """Poses (M, 3, 3) of the plane of (M, 3): x, y in metres, heading in radians."""
    cosine, sine = np.cos(numbers[:, 2]), np.sin(numbers[:, 2])
    poses = np.tile(np.eye(3), (len(numbers), 1, 1))
    poses[:, :2, 0] = np.stack([cosine, sine], axis=1)
    poses[:, :2, 1] = np.stack([-sine, cosine], axis=1)
    poses[:, :2, 2] = numbers[:, :2]
    return poses


def group_of(dof: int) -> LieGroup:
    """Group whose tangent vectors have a length of 3, 6 or 7."""
    groups: dict[int, LieGroup] = {3: SE2(), 6: SE3(), 7: Sim3()}
    return groups[dof]


def compose(first: Array, steps: Array) -> Array:
    """Poses (N + 1, n, n) that N steps (N, n, n) lead to from the first (n, n), one after the other."""
    poses = np.empty((len(steps) + 1, *first.shape))
    poses[0] = first
    for k, step in enumerate(steps):
        poses[k + 1] = poses[k] @ step
    return poses
