"""Odometry drift: the covariance of odometry between any two frames, in constant time.

Errors are moved to the world frame, where they add up: the covariance of the chain i..j is the difference of
two prefix sums. Three parts are summed: the covariance that odometry states, a random walk, and a bias that lasts for
the whole path. The last two are needed because frame-to-frame covariances do not contain errors that persist: on real
recordings the squared error after fifty frames is ten to a thousand times their sum.

Derivation: docs/math.md; figures: docs/decisions/odometry_covariance.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from place_recognition.growing_array import GrowingArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OdometryDriftModel:
    """Errors of odometry beyond its own covariance, one standard deviation.

    Attributes:
        sigma_m_per_m: error of the position, metres for a metre of path.
        sigma_rad_per_m: error of the direction, radians for a metre of path.
        correlation_length_m: path over which the errors of the random walk keep their sign, metres.
    """

    sigma_m_per_m: float = 0.01
    sigma_rad_per_m: float = 1e-4
    correlation_length_m: float = 10.0

    @property
    def variances(self) -> Array:
        """(6,) squared rates for a metre of path, rotation first."""
        return np.repeat([self.sigma_rad_per_m**2, self.sigma_m_per_m**2], 3)

    def of_motion(self, T_previous_current: Array, covariance: Array) -> Array:
        """Covariance (6, 6) of one motion (4, 4): the stated one (6, 6) and its share of the random walk."""
        step = float(np.linalg.norm(T_previous_current[:3, 3]))
        # Errors whose correlation decays over a length c sum up to a random walk of 2 c times their variance a metre.
        return covariance + np.diag(2.0 * self.correlation_length_m * step * self.variances)


@dataclass(frozen=True)
class RelativeMotion:
    """Relative pose of two frames by odometry.

    Attributes:
        T_first_second: (4, 4) second camera in the first one's frame, metres.
        covariance: (6, 6) of its right perturbation, rotation first, drift model included.
        path_length_m: length of the path between the two frames, metres.
    """

    T_first_second: Array
    covariance: Array
    path_length_m: float


def chain_motions(motions: Sequence[Array]) -> Array:
    """Poses (N, 4, 4), the first the identity, of N - 1 motions (4, 4)."""
    poses = [np.eye(4)]
    for T_previous_current in motions:
        poses.append(poses[-1] @ T_previous_current)
    return np.array(poses)


class OdometryChain:
    """Poses by odometry alone, and the uncertainty between any two of them.

    First-order propagation (Barfoot, State Estimation for Robotics, section 7.3) by prefix sums in the world frame.
    """

    def __init__(self, model: OdometryDriftModel) -> None:
        self._model = model
        self._poses, self._path_length = GrowingArray(np.float64), GrowingArray(np.float64)
        self._independent = GrowingArray(np.float64)  # covariance (N, 6, 6) of independent errors, world frame
        # Jacobian (N, 6, 6) of the pose, in the world, by a constant error per metre.
        self._bias_jacobian = GrowingArray(np.float64)
        self._append(np.eye(4), 0.0, np.zeros((6, 6)), np.zeros((6, 6)))

    def __len__(self) -> int:
        return len(self._poses)

    def __getitem__(self, frame: int) -> Array:
        return self._poses.rows[frame]

    @property
    def poses(self) -> Array:
        """T_world_camera (N, 4, 4), metres, first pose the identity."""
        return self._poses.rows.copy()

    def poses_of(self, frames: NDArray[np.int64]) -> Array:
        """T_world_camera (M, 4, 4) of some frames (M,), metres."""
        return np.asarray(self._poses.rows[frames])

    @property
    def last(self) -> Array:
        """T_world_camera (4, 4) of the newest frame."""
        return self._poses.rows[-1]

    def covariances(self) -> Array:
        """Covariances (N, 6, 6) of all frames against the first one, as `between` gives them."""
        return np.array([self.between(0, frame).covariance for frame in range(len(self))])

    def bias_sigmas(self) -> Array:
        """(N - 1, 6) standard deviation of the bias's error in each motion, rotation first."""
        return np.diff(self._path_length.rows)[:, None] * np.sqrt(self._model.variances)

    def append(self, T_previous_current: Array, covariance: Array) -> None:
        """Add a motion (4, 4) with its stated covariance (6, 6) of the right perturbation, rotation first."""
        step = float(np.linalg.norm(T_previous_current[:3, 3]))
        pose = self.last @ T_previous_current
        Ad = se3.adjoint(pose)
        covariance = self._model.of_motion(T_previous_current, covariance)
        independent = self._independent.rows[-1] + Ad @ covariance @ Ad.T
        path_length = self._path_length.rows[-1] + step
        self._append(pose, path_length, independent, self._bias_jacobian.rows[-1] + step * Ad)

    def path_length_m(self, frame: int) -> float:
        """Length of the path up to a frame, metres."""
        return float(self._path_length.rows[frame])

    def bias_covariance(self, first: int, second: int) -> Array:
        """Covariance (6, 6) of the second frame, in its own frame, by the bias since the first frame alone."""
        jacobian = self._bias_jacobian.rows[second] - self._bias_jacobian.rows[first]
        Ad = se3.adjoint(se3.inverse(self[second]))
        return Ad @ (jacobian * self._model.variances) @ jacobian.T @ Ad.T

    def between_without_bias(self, first: int, second: int) -> RelativeMotion:
        """As `between` for first < second, without the bias: only the independent errors of the motions."""
        independent = self._independent.rows[second] - self._independent.rows[first]
        Ad = se3.adjoint(se3.inverse(self[second]))
        T = se3.inverse(self[first]) @ self[second]
        return RelativeMotion(T, Ad @ independent @ Ad.T, self.path_length_m(second) - self.path_length_m(first))

    def between(self, first: int, second: int) -> RelativeMotion:
        """Relative pose of two frames with its covariance; takes the same time however far apart they are."""
        if first > second:
            return _reverse(self.between(second, first))
        motion = self.between_without_bias(first, second)
        return replace(motion, covariance=motion.covariance + self.bias_covariance(first, second))

    def _append(self, pose: Array, path_length_m: float, independent: Array, bias_jacobian: Array) -> None:
        self._poses.extend(pose[None])
        self._path_length.extend(np.array([path_length_m]))
        self._independent.extend(independent[None])
        self._bias_jacobian.extend(bias_jacobian[None])


def _reverse(motion: RelativeMotion) -> RelativeMotion:
    Ad = se3.adjoint(motion.T_first_second)
    return RelativeMotion(se3.inverse(motion.T_first_second), Ad @ motion.covariance @ Ad.T, motion.path_length_m)
