"""Checks that a measured motion must pass: enough agreement, low noise, and what a vehicle can do.

A check returns the reason for a rejection in words, or None if the motion passes.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from odometry import se3

Array = NDArray[np.float64]

IMPLAUSIBLE_STOP = "most of the view does not move although the camera was driving a moment ago"


class MotionEstimate(Protocol):
    """A measured motion with its uncertainty, of a stereo pair (`TwoViewEstimate`) or one camera (`PoseEstimate`)."""

    @property
    def T_first_second(self) -> Array:
        """Second camera in the first camera's frame (4, 4), metres."""
        ...

    @property
    def covariance(self) -> Array:
        """Covariance (6, 6) of the right perturbation, rotation first (rad, m)."""
        ...

    @property
    def inliers(self) -> NDArray[np.bool_]:
        """Mask (N,) of the tracks that agree with the motion."""
        ...

    @property
    def noise_px(self) -> float:
        """Standard deviation of one measurement, pixels."""
        ...


@dataclass(frozen=True)
class MotionCheckConfig:
    """Thresholds of the checks that a measured motion must pass.

    Attributes:
        min_tracks: smallest number of tracks, and of tracks that agree with the motion.
        min_inlier_ratio: smallest share of tracks that must agree.
        min_expected_inlier_ratio: smallest share that must agree with a motion that was predicted: most of the view
            may belong to another vehicle.
        certain_inlier_ratio: share from which on any motion is accepted, as after a gap in the recording.
        min_followed_ratio: share of the reference frame's points that must agree with a motion; where fewer do, wider
            searches are tried too. A car's motion can be predicted, so that 0 serves it.
        minority_search_ratio: deviation from the prediction, as a share of the largest jump, from which on the odometry
            looks for a minority of tracks that moves as predicted.
        max_jump_m: largest deviation of the translation from the predicted one, metres for each image.
        max_jump_rad: largest deviation of the rotation from the predicted one, radians for each image.
        max_deceleration_mps2: largest deceleration of a car, metres per second squared.
        max_noise_px: largest noise of the measurements, pixels.
        min_moving_m: translation above which the camera counts as moving, metres.
    """

    min_tracks: int = 20
    min_inlier_ratio: float = 0.35
    min_expected_inlier_ratio: float = 0.15
    certain_inlier_ratio: float = 0.6
    min_followed_ratio: float = 0.0
    minority_search_ratio: float = 0.2
    max_jump_m: float = 0.5
    max_jump_rad: float = 0.05
    max_deceleration_mps2: float = 10.0
    max_noise_px: float = 1.5
    min_moving_m: float = 0.1


@dataclass(frozen=True)
class MotionPrediction:
    """The motion that is predicted for an image before it is measured.

    Attributes:
        T_reference_current: (4, 4) predicted pose of the image in the reference frame, metres.
        frames: images since the reference frame, or since the last one measured from it; the tolerance grows with it.
        unmeasured_frames: images since the last measurement from any reference frame, this one included.
        frame_interval_s: time between two images, seconds.
        distance_m: distance that the camera covers at the lower of its last two speeds, metres; the higher one may
            be that of a gap in the recording.
    """

    T_reference_current: Array
    frames: int = 1
    unmeasured_frames: int = 1
    frame_interval_s: float = 0.1
    distance_m: float = float("inf")


def rejection_reason(
    estimate: MotionEstimate | None, predicted: MotionPrediction | None, config: MotionCheckConfig
) -> str | None:
    """Reason for which an estimate must be rejected, or None if it passes all checks.

    No estimate stands for too few tracks, no prediction for a motion that nothing is known about.
    """
    if estimate is None:
        return f"fewer than {config.min_tracks} points could be followed"
    agree, ratio = int(estimate.inliers.sum()), float(np.mean(estimate.inliers))
    if not np.isfinite(estimate.T_first_second).all() or not np.isfinite(estimate.covariance).all():
        return "the adjustment did not converge"
    if agree < config.min_tracks or ratio < _min_inlier_ratio(estimate, predicted, config):
        return f"only {agree} of {len(estimate.inliers)} points agree on one motion"
    if estimate.noise_px > config.max_noise_px:
        return f"the points agree only to {estimate.noise_px:.1f} px"
    if predicted is None:
        return None
    if stops_implausibly(estimate.T_first_second, predicted, config):
        return IMPLAUSIBLE_STOP
    if ratio >= config.certain_inlier_ratio:
        return None
    return jump_reason(estimate.T_first_second, predicted.T_reference_current, config, predicted.frames)


def _min_inlier_ratio(estimate: MotionEstimate, predicted: MotionPrediction | None, config: MotionCheckConfig) -> float:
    """Smallest share of inliers that an estimate needs: a smaller one where it agrees with the prediction."""
    is_unexpected = predicted is None or jump_reason(estimate.T_first_second, predicted.T_reference_current, config)
    return config.min_inlier_ratio if is_unexpected else config.min_expected_inlier_ratio


def stops_implausibly(T: Array, predicted: MotionPrediction, config: MotionCheckConfig) -> bool:
    """Whether a motion falls short of the predicted one by half, and by more than brakes allow, or goes sideways.

    Then something else fills the view: a vehicle that keeps its distance from the camera seems to stand still.
    A sudden jump backwards is not a stop: the recording was cut there.
    """
    T_predicted = predicted.T_reference_current
    ahead = float(np.linalg.norm(T_predicted[:3, 3]))
    distance_m = min(ahead, predicted.distance_m)
    progress = float(T[:3, 3] @ T_predicted[:3, 3]) / max(ahead, config.min_moving_m)
    sideways = float(np.linalg.norm(T[:3, 3] - progress * T_predicted[:3, 3] / max(ahead, config.min_moving_m)))
    slower = config.max_deceleration_mps2 * predicted.frame_interval_s * predicted.unmeasured_frames
    limit = slower * predicted.frame_interval_s * predicted.frames + config.min_moving_m
    max_jump_m = config.max_jump_m * predicted.frames
    skids = distance_m > max_jump_m and sideways > max(progress, limit)
    falls_short = distance_m - progress > max(0.5 * distance_m, limit)
    return bool(skids or (falls_short and progress > -max(0.25 * distance_m, max_jump_m)))


def deviation_in_jumps(T: Array, T_predicted: Array, config: MotionCheckConfig) -> float:
    """Deviation of a motion from the predicted one, in units of the largest jump."""
    off = se3.inverse(T_predicted) @ T
    return max(float(np.linalg.norm(off[:3, 3])) / config.max_jump_m, se3.angle(off) / config.max_jump_rad)


def jump_reason(T: Array, T_predicted: Array, config: MotionCheckConfig, frames: int = 1) -> str | None:
    """Reason to reject a motion over some images that is too far from the predicted one, or None if it is near."""
    if deviation_in_jumps(T, T_predicted, config) <= frames:
        return None
    off = se3.inverse(T_predicted) @ T
    shift, turn = float(np.linalg.norm(off[:3, 3])), se3.angle(off)
    return f"a jump of {shift:.1f} m and {np.degrees(turn):.1f} degrees that many points contradict"
