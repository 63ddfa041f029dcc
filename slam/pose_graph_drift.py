"""How far odometry alone may have drifted between any two frames, in constant time.

Errors are moved to the world frame, where they add up: the covariance of the chain i..j is the difference of
two prefix sums. Three parts are summed: what the odometry states, a random walk and a bias that lasts all the
way. The last two are needed because frame-to-frame covariances know nothing of errors that persist: on real
drives the squared error after fifty frames is ten to a thousand times what they add up to.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from odometry import se3

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DriftBudget:
    """How wrong odometry may be beyond its own covariance, one standard deviation."""

    translation: float = 0.01  # metres of position for a metre of way
    rotation: float = 1e-4  # radians of direction for a metre of way
    correlation_m: float = 10.0  # way over which passing errors keep their sign, metres

    @property
    def variances(self) -> Array:
        """(6,) squared rates for a metre of way, rotation first."""
        return np.repeat([self.rotation**2, self.translation**2], 3)

    def of_motion(self, T_previous_current: Array, covariance: Array) -> Array:
        """Covariance (6, 6) of one motion with its share of the random walk; a stated one (6, 6) goes in."""
        step = float(np.linalg.norm(T_previous_current[:3, 3]))
        return covariance + np.diag(2.0 * self.correlation_m * step * self.variances)


@dataclass(frozen=True)
class Between:
    """What odometry says about two frames.

    Attributes:
        T_first_second: (4, 4) second camera in the first one's frame, metres.
        covariance: (6, 6) of its right perturbation, rotation first, drift budget included.
        way: driven between the two, metres.
    """

    T_first_second: Array
    covariance: Array
    way: float


def chained(motions: Sequence[Array]) -> Array:
    """Poses (N, 4, 4), the first the identity, of N - 1 motions (4, 4)."""
    poses = [np.eye(4)]
    for T_previous_current in motions:
        poses.append(poses[-1] @ T_previous_current)
    return np.array(poses)


class OdometryChain:
    """The poses that odometry alone gives, and the uncertainty between any two of them.

    First-order propagation (Barfoot, State Estimation for Robotics, section 7.3) by prefix sums in the world.
    """

    def __init__(self, budget: DriftBudget) -> None:
        self._budget = budget
        self._poses = [np.eye(4)]
        self._way = [0.0]
        self._scatter = [np.zeros((6, 6))]  # covariance of independent errors, world frame
        self._lever = [np.zeros((6, 6))]  # effect in the world of a constant error per metre in the camera

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def poses(self) -> Array:
        """T_world_camera (N, 4, 4), metres, first pose the identity."""
        return np.array(self._poses)

    @property
    def last(self) -> Array:
        """T_world_camera (4, 4) of the newest frame."""
        return self._poses[-1]

    def covariances(self) -> Array:
        """Covariances (N, 6, 6) of all frames against the first one, as `between` gives them."""
        return np.array([self.between(0, frame).covariance for frame in range(len(self))])

    def lasting_sigmas(self) -> Array:
        """(N - 1, 6) standard deviations of the lasting error of each motion, rotation first."""
        return np.diff(self._way)[:, None] * np.sqrt(self._budget.variances)

    def append(self, T_previous_current: Array, covariance: Array) -> None:
        """Add a motion (4, 4) with its stated covariance (6, 6) of the right perturbation, rotation first."""
        step = float(np.linalg.norm(T_previous_current[:3, 3]))
        pose = self._poses[-1] @ T_previous_current
        Ad = se3.adjoint(pose)
        covariance = self._budget.of_motion(T_previous_current, covariance)
        self._poses.append(pose)
        self._way.append(self._way[-1] + step)
        self._scatter.append(self._scatter[-1] + Ad @ covariance @ Ad.T)
        self._lever.append(self._lever[-1] + step * Ad)

    def way(self, frame: int) -> float:
        """Metres driven up to a frame."""
        return self._way[frame]

    def lasting(self, first: int, second: int) -> Array:
        """Covariance (6, 6) of frame second in its own frame by the lasting bias since frame first alone."""
        lever = self._lever[second] - self._lever[first]
        Ad = se3.adjoint(se3.inverse(self._poses[second]))
        return Ad @ (lever * self._budget.variances) @ lever.T @ Ad.T

    def __getitem__(self, frame: int) -> Array:
        return self._poses[frame]

    def passing(self, first: int, second: int) -> Between:
        """As `between` for first < second, without the bias that lasts."""
        scatter = self._scatter[second] - self._scatter[first]
        Ad = se3.adjoint(se3.inverse(self._poses[second]))
        T = se3.inverse(self._poses[first]) @ self._poses[second]
        return Between(T, Ad @ scatter @ Ad.T, self._way[second] - self._way[first])

    def between(self, first: int, second: int) -> Between:
        """Relative pose of two frames with its uncertainty; the time taken does not grow with the way."""
        if first > second:
            return _turned(self.between(second, first))
        passing = self.passing(first, second)
        return replace(passing, covariance=passing.covariance + self.lasting(first, second))


def _turned(between: Between) -> Between:
    Ad = se3.adjoint(between.T_first_second)
    return Between(se3.inverse(between.T_first_second), Ad @ between.covariance @ Ad.T, between.way)
