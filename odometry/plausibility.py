"""Whether a measured motion can be believed."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from odometry import se3

Array = NDArray[np.float64]


class Estimate(Protocol):
    """A motion that was measured, and how well: see `odometry.two_views.TwoViewEstimate`."""

    @property
    def T_first_second(self) -> Array:
        """(4, 4), metres."""
        ...

    @property
    def covariance(self) -> Array:
        """(6, 6) of the right perturbation."""
        ...

    @property
    def inliers(self) -> NDArray[np.bool_]:
        """(N,) the tracks that agree."""
        ...

    @property
    def noise_px(self) -> float:
        """Of a measurement, pixels."""
        ...


@dataclass(frozen=True)
class PlausibilityConfig:
    """What a motion must show to be believed.

    Attributes:
        tracks: fewest tracks, and fewest of them that agree.
        ratio: least share of tracks that agree.
        expected_ratio: least share that agrees with what was expected: most of the view may be another car.
        sure_ratio: share that is believed even against all expectation, as after a gap in the recording.
        surprise: share of a jump from which on it is asked whether a minority moves as expected.
        jump_m: largest unexpected translation otherwise, metres.
        jump_rad: largest unexpected rotation otherwise, radians.
        braking_mps2: largest deceleration of a car, metres per second squared.
        noise_px: largest noise of the measurements, pixels.
        moving_m: least translation that is called driving, metres.

    """

    tracks: int = 20
    ratio: float = 0.35
    expected_ratio: float = 0.15
    sure_ratio: float = 0.6
    surprise: float = 0.2
    jump_m: float = 0.5
    jump_rad: float = 0.05
    braking_mps2: float = 10.0
    noise_px: float = 1.5
    moving_m: float = 0.1


@dataclass(frozen=True)
class Expectation:
    """What is expected of a pair before it is looked at.

    Attributes:
        T: (4, 4) T_reference_pair, metres.
        steps: images since the reference or the last one measured: so much weaker is what is expected.
        unmeasured: images since the last measurement, whatever the reference, this one included.
        interval: seconds between two images.
        way: what the camera drives if it holds the lower of its last two speeds, metres: the higher one may be
            that of a gap in the recording.

    """

    T: Array
    steps: int = 1
    unmeasured: int = 1
    interval: float = 0.1
    way: float = float("inf")


STOPS = "most of the view does not move although the camera was driving a moment ago"


def doubt(estimate: Estimate | None, expected: Expectation | None, config: PlausibilityConfig) -> str:
    """Why an estimate is not to be believed, in words; empty if it is.

    No estimate stands for too few tracks; no expectation for a motion that nothing is known about.
    """
    if estimate is None:
        return f"fewer than {config.tracks} points could be followed"
    agree, ratio = int(estimate.inliers.sum()), float(np.mean(estimate.inliers))
    if not np.isfinite(estimate.T_first_second).all() or not np.isfinite(estimate.covariance).all():
        return "the adjustment did not converge"
    least = (
        config.ratio if expected is None or jump(estimate.T_first_second, expected.T, config) else config.expected_ratio
    )
    if agree < config.tracks or ratio < least:
        return f"only {agree} of {len(estimate.inliers)} points agree on one motion"
    if estimate.noise_px > config.noise_px:
        return f"the points agree only to {estimate.noise_px:.1f} px"
    if expected is None:
        return ""
    if brakes(estimate.T_first_second, expected, config):
        return STOPS
    return "" if ratio >= config.sure_ratio else jump(estimate.T_first_second, expected.T, config, expected.steps)


def brakes(T: Array, expected: Expectation, config: PlausibilityConfig) -> bool:
    """Whether a motion falls short of the expected one by half, by more than brakes can do, or goes sideways.

    Then something else fills the view: what keeps its distance from the camera seems to stand still. A camera that
    goes back at once is none of that: the recording was cut there.
    """
    ahead = float(np.linalg.norm(expected.T[:3, 3]))
    way = min(ahead, expected.way)
    progress = float(T[:3, 3] @ expected.T[:3, 3]) / max(ahead, config.moving_m)
    sideways = float(np.linalg.norm(T[:3, 3] - progress * expected.T[:3, 3] / max(ahead, config.moving_m)))
    slower = config.braking_mps2 * expected.interval * expected.unmeasured
    limit = slower * expected.interval * expected.steps + config.moving_m
    skids = way > config.jump_m * expected.steps and sideways > max(progress, limit)
    stops = way - progress > max(0.5 * way, limit) and progress > -max(0.25 * way, config.jump_m * expected.steps)
    return bool(stops or skids)


def distance(T: Array, T_expected: Array, config: PlausibilityConfig) -> float:
    """How far a motion is from the expected one, in jumps."""
    off = se3.inverse(T_expected) @ T
    return max(float(np.linalg.norm(off[:3, 3])) / config.jump_m, se3.angle(off) / config.jump_rad)


def jump(T: Array, T_expected: Array, config: PlausibilityConfig, steps: int = 1) -> str:
    """Why a motion over some images that a minority contradicts is too far from the expected one; empty if not."""
    if distance(T, T_expected, config) <= steps:
        return ""
    off = se3.inverse(T_expected) @ T
    shift, turn = float(np.linalg.norm(off[:3, 3])), se3.angle(off)
    return f"a jump of {shift:.1f} m and {np.degrees(turn):.1f} degrees that many points contradict"
