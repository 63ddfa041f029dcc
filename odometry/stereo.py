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
from odometry.camera import StereoCamera
from odometry.motion import Motion
from odometry.plausibility import PlausibilityConfig, doubt, is_sure, jump
from odometry.rectification import Rectification, RectificationConfig
from odometry.stereo_matching import StereoMatchingConfig, match_right, match_rows, refine_right
from odometry.tracking import TrackingConfig, detect, follow, inside
from odometry.two_views import AdjustmentConfig, StereoTracks, TwoViewEstimate, estimate_motion, ransac_motion

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_FIRST_VARIANCE = 1e-12  # rad², m²: the first image is where it is by definition


@dataclass(frozen=True)
class StereoOdometryConfig:
    """All settings of the odometry; the defaults serve any rectified pair.

    Attributes:
        tracking: how corners are chosen and followed.
        matching: how they are found in the right image.
        adjustment: how the motion is computed.
        rectification: what is thought of the calibration at first.
        plausibility: when a result is not believed.
        extrapolated_rad: standard deviation of the change of rotation from one image to the next.
        extrapolated_m: standard deviation of the change of translation from one image to the next, metres.

    """

    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    matching: StereoMatchingConfig = field(default_factory=StereoMatchingConfig)
    adjustment: AdjustmentConfig = field(default_factory=AdjustmentConfig)
    rectification: RectificationConfig = field(default_factory=RectificationConfig)
    plausibility: PlausibilityConfig = field(default_factory=PlausibilityConfig)
    extrapolated_rad: float = 0.02
    extrapolated_m: float = 0.2


@dataclass(frozen=True)
class _View:
    """A pair of images and its points, left and right, (N, 2) pixels each."""

    left: Image
    right: Image
    pixels_left: Array
    pixels_right: Array


