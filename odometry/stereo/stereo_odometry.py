"""Stereo visual odometry: from each pair of images, how the camera moved since the one before.

    odometry = StereoOdometry(camera)
    for left, right in pairs:
        T_world_camera = T_world_camera @ odometry.track(left, right).T_previous_current

There is one finite motion for every pair. Where the images do not allow a measurement, it is an extrapolation with
`Motion.predicted` set.
"""

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import StereoCamera
from odometry.klt_tracking import TrackingConfig
from odometry.motion import (
    EXTRAPOLATION_SIGMA_M,
    EXTRAPOLATION_SIGMA_RAD,
    FIRST_VARIANCE,
    FrameCounter,
    Motion,
    extrapolation_covariance,
)
from odometry.motion_checks import MotionCheckConfig, MotionPrediction
from odometry.reference_frame import Reference
from odometry.stereo.second_view import Pair, RightImage, SecondView
from odometry.stereo.sliding_window import SlidingWindow, StereoFrameObservations, WindowConfig
from odometry.stereo.stereo_frontend import StereoFrontEnd, StereoObservation
from odometry.stereo.stereo_matching import StereoMatchingConfig
from odometry.stereo.stereo_self_calibration import Calibration, CalibrationConfig
from odometry.stereo.stereo_tracking import SWAPPED, StereoTracker, TrackingResult
from odometry.stereo.two_view_adjustment import AdjustmentConfig, TwoViewEstimate

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

# Distance from an earlier reference frame, as a share of that at which one is replaced, within which the camera has
# come back to it.
_MAX_REACH_BACK = 0.7
_MAX_BLURRED = 3  # images in a row that show few points of the reference frame because they are blurred


@dataclass(frozen=True)
class StereoOdometryConfig:
    """All settings of the odometry; the defaults serve any rectified pair.

    Attributes:
        tracking: choice and tracking of corners.
        matching: search for them in the right image.
        adjustment: two-view adjustment of each pair against its reference frame.
        window: sliding window over the last reference frames.
        calibration: prior of the calibration error.
        motion_checks: checks that a motion must pass.
        reference_spacing_m: distance from the reference frame at which a pair becomes the next one, metres.
        reference_rotation_rad: rotation from the reference frame at which a pair becomes the next one, radians.
        min_reference_ratio: share of the reference frame's points below which a pair becomes the next one.
        max_earlier_references: reference frames of the past that are kept, to measure from them where the camera comes
            back; 0 for a car, which does not within so short a time.
        max_lost_frames: images for which a lost reference frame is tried again when its successors fail.
        covariance_scale: how many times more variance motions have, as parts of a stretch, than their points would
            have if these erred independently in every image: tracks keep their errors while they live.
        extrapolation_sigma_rad: standard deviation of the change of rotation from one image to the next, radians.
        extrapolation_sigma_m: standard deviation of the change of translation from one image to the next, metres.
    """

    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    matching: StereoMatchingConfig = field(default_factory=StereoMatchingConfig)
    adjustment: AdjustmentConfig = field(default_factory=AdjustmentConfig)
    window: WindowConfig = field(default_factory=WindowConfig)
    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)
    motion_checks: MotionCheckConfig = field(default_factory=MotionCheckConfig)
    reference_spacing_m: float = 0.1
    reference_rotation_rad: float = 0.01
    min_reference_ratio: float = 0.6
    max_earlier_references: int = 0
    max_lost_frames: int = 50
    covariance_scale: float = 9.0
    extrapolation_sigma_rad: float = EXTRAPOLATION_SIGMA_RAD
    extrapolation_sigma_m: float = EXTRAPOLATION_SIGMA_M


