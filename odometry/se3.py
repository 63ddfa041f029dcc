"""Rigid motions SE(3) as (4, 4) matrices or stacks of them (..., 4, 4), and their tangent space.

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

_SMALL_ANGLE = 1e-6  # rad; below it the first terms of the series are exact to double precision
_SMALL_ANGLE_OF_LOG = 1e-4  # rad; the next term of the inverse Jacobian's series is angle^4 / 720


def skew(w: Array) -> Array:
    """Skew-symmetric matrices (..., 3, 3) with `skew(w) @ p == cross(w, p)`, for w (..., 3)."""
    out = np.zeros((*w.shape[:-1], 3, 3))
    out[..., 2, 1], out[..., 0, 2], out[..., 1, 0] = w[..., 0], w[..., 1], w[..., 2]
    out[..., 1, 2], out[..., 2, 0], out[..., 0, 1] = -w[..., 0], -w[..., 1], -w[..., 2]
    return out


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
    out = np.empty((3, 3))
    _set_left_jacobian(w[0], w[1], w[2], out)
    return out


@njit(cache=True)
def _set_left_jacobian(x: float, y: float, z: float, out: Array) -> None:
    """Set `out` (3, 3) to the left Jacobian at the rotation vector (x, y, z), radians."""
    angle = np.sqrt(x**2 + y**2 + z**2)
    a, b = 0.5, 1.0 / 6.0
    if angle >= _SMALL_ANGLE:
        a = (1.0 - np.cos(angle)) / angle**2
        b = (angle - np.sin(angle)) / angle**3
    _set_series(x, y, z, a, b, out)


@njit(cache=True)
def _set_series(x: float, y: float, z: float, a: float, b: float, out: Array) -> None:
    """Set the upper left (3, 3) of `out` to `I + a skew(w) + b skew(w)²`, w = (x, y, z)."""
    rest = 1.0 - b * (x * x + y * y + z * z)
    out[0, 0], out[0, 1], out[0, 2] = rest + b * x * x, b * x * y - a * z, b * x * z + a * y
    out[1, 0], out[1, 1], out[1, 2] = b * x * y + a * z, rest + b * y * y, b * y * z - a * x
    out[2, 0], out[2, 1], out[2, 2] = b * x * z - a * y, b * y * z + a * x, rest + b * z * z


@njit(cache=True)
def _exp(xi: Array) -> Array:
    """Poses (M, 4, 4) of tangent vectors (M, 6)."""
    out, J = np.zeros((len(xi), 4, 4)), np.empty((3, 3))
    for i in range(len(xi)):
        x, y, z = xi[i, 0], xi[i, 1], xi[i, 2]
        angle = np.sqrt(x**2 + y**2 + z**2)
        a, b = 1.0, 0.5
        if angle >= _SMALL_ANGLE:
            a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle**2
        _set_series(x, y, z, a, b, out[i])
        _set_left_jacobian(x, y, z, J)
        for j in range(3):
            out[i, j, 3] = J[j, 0] * xi[i, 3] + J[j, 1] * xi[i, 4] + J[j, 2] * xi[i, 5]
        out[i, 3, 3] = 1.0
    return out


@njit(cache=True)
def _log_translations(w: Array, t: Array) -> Array:
    """Second half (M, 3) of the logarithms of poses, from rotation vectors (M, 3) and translations (M, 3).

    The inverse of the left Jacobian, `I - skew(w) / 2 + c skew(w)²`, times the translation.
    """
    out = np.empty_like(t)
    for i in range(len(w)):
        x, y, z = w[i]
        angle = np.sqrt(x**2 + y**2 + z**2)
        c = 1.0 / 12.0
        if angle >= _SMALL_ANGLE_OF_LOG:
            c = (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
        p, q, r = y * t[i, 2] - z * t[i, 1], z * t[i, 0] - x * t[i, 2], x * t[i, 1] - y * t[i, 0]
        out[i, 0] = t[i, 0] - 0.5 * p + c * (y * r - z * q)
        out[i, 1] = t[i, 1] - 0.5 * q + c * (z * p - x * r)
        out[i, 2] = t[i, 2] - 0.5 * r + c * (x * q - y * p)
    return out


def exp(xi: Array) -> Array:
    """Poses (..., 4, 4) of tangent vectors xi (..., 6): rotation, then translation."""
    xi = np.asarray(xi, dtype=np.float64)
    return np.asarray(_exp(xi.reshape(-1, 6))).reshape(*xi.shape[:-1], 4, 4)


def log(T: Array) -> Array:
    """Tangent vectors (..., 6) of poses (..., 4, 4), the inverse of `exp` for angles below pi."""
    if T.ndim == 2:
        # Solving is as fast as the closed form for one pose, and the odometry's figures rest on its rounding.
        w = Rotation.from_matrix(T[:3, :3]).as_rotvec()
        return np.concatenate([w, np.linalg.solve(left_jacobian(w), T[:3, 3])])
    flat = T.reshape(-1, 4, 4)
    if not len(flat):
        return np.zeros((*T.shape[:-2], 6))
    w = Rotation.from_matrix(flat[:, :3, :3]).as_rotvec()
    v = _log_translations(w, np.ascontiguousarray(flat[:, :3, 3]))
    return np.concatenate([w, v], axis=1).reshape(*T.shape[:-2], 6)


def adjoint(T: Array) -> Array:
    """Adjoints (..., 6, 6) of poses (..., 4, 4): `T @ exp(xi) == exp(adjoint(T) @ xi) @ T`."""
    R, t = T[..., :3, :3], T[..., :3, 3]
    Ad = np.zeros((*T.shape[:-2], 6, 6))
    Ad[..., :3, :3] = Ad[..., 3:, 3:] = R
    Ad[..., 3:, :3] = skew(t) @ R
    return Ad


def compose_covariance(covariance_a: Array, T_b: Array, covariance_b: Array) -> Array:
    """Covariance (6, 6) of `T_a @ T_b` to first order, the errors of the two motions being independent."""
    Ad = adjoint(inverse(T_b))
    return Ad @ covariance_a @ Ad.T + covariance_b


def angle(T: Array) -> float:
    """Rotation angle of a pose (4, 4), radians, in [0, pi]."""
    return float(np.linalg.norm(Rotation.from_matrix(T[:3, :3]).as_rotvec()))