class StereoOdometry:
    """Measures the motion of a rectified stereo pair, frame by frame.

    Attributes:
        rectification: the pair's calibration error as learned so far; corrects disparities of any match.

    """

    def __init__(self, camera: StereoCamera, config: StereoOdometryConfig | None = None) -> None:
        self._camera, self._config = camera, config or StereoOdometryConfig()
        self.rectification = Rectification.unknown(camera, self._config.rectification)
        self._reference: _View | None = None  # the last pair that motion could be measured from
        # Where the previous image stands in the reference's frame: identity but after an extrapolation.
        self._T_reference_previous = np.eye(4)
        self._covariance_previous = np.zeros((6, 6))
        self._velocity: Array | None = None  # tangent vector of the last measured motion, per image
        self._age = 1  # images since the reference

    def track(self, left: Image, right: Image) -> Motion:
        """Motion since the previous pair, images (H, W) uint8 of the camera's size; ValueError for others."""
        self._check(left, right)
        if self._reference is None:
            self._restart(self._observe(left, right))
            return _motion(np.eye(4), _FIRST_VARIANCE * np.eye(6), "")
        expected = self._T_reference_previous @ self._expected_motion()
        for tracking in (self._config.tracking, self._config.tracking.wider()):
            tracks, estimate = self._measure(self._reference, (left, right), expected, tracking)
            reason = doubt(estimate, None if self._velocity is None else expected, self._config.plausibility)
            if estimate is not None and not reason:
                return self._accept(left, right, tracks, estimate)
        return self._extrapolate(left, right, reason)

    def _expected_motion(self) -> Array:
        """T_previous_current (4, 4) at constant velocity; identity while nothing was measured."""
        return np.eye(4) if self._velocity is None else se3.exp(self._velocity)

    def _measure(
        self, reference: _View, pair: tuple[Image, Image], expected: Array, tracking: TrackingConfig
    ) -> tuple[StereoTracks, TwoViewEstimate | None]:
        """Tracks and the motion they tell, near the expected T_reference_current or wherever they lead."""
        tracks = self._follow(reference, pair, expected, tracking)
        estimate = self._estimate(tracks, expected)
        if estimate is None or not jump(estimate.T_first_second, expected, self._config.plausibility):
            return tracks, estimate
        # Tracks that had to be found far from where they were looked for are few: look again where they are.
        again = self._follow(reference, pair, estimate.T_first_second, tracking)
        second = self._estimate(again, estimate.T_first_second)
        if second is None or second.inliers.sum() < estimate.inliers.sum():
            return tracks, estimate
        return again, second

    def disparity(self, left: Image, right: Image, pixels: Array) -> Array:
        """Disparity (N,), pixels, of pixels (N, 2) of the left image, less the calibration error learned so far.

        NaN where there is no reliable match. For other stages that need depth, in the pair that was tracked last.
        """
        matched = match_rows(left, right, pixels, self._config.matching)
        return self.rectification.correct(pixels, matched)

    def _check(self, left: Image, right: Image) -> None:
        expected = (self._camera.height, self._camera.width)
        for side, image in (("left", left), ("right", right)):
            if image.shape != expected or image.dtype != np.uint8:
                raise ValueError(
                    f"expected the {side} image to be {expected} uint8 as the camera says, "
                    f"got left {left.shape} {left.dtype} and right {right.shape} {right.dtype}"
                )

    def _follow(
        self, reference: _View, pair: tuple[Image, Image], guess: Array, tracking: TrackingConfig
    ) -> StereoTracks:
        """Look for the reference's points in the new pair where the guess puts them."""
        ahead, shift = self._predict(reference, guess)
        second_left = follow((reference.left, pair[0]), reference.pixels_left, ahead, tracking)
        # What the prediction got wrong in the left image it got wrong in the right one too.
        start = second_left + shift
        kept = np.flatnonzero(np.isfinite(start[:, 0]))
        second_right = refine_right(pair, second_left[kept], start[kept], self._config.matching)
        matched = np.isfinite(second_right[:, 0])
        kept, second_right = kept[matched], second_right[matched]
        return StereoTracks(reference.pixels_left[kept], reference.pixels_right[kept], second_left[kept], second_right)

    def _predict(self, reference: _View, guess: Array) -> tuple[Array, Array]:
        """Where the points (N, 2) should be in the new left image, and right less left (N, 2), pixels."""
        shift = reference.pixels_right - reference.pixels_left
        disparity = self.rectification.correct(reference.pixels_left, -shift[:, 0])
        points = self._camera.triangulate(reference.pixels_left, np.maximum(disparity, 0.1))
        seen = self._camera.project(se3.transform(se3.inverse(guess), points))
        ahead, narrowed = seen[:, [0, 2]], seen[:, 1] - seen[:, 0]
        visible = np.isfinite(ahead[:, 0]) & inside(ahead, reference.left)
        ahead = np.where(visible[:, None], ahead, reference.pixels_left)
        shift[:, 0] += np.where(visible, narrowed + disparity, 0.0)
        return ahead, shift

    def _estimate(self, tracks: StereoTracks, guess: Array) -> TwoViewEstimate | None:
        """Find the motion near the guess if most tracks agree with it, else the one that most agree with."""
        if len(tracks) < self._config.plausibility.tracks:
            return None
        estimate = estimate_motion(tracks, self.rectification, guess, self._config.adjustment)
        if not doubt(estimate, None, self._config.plausibility) and is_sure(estimate, self._config.plausibility):
            return estimate
        other = ransac_motion(tracks, self.rectification)
        if other is None:
            return estimate
        second = estimate_motion(tracks, self.rectification, other, self._config.adjustment)
        return min(estimate, second, key=lambda found: found.noise_px)

    def _accept(self, left: Image, right: Image, tracks: StereoTracks, estimate: TwoViewEstimate) -> Motion:
        T_previous_current = se3.inverse(self._T_reference_previous) @ estimate.T_first_second
        Ad = se3.adjoint(se3.inverse(T_previous_current))
        covariance = estimate.covariance + Ad @ self._covariance_previous @ Ad.T
        self._velocity = se3.log(estimate.T_first_second) / self._age
        if np.linalg.norm(estimate.T_first_second[:3, 3]) > self._config.plausibility.moving_m:
            # Standing still says nothing new: the same points have the same errors again.
            self.rectification = self.rectification.learned(
                estimate.rectification, estimate.information, self._config.rectification
            )
        good = estimate.inliers
        self._restart(self._observe(left, right, tracks.second_left[good], tracks.second_right[good]))
        return _motion(T_previous_current, covariance, "", tracks, estimate)

    def _extrapolate(self, left: Image, right: Image, reason: str) -> Motion:
        """Go on at constant velocity; this pair is the new reference if it shows enough."""
        T_previous_current = self._expected_motion()
        deviation = np.repeat([self._config.extrapolated_rad, self._config.extrapolated_m], 3) * self._age
        covariance = np.diag(deviation**2)
        view = self._observe(left, right)
        if len(view.pixels_left) >= self._config.plausibility.tracks:
            self._restart(view)
        else:
            self._T_reference_previous = self._T_reference_previous @ T_previous_current
            self._covariance_previous = se3.compose_covariance(
                self._covariance_previous, T_previous_current, covariance
            )
            self._age += 1
        return _motion(T_previous_current, covariance, reason)

    def _observe(self, left: Image, right: Image, *kept: Array) -> _View:
        """Make a view of the tracks kept, left and right (N, 2), topped up with new corners."""
        pixels_left, pixels_right = kept or (np.zeros((0, 2)), np.zeros((0, 2)))
        corners = detect(left, pixels_left, self._config.tracking)
        places = match_right(left, right, corners, self._config.matching)
        matched = np.isfinite(places[:, 0])
        return _View(
            left.copy(),  # callers may use one buffer for all images
            right.copy(),
            np.concatenate([pixels_left, corners[matched]]),
            np.concatenate([pixels_right, places[matched]]),
        )

    def _restart(self, view: _View) -> None:
        """Measure from this view on."""
        self._reference, self._age = view, 1
        self._T_reference_previous, self._covariance_previous = np.eye(4), np.zeros((6, 6))


def _motion(
    T: Array,
    covariance: Array,
    reason: str,
    tracks: StereoTracks | None = None,
    estimate: TwoViewEstimate | None = None,
) -> Motion:
    """Assemble the answer, with tracks where there was a measurement."""
    if tracks is None or estimate is None:
        nothing = np.zeros((0, 2))
        return Motion(T, covariance, bool(reason), reason, nothing, nothing, np.zeros(0, dtype=bool), float("nan"))
    return Motion(
        T,
        covariance,
        False,
        reason,
        tracks.first_left,
        tracks.second_left,
        estimate.inliers,
        estimate.residual_px,
    )
