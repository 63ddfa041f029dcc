"""Tracking of one camera's image against a reference frame: by optical flow, then by a wider search."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry.mono.mono_bundle_adjustment import MonoBundle
from odometry.mono.mono_frontend import FollowedTracks, MonoFrontEnd, MonoTracks
from odometry.mono.motion_only_bundle_adjustment import PoseEstimate, PoseEstimationConfig, estimate_pose
from odometry.motion_checks import MotionCheckConfig, MotionPrediction, jump_reason, rejection_reason

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class MonoTrackingResult:
    """Pose of an image relative to its reference frame.

    Attributes:
        followed: points of the reference frame that the image shows.
        estimate: the measured pose; None with too few points.
        reason: reason for which the estimate must be rejected; None if it is accepted.
    """

    followed: FollowedTracks
    estimate: PoseEstimate | None
    reason: str | None


@dataclass(frozen=True)
class PosedTracks:
    """Points of an image whose pose in the map is known.

    Attributes:
        tracks: points of the image.
        T_map_camera: (4, 4) pose of its camera.
    """

    tracks: MonoTracks
    T_map_camera: Array


class MonoTracker:
    """Follows points from an image of known pose, and estimates the pose of the next image from them."""

    def __init__(
        self,
        front_end: MonoFrontEnd,
        bundle: MonoBundle,
        pose_estimation: PoseEstimationConfig,
        motion_checks: MotionCheckConfig,
    ) -> None:
        self._front_end, self._bundle = front_end, bundle
        self._pose_estimation, self._motion_checks = pose_estimation, motion_checks

    def track(self, reference: PosedTracks, image: Image, predicted: MotionPrediction | None) -> MonoTrackingResult:
        """Estimate the pose of an image (H, W) uint8, from a predicted motion since the reference if there is one."""
        guess = np.eye(4) if predicted is None else predicted.T_reference_current
        result = self._check(reference, image, guess, predicted, wide=False)
        return self._check(reference, image, guess, predicted, wide=True) if result.reason else result

    def _check(
        self, reference: PosedTracks, image: Image, guess: Array, predicted: MotionPrediction | None, wide: bool
    ) -> MonoTrackingResult:
        """Follow the points from a guess (4, 4), estimate the pose and check it."""
        followed, estimate = self._follow(reference, image, guess, wide)
        if estimate is not None and jump_reason(estimate.T_first_second, guess, self._motion_checks):
            # Tracks that had to be found far from where they were looked for are few: look again where they are.
            again, second = self._follow(reference, image, estimate.T_first_second, wide)
            if second is not None and second.inliers.sum() >= estimate.inliers.sum():
                followed, estimate = again, second
        return MonoTrackingResult(followed, estimate, rejection_reason(estimate, predicted, self._motion_checks))

    def _follow(
        self, reference: PosedTracks, image: Image, guess: Array, wide: bool
    ) -> tuple[FollowedTracks, PoseEstimate | None]:
        ahead = self._bundle.predict(reference.tracks.ids, reference.T_map_camera @ guess)
        followed = self._front_end.follow(reference.tracks, image, ahead, wide)
        if len(followed.tracks) < self._motion_checks.min_tracks:
            return followed, None
        T_map_first, config = reference.T_map_camera, self._pose_estimation
        return followed, estimate_pose(self._bundle, followed.tracks, T_map_first, guess, config)
