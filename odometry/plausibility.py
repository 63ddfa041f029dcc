"""Whether a measured motion can be believed."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.two_views import TwoViewEstimate

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlausibilityConfig:
    """What a motion must show to be believed.

    Attributes:
        tracks: fewest tracks, and fewest of them that agree.
        ratio: least share of tracks that agree.
        expected_ratio: least share that agrees with what was expected: most of the view may be another car.
        sure_ratio: share that is believed even against all expectation, as after a gap in the recording.
        jump_m: largest unexpected translation otherwise, metres.
        jump_rad: largest unexpected rotation otherwise, radians.
        noise_px: largest noise of the measurements, pixels.
        moving_m: least translation that is called driving, metres.

    """

    tracks: int = 20
    ratio: float = 0.35
    expected_ratio: float = 0.15
    sure_ratio: float = 0.6
    jump_m: float = 0.5
    jump_rad: float = 0.05
    noise_px: float = 1.5
    moving_m: float = 0.1


def doubt(estimate: TwoViewEstimate | None, T_expected: Array | None, config: PlausibilityConfig) -> str:
    """Why an estimate is not to be believed, in words; empty if it is.

    No estimate stands for too few tracks; no expected motion (4, 4) for one that nothing is known about.
    """
    if estimate is None:
        return f"fewer than {config.tracks} points could be followed"
    agree, ratio = int(estimate.inliers.sum()), float(np.mean(estimate.inliers))
    if not np.isfinite(estimate.T_first_second).all() or not np.isfinite(estimate.covariance).all():
        return "the adjustment did not converge"
    unexpected = "" if T_expected is None else jump(estimate.T_first_second, T_expected, config)
    if agree < config.tracks or ratio < (config.ratio if T_expected is None or unexpected else config.expected_ratio):
        return f"only {agree} of {len(estimate.inliers)} points agree on one motion"
    if estimate.noise_px > config.noise_px:
        return f"the points agree only to {estimate.noise_px:.1f} px"
    return "" if ratio >= config.sure_ratio else unexpected


def jump(T: Array, T_expected: Array, config: PlausibilityConfig) -> str:
    """Why a motion that a minority contradicts is too far from the expected one; empty if it is not."""
    off = se3.inverse(T_expected) @ T
    shift, turn = float(np.linalg.norm(off[:3, 3])), se3.angle(off)
    if shift <= config.jump_m and turn <= config.jump_rad:
        return ""
    return f"a jump of {shift:.1f} m and {np.degrees(turn):.1f} degrees that many points contradict"
