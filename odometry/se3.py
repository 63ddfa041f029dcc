"""Rigid motions SE(3) as (4, 4) matrices, and their tangent space.

Tangent vectors xi (6,) hold rotation first, then translation: (wx, wy, wz, vx, vy, vz), radians and metres,
in the body frame: a perturbed pose is `T @ exp(xi)` (the order and side that GTSAM's Pose3 uses; g2o files
have translation first). Covariances (6, 6) use the same order. Formulas: Barfoot, State Estimation for
Robotics (2017), section 7.1.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

_SMALL_ANGLE = 1e-6  # rad; below it the series are exact to double precision


def skew(w: Array) -> Array:
    """Skew-symmetric matrix (3, 3) with `hat(w) @ p == cross(w, p)`, for w (3,)."""
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def pose(R: Array, t: Array) -> Array:
    """Assemble a pose (4, 4) from rotation (3, 3) and translation (3,), metres."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return T


def inverse(T: Array) -> Array:
    """Invert one pose (4, 4) or a stack of them (..., 4, 4); or of the plane, (..., 3, 3)."""
    Rt = np.swapaxes(T[..., :-1, :-1], -1, -2)
    out = np.zeros_like(T)
    out[..., :-1, :-1] = Rt
    out[..., :-1, -1] = -(Rt @ T[..., :-1, -1:])[..., 0]
    out[..., -1, -1] = 1.0
    return out


def orthonormalize(T: Array) -> Array:
    """Poses (..., 4, 4) with exact rotations again: in `T @ inverse(T) @ T` rounding errors treble, round by round."""
    T = T.copy()
    T[..., :3, :3] = Rotation.from_matrix(T[..., :3, :3].reshape(-1, 3, 3)).as_matrix().reshape(T[..., :3, :3].shape)
    return T


def transform(T_a_b: Array, points_b: Array) -> Array:
    """Points (N, 3) of frame b expressed in frame a."""
    return points_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]


@njit(cache=True)
def left_jacobian(w: Array) -> Array:
    """Left Jacobian (3, 3) of SO(3) at the rotation vector w (3,), radians."""
    angle = np.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    a, b = 0.5, 1.0 / 6.0
    if angle >= _SMALL_ANGLE:
        a = (1.0 - np.cos(angle)) / angle**2
        b = (angle - np.sin(angle)) / angle**3
    return _series(w, a, b)


@njit(cache=True)
def _series(w: Array, a: float, b: float) -> Array:
    """Sum up `I + a hat(w) + b hat(w)²`, (3, 3)."""
    x, y, z = w
    rest = 1.0 - b * (x * x + y * y + z * z)
    return np.array(
        [
            [rest + b * x * x, b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, rest + b * y * y, b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, rest + b * z * z],
        ]
    )


@njit(cache=True)
def _exp(xi: Array) -> Array:
    w, angle = xi[:3], np.sqrt(xi[0] ** 2 + xi[1] ** 2 + xi[2] ** 2)
    a, b = 1.0, 0.5
    if angle >= _SMALL_ANGLE:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
    T = np.eye(4)
    T[:3, :3] = _series(w, a, b)
    J = left_jacobian(w)
    for j in range(3):
        T[j, 3] = J[j, 0] * xi[3] + J[j, 1] * xi[4] + J[j, 2] * xi[5]
    return T


def exp(xi: Array) -> Array:
    """Pose (4, 4) of the tangent vector xi (6,): rotation, then translation."""
    return np.asarray(_exp(np.asarray(xi, dtype=np.float64)))


def log(T: Array) -> Array:
    """Tangent vector (6,) of a pose (4, 4), the inverse of `exp` for angles below pi."""
    w = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    return np.concatenate([w, np.linalg.solve(left_jacobian(w), T[:3, 3])])


def adjoint(T: Array) -> Array:
    """Adjoint (6, 6) with `T @ exp(xi) == exp(adjoint(T) @ xi) @ T`."""
    R, t = T[:3, :3], T[:3, 3]
    Ad = np.zeros((6, 6))
    Ad[:3, :3] = Ad[3:, 3:] = R
    Ad[3:, :3] = skew(t) @ R
    return Ad


def compose_covariance(covariance_a: Array, T_b: Array, covariance_b: Array) -> Array:
    """Covariance (6, 6) of `T_a @ T_b` to first order, the errors of the two motions being independent."""
    Ad = adjoint(inverse(T_b))
    return Ad @ covariance_a @ Ad.T + covariance_b


def angle(T: Array) -> float:
    """Rotation angle of a pose (4, 4), radians, in [0, pi]."""
    return float(np.linalg.norm(Rotation.from_matrix(T[:3, :3]).as_rotvec()))