class StereoOdometry:
    """Measures the motion of a rectified stereo pair, or of a depth camera, frame by frame.

    Attributes:
        calibration: the pair's calibration error as learned so far; corrects disparities of any match.
    """

    def __init__(
        self,
        camera: StereoCamera,
        config: StereoOdometryConfig | None = None,
        second_view: SecondView | None = None,
        calibration: Calibration | None = None,
    ) -> None:
        """Begin without images.

        Args:
            camera: rectified pair.
            config: the settings.
            second_view: what the second image of each pair is; None for a right image.
            calibration: calibration error before the first pair; None for the prior of the settings.
        """
        self._camera, self._config = camera, config or StereoOdometryConfig()
        self.calibration = calibration or Calibration.unknown(camera, self._config.calibration)
        self._second_view = second_view or RightImage(self._config.matching)
        self._front_end = StereoFrontEnd(self._config.tracking, self._second_view)
        self._tracker = StereoTracker(self._front_end, self._config.adjustment, self._config.motion_checks)
        self._window = SlidingWindow(self._config.window, self._second_view.noise)
        self._frame_counter = FrameCounter()
        self._reference: Reference[StereoObservation] | None = None
        # An earlier reference frame, from which its successor could not be measured.
        self._lost: Reference[StereoObservation] | None = None
        # Reference frames before the present one, the latest last; the camera may come back to them.
        self._earlier: list[Reference[StereoObservation]] = []
        # The two images tracked last, and the pair that was prepared from them.
        self._latest: tuple[Image, NDArray[Any], Pair] | None = None
        self._velocity: Array | None = None  # tangent vector of the last measured motion, per image
        self._speeds: deque[float] = deque(maxlen=2)  # of the last measured motions, metres per image
        self._unmeasured = 0  # images since the last measurement
        self._blurred = 0  # images in a row in which few points were found again

    def track(
        self, left: Image, right: NDArray[Any], timestamp: float | None = None, mask: Image | None = None
    ) -> Motion:
        """Measure the motion since the previous pair.

        Args:
            left: (H, W) uint8 of the camera's size.
            right: of the same size, taken at the same time; its exposure may be another one. With a depth camera its
                depth image, (H, W) float32, metres, NaN where there is no measurement.
            timestamp: seconds, from which gaps in the recording are found; None if no image is missing, at 10 Hz.
            mask: (H, W) uint8, 0 where the left image does not show the scene; None if it shows it everywhere.

        Raises:
            ValueError: images of another size or type.
        """
        self._check(left, right)
        pair = left, self._second_view.prepare(left, right)
        self._latest = left, right, pair
        self._front_end.mask = mask
        steps = self._frame_counter.frames_since_last(timestamp)
        self._unmeasured += steps
        if self._reference is None:
            return self._begin(pair)
        motion = np.eye(4) if self._velocity is None else se3.exp(self._velocity * steps)
        self._reference = self._reference.age(steps)
        self._earlier = [earlier.age(steps) for earlier in self._earlier]
        is_lost_recent = self._lost is not None and self._lost.age_frames < self._config.max_lost_frames
        self._lost = self._lost.age(steps) if self._lost and is_lost_recent else None
        return self._measure(pair, motion)

    def disparity(self, left: Image, right: NDArray[Any], pixels: Array) -> Array:
        """Disparity (N,), pixels, of pixels (N, 2) of the left image, less the calibration error learned so far.

        NaN where there is no reliable match. For other stages that need depth, in the pair that was tracked last.
        """
        if self._latest is not None and self._latest[0] is left and self._latest[1] is right:
            pair = self._latest[2]  # what the second view has made of it, it makes but once
        else:
            pair = left, self._second_view.prepare(left, right)
        places = self._second_view.find(pair, pixels)
        return self.calibration.correct_disparity(pixels, pixels[:, 0] - places[:, 0])

    def _check(self, left: Image, right: NDArray[Any]) -> None:
        self._second_view.check(left, right, (self._camera.height, self._camera.width))

    def _begin(self, pair: Pair) -> Motion:
        """Take the first pair as the reference, unless its images are swapped."""
        first = self._unmeasured == 1
        covariance = FIRST_VARIANCE * np.eye(6) if first else self._extrapolation_covariance(self._unmeasured)
        if self._front_end.is_swapped(pair):
            return Motion(np.eye(4), covariance, True, SWAPPED)
        self._restart(self._front_end.observe(pair))
        return Motion(np.eye(4), covariance, False, "")

    def _measure(self, pair: Pair, motion: Array) -> Motion:
        """Measure from the reference frame, else from the lost one, else extrapolate by the motion (4, 4)."""
        back = self._come_back(pair, motion)
        if back is not None:
            return back
        reason = None
        for reference in filter(None, (self._reference, self._lost)):
            expected = self._expect(reference, pair, motion)
            located = self._tracker.track(reference.view, pair, expected, self.calibration)
            if located.estimate is not None and not located.reason:
                return self._accept(reference, pair, located, located.estimate)
            reason = reason or located.reason
            if reason == SWAPPED:
                break
        return self._extrapolate(pair, motion, reason or "")

    def _come_back(self, pair: Pair, motion: Array) -> Motion | None:
        """Measure from an earlier reference frame, if the camera is near it again and leaves the present one.

        Drift between the two is taken back. None if there is no such frame, or it does not show the pair well.
        """
        assert self._reference is not None
        if not self._earlier or self._reach(self._reference, motion) < 1.0:
            return None
        number = int(np.argmin([self._reach(earlier, motion) for earlier in self._earlier]))
        earlier = self._earlier[number]
        if self._reach(earlier, motion) > _MAX_REACH_BACK:
            return None
        # What was measured last is the same image, seen from this frame.
        T_earlier_present = earlier.T_reference_previous @ se3.inverse(self._reference.T_reference_previous)
        earlier = replace(
            earlier,
            T_reference_measured=T_earlier_present @ self._reference.T_reference_measured,
            age_frames=self._reference.age_frames,
        )
        expected = self._expect(earlier, pair, motion)
        located = self._tracker.follow(earlier.view, pair, expected, self.calibration)
        estimate = located.estimate
        if estimate is None or located.reason or self._is_far(earlier, estimate):
            return None
        del self._earlier[number]
        self._keep(self._reference)
        self._reference, self._lost = earlier, None
        self._window.restart(earlier.view.points)
        return self._accept(earlier, pair, located, estimate)

    def _reach(self, reference: Reference[StereoObservation], motion: Array) -> float:
        """Distance from a reference frame, after a motion (4, 4), as a share of that at which it is replaced."""
        T = reference.T_reference_previous @ motion
        distance = float(np.linalg.norm(T[:3, 3])) / self._config.reference_spacing_m
        return max(distance, se3.angle(T) / self._config.reference_rotation_rad)

    def _keep(self, reference: Reference[StereoObservation]) -> None:
        """Keep a reference frame that is replaced."""
        count = self._config.max_earlier_references
        self._earlier = [*self._earlier, reference][-count:] if count else []

    def _expect(self, reference: Reference[StereoObservation], pair: Pair, motion: Array) -> MotionPrediction | None:
        """Predict the pose from the motion (4, 4) since the previous image; None before the first measurement."""
        if np.array_equal(pair[0], reference.view.pair[0]):  # the same image again was taken at the same place
            return MotionPrediction(np.eye(4))
        if self._velocity is None:
            return None
        T_reference_current = reference.T_reference_previous @ motion
        distance_m = reference.age_frames * min(self._speeds)
        return MotionPrediction(
            T_reference_current, reference.age_frames, self._unmeasured, self._frame_counter.interval_s, distance_m
        )

    def _accept(
        self, reference: Reference[StereoObservation], pair: Pair, located: TrackingResult, estimate: TwoViewEstimate
    ) -> Motion:
        """Accept a measured motion; a pair far enough from the reference frame becomes the next one."""
        T_reference_current = estimate.T_first_second
        self._velocity, self._unmeasured = reference.velocity(T_reference_current), 0
        self._speeds.append(float(np.linalg.norm(self._velocity[3:])))
        if reference is not self._reference:  # the lost one was found again, and the frames since then are dropped
            self._restart(self._front_end.observe(pair))
        elif self._is_next_reference(reference, located, estimate):
            self._learn(estimate)
            self._keep(reference)
            T_reference_current = self._renew(pair, located, estimate)
        else:
            self._reference = reference.update(T_reference_current)
        T_previous_current = se3.inverse(reference.T_reference_previous) @ T_reference_current
        Ad = se3.adjoint(se3.inverse(T_previous_current))
        covariance = self._config.covariance_scale * estimate.covariance + Ad @ reference.covariance_previous @ Ad.T
        if self._lost:
            self._lost = self._lost.extend(T_previous_current, covariance)
        self._earlier = [earlier.extend(T_previous_current, covariance) for earlier in self._earlier]
        tracks, good = located.tracks, estimate.inliers
        return Motion(
            T_previous_current, covariance, False, "",
            tracks.first_left, tracks.second_left, good, estimate.residual_px,
        )  # fmt: skip

    def _is_far(self, reference: Reference[StereoObservation], estimate: TwoViewEstimate) -> bool:
        """Whether a pair is far from a reference frame. A near one would only add the error of another link."""
        T, seen = estimate.T_first_second, len(reference.view.points.ids)
        far = (
            np.linalg.norm(T[:3, 3]) > self._config.reference_spacing_m
            or se3.angle(T) > self._config.reference_rotation_rad
        )
        return bool(far or estimate.inliers.sum() < self._config.min_reference_ratio * seen)

    def _is_next_reference(
        self, reference: Reference[StereoObservation], located: TrackingResult, estimate: TwoViewEstimate
    ) -> bool:
        """Whether a pair becomes the next reference frame: it is far from this one, and clear.

        A depth image may be empty. An image in which few points are found again, as it is blurred, would pass its error
        on to the images after it, which show more of the present reference than it does.
        """
        few = self._config.motion_checks.min_followed_ratio * len(reference.view.points.ids)
        self._blurred = self._blurred + 1 if estimate.inliers.sum() < few else 0
        known = np.isfinite(located.tracks.second_right[estimate.inliers, 0])
        has_depth = int(known.sum()) >= self._config.motion_checks.min_tracks
        return has_depth and not 0 < self._blurred <= _MAX_BLURRED and self._is_far(reference, estimate)

    def _learn(self, estimate: TwoViewEstimate) -> None:
        """Update the calibration error by what a measured motion says about it."""
        if np.linalg.norm(estimate.T_first_second[:3, 3]) > self._config.motion_checks.min_moving_m:
            # A camera at rest learns nothing new: the same points have the same errors again.
            self.calibration = self.calibration.update(
                estimate.calibration, estimate.information, self._config.calibration
            )

    def _renew(self, pair: Pair, located: TrackingResult, estimate: TwoViewEstimate) -> Array:
        """Make a pair the reference frame; return its refined pose (4, 4) in the old one."""
        if not located.followed:
            self._restart(self._front_end.observe(pair))
            return estimate.T_first_second
        good, tracks = estimate.inliers, located.tracks
        view = self._front_end.observe(
            pair, StereoFrameObservations(tracks.ids[good], tracks.second_left[good], tracks.second_right[good])
        )
        self._reference = Reference(view)
        return self._window.refine(view.points, estimate.T_first_second, self.calibration)

    def _extrapolation_covariance(self, images: int) -> Array:
        """Covariance (6, 6) of a motion that was not measured for a number of images."""
        return extrapolation_covariance(
            self._config.extrapolation_sigma_rad, self._config.extrapolation_sigma_m, images
        )

    def _extrapolate(self, pair: Pair, T_previous_current: Array, reason: str) -> Motion:
        """Extrapolate at constant velocity; this pair becomes the reference frame if it shows enough points."""
        assert self._reference is not None
        covariance = self._extrapolation_covariance(self._unmeasured)
        bridged = self._reference.extend(T_previous_current, covariance)
        self._lost = self._lost and self._lost.extend(T_previous_current, covariance)
        self._earlier = [earlier.extend(T_previous_current, covariance) for earlier in self._earlier]
        view = None if reason == SWAPPED else self._front_end.observe(pair)
        if view is None or np.isfinite(view.points.right[:, 0]).sum() < self._config.motion_checks.min_tracks:
            self._reference = bridged  # a pair that shows nothing is left out
        else:
            lost = self._lost or bridged
            self._restart(view)
            self._lost = lost
        return Motion(T_previous_current, covariance, True, reason)

    def _restart(self, view: StereoObservation) -> None:
        """Begin a new window with this view as the reference frame."""
        self._window.restart(view.points)
        self._reference, self._lost = Reference(view), None

    def state(self) -> dict[str, Any]:
        """Everything that changes from pair to pair: dicts, lists, plain values and arrays, for a checkpoint."""
        return {
            "calibration_coefficients": self.calibration.coefficients,
            "calibration_covariance": self.calibration.covariance,
            "front_end": self._front_end.state(),
            "window": self._window.state(),
            "frame_counter": self._frame_counter.state(),
            "reference": None if self._reference is None else self._reference.state(self._reference.view.state()),
            "lost_reference": None if self._lost is None else self._lost.state(self._lost.view.state()),
            "earlier_references": [earlier.state(earlier.view.state()) for earlier in self._earlier],
            "velocity": self._velocity,
            "speeds": list(self._speeds),
            "frames_unmeasured": self._unmeasured,
            "frames_blurred": self._blurred,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue, bit for bit, from the state of another odometry of the same camera and configuration.

        Raises:
            KeyError, TypeError, ValueError: the state is of another odometry.
        """
        coefficients, covariance = state["calibration_coefficients"], state["calibration_covariance"]
        self.calibration = replace(self.calibration, coefficients=coefficients, covariance=covariance)
        self._front_end.restore(state["front_end"])
        self._window.restore(state["window"])
        self._frame_counter.restore(state["frame_counter"])
        self._reference = self._restored_reference(state["reference"])
        self._lost = self._restored_reference(state["lost_reference"])
        earlier = [self._restored_reference(one) for one in state["earlier_references"]]
        self._earlier = [reference for reference in earlier if reference is not None]
        self._velocity, self._unmeasured = state["velocity"], state["frames_unmeasured"]
        self._blurred = state["frames_blurred"]
        self._speeds = deque(state["speeds"], maxlen=self._speeds.maxlen)

    def _restored_reference(self, state: dict[str, Any] | None) -> Reference[StereoObservation] | None:
        if state is None:
            return None
        view = StereoObservation.from_state(state["view"])
        self._check(*view.pair)
        return Reference(**(state | {"view": view}))
