"""Stereo visual odometry: from each pair of images, how the camera moved since the one before.

    odometry = StereoOdometry(camera)
    for left, right in pairs:
        T_world_camera = T_world_camera @ odometry.track(left, right).T_previous_current

There is one finite motion for every pair. Where the images do not allow a measurement it is an extrapolation,
and says so.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.calibration import Calibration, CalibrationConfig
from odometry.camera import StereoCamera
from odometry.front_end import FrontEnd, Pair, View
from odometry.locating import SWAPPED, Located, Locator
from odometry.motion import Motion
from odometry.plausibility import Expectation, PlausibilityConfig
from odometry.stereo_matching import StereoMatchingConfig, match_rows
from odometry.ticks import Ticks
from odometry.tracking import TrackingConfig
from odometry.two_views import AdjustmentConfig, TwoViewEstimate
from odometry.window import Sighted, SlidingWindow, WindowConfig

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_FIRST_VARIANCE = 1e-12  # rad², m²: the first image is where it is by definition


@dataclass(frozen=True)
class StereoOdometryConfig:
    """All settings of the odometry; the defaults serve any rectified pair.

    Attributes:
        tracking: how corners are chosen and followed.
        matching: how they are found in the right image.
        adjustment: how the motion between two pairs is computed.
        window: how the last poses are refined.
        calibration: what is thought of the calibration at first.
        plausibility: when a result is not believed.
        key_m: way from the reference after which a pair becomes the reference, metres.
        key_rad: turn after which it does, radians.
        key_share: share of the reference's points that must still agree, or else it does.
        persistence: how many times more variance motions have, as parts of a stretch, than their points would
            have if these erred independently in every image: tracks keep their errors while they live.
        extrapolated_rad: standard deviation of the change of rotation from one image to the next.
        extrapolated_m: standard deviation of the change of translation from one image to the next, metres.

    """

    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    matching: StereoMatchingConfig = field(default_factory=StereoMatchingConfig)
    adjustment: AdjustmentConfig = field(default_factory=AdjustmentConfig)
    window: WindowConfig = field(default_factory=WindowConfig)
    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)
    plausibility: PlausibilityConfig = field(default_factory=PlausibilityConfig)
    key_m: float = 0.1
    key_rad: float = 0.01
    key_share: float = 0.6
    persistence: float = 14.0
    extrapolated_rad: float = 0.02
    extrapolated_m: float = 0.2


class StereoOdometry:
    """Measures the motion of a rectified stereo pair, frame by frame.

    Attributes:
        calibration: the pair's calibration error as learned so far; corrects disparities of any match.

    """

    def __init__(self, camera: StereoCamera, config: StereoOdometryConfig | None = None) -> None:
        self._camera, self._config = camera, config or StereoOdometryConfig()
        self.calibration = Calibration.unknown(camera, self._config.calibration)
        self._front_end = FrontEnd(self._config.tracking, self._config.matching)
        self._locator = Locator(self._front_end, self._config.adjustment, self._config.plausibility)
        self._window = SlidingWindow(self._config.window)
        self._ticks = Ticks()
        self._reference: View | None = None  # the pair that motion is measured from
        self._T_reference_previous = np.eye(4)
        self._T_reference_measured = np.eye(4)  # of the last image that was measured, not extrapolated
        self._covariance_previous = np.zeros((6, 6))  # of the previous image if it was extrapolated
        self._velocity: Array | None = None  # tangent vector of the last measured motion, per image
        self._age = 0  # images since the reference, or the last one measured from it
        self._unmeasured = 0  # images since the last measurement

    def track(self, left: Image, right: Image, timestamp: float | None = None) -> Motion:
        """Measure the motion since the previous pair.

        Args:
            left: (H, W) uint8 of the camera's size.
            right: of the same size, taken at the same time.
            timestamp: seconds; tells how long a gap in the recording is. None: no image is missing.

        Raises:
            ValueError: images of another size or type.

        """
        self._check(left, right)
        steps = self._ticks.since_last(timestamp)
        self._age += steps
        self._unmeasured += steps
        if self._reference is None:
            return self._begin((left, right))
        motion = np.eye(4) if self._velocity is None else se3.exp(self._velocity * steps)
        expected = self._expect(left, motion)
        located = self._locator.locate(self._reference, (left, right), expected, self.calibration)
        if located.estimate is None or located.reason:
            return self._extrapolate((left, right), motion, located.reason)
        return self._accept((left, right), located, located.estimate)

    def disparity(self, left: Image, right: Image, pixels: Array) -> Array:
        """Disparity (N,), pixels, of pixels (N, 2) of the left image, less the calibration error learned so far.

        NaN where there is no reliable match. For other stages that need depth, in the pair that was tracked last.
        """
        matched = match_rows(left, right, pixels, self._config.matching)
        return self.calibration.correct(pixels, matched)

    def _check(self, left: Image, right: Image) -> None:
        expected = (self._camera.height, self._camera.width)
        for side, image in (("left", left), ("right", right)):
            if image.shape != expected or image.dtype != np.uint8:
                raise ValueError(
                    f"expected the {side} image to be {expected} uint8 as the camera says, "
                    f"got left {left.shape} {left.dtype} and right {right.shape} {right.dtype}"
                )

    def _begin(self, pair: Pair) -> Motion:
        """Take the first pair as the reference, unless its images are swapped."""
        reason = SWAPPED if self._front_end.swapped(pair) else ""
        covariance = _FIRST_VARIANCE * np.eye(6) if self._age == 1 else self._extrapolated()
        if not reason:
            self._restart(self._front_end.observe(pair))
        return _motion(np.eye(4), covariance, reason)

    def _expect(self, left: Image, motion: Array) -> Expectation | None:
        """Expect the motion (4, 4) since the previous image, where one was ever measured."""
        assert self._reference is not None
        if np.array_equal(left, self._reference.pair[0]):  # the same image again was taken at the same place
            return Expectation(np.eye(4))
        if self._velocity is None:
            return None
        return Expectation(self._T_reference_previous @ motion, self._age, self._unmeasured)

    def _accept(self, pair: Pair, located: Located, estimate: TwoViewEstimate) -> Motion:
        """Take over what was measured; a pair far enough from the reference takes its place."""
        T_reference_current, self._unmeasured = estimate.T_first_second, 0
        self._velocity = se3.log(se3.inverse(self._T_reference_measured) @ T_reference_current) / self._age
        T_reference_previous, covariance_previous = self._T_reference_previous, self._covariance_previous
        if self._is_key(estimate):
            self._learn(estimate)
            T_reference_current = self._renew(pair, located, estimate)
        else:
            self._T_reference_previous = self._T_reference_measured = T_reference_current
            self._covariance_previous, self._age = np.zeros((6, 6)), 0
        T_previous_current = se3.inverse(T_reference_previous) @ T_reference_current
        Ad = se3.adjoint(se3.inverse(T_previous_current))
        covariance = self._config.persistence * estimate.covariance + Ad @ covariance_previous @ Ad.T
        return _motion(T_previous_current, covariance, "", located)

    def _is_key(self, estimate: TwoViewEstimate) -> bool:
        """Whether a pair is far from the reference. One that is not would only add the error of another link."""
        assert self._reference is not None
        T, seen = estimate.T_first_second, len(self._reference.points.ids)
        far = np.linalg.norm(T[:3, 3]) > self._config.key_m or se3.angle(T) > self._config.key_rad
        return bool(far or estimate.inliers.sum() < self._config.key_share * seen)

    def _learn(self, estimate: TwoViewEstimate) -> None:
        if np.linalg.norm(estimate.T_first_second[:3, 3]) > self._config.plausibility.moving_m:
            # Standing still says nothing new: the same points have the same errors again.
            self.calibration = self.calibration.learned(
                estimate.calibration, estimate.information, self._config.calibration
            )

    def _renew(self, pair: Pair, located: Located, estimate: TwoViewEstimate) -> Array:
        """Make a pair the reference, and say where the window puts it in the old one (4, 4)."""
        if not located.followed:
            self._restart(self._front_end.observe(pair))
            return estimate.T_first_second
        good, tracks = estimate.inliers, located.tracks
        view = self._front_end.observe(
            pair, Sighted(tracks.ids[good], tracks.second_left[good], tracks.second_right[good])
        )
        T_reference_current = self._window.refine(view.points, estimate.T_first_second, self.calibration)
        self._measure_from(view)
        return T_reference_current

    def _extrapolated(self) -> Array:
        """Covariance (6, 6) of a motion that was not measured: it grows with the time that nothing was."""
        deviation = np.repeat([self._config.extrapolated_rad, self._config.extrapolated_m], 3) * self._age
        return np.diag(deviation**2)

    def _extrapolate(self, pair: Pair, T_previous_current: Array, reason: str) -> Motion:
        """Go on at constant velocity; this pair is the new reference if it shows enough."""
        covariance = self._extrapolated()
        if reason == SWAPPED:
            return self._bridge(T_previous_current, covariance, reason)
        view = self._front_end.observe(pair)
        if len(view.points.ids) < self._config.plausibility.tracks:
            return self._bridge(T_previous_current, covariance, reason)
        self._restart(view)
        return _motion(T_previous_current, covariance, reason)

    def _bridge(self, T_previous_current: Array, covariance: Array, reason: str) -> Motion:
        """Leave out a pair that shows nothing: the next one is measured from the same reference."""
        self._T_reference_previous = self._T_reference_previous @ T_previous_current
        self._covariance_previous = se3.compose_covariance(self._covariance_previous, T_previous_current, covariance)
        return _motion(T_previous_current, covariance, reason)

    def _restart(self, view: View) -> None:
        """Measure from this view on, and refine nothing before it."""
        self._window.restart(view.points)
        self._measure_from(view)

    def _measure_from(self, view: View) -> None:
        self._reference, self._age = view, 0
        self._T_reference_previous = self._T_reference_measured = np.eye(4)
        self._covariance_previous = np.zeros((6, 6))


def _motion(T: Array, covariance: Array, reason: str, located: Located | None = None) -> Motion:
    """Assemble the answer, with tracks where there was a measurement."""
    if located is None or located.estimate is None:
        nothing = np.zeros((0, 2))
        return Motion(T, covariance, bool(reason), reason, nothing, nothing, np.zeros(0, dtype=bool), float("nan"))
    tracks, estimate = located.tracks, located.estimate
    return Motion(
        T, covariance, False, reason, tracks.first_left, tracks.second_left, estimate.inliers, estimate.residual_px
    )
