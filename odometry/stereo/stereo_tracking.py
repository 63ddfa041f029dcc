"""Tracking of a stereo pair against a reference frame: by optical flow, then a wider search, then descriptors.

Descriptors match pairs that are too far apart to follow points: after a gap, in a sharp turn. SIFT (Lowe, IJCV 2004)
withstands the change of scale that a few seconds of driving bring. It takes several times as long as optical flow and
is less accurate, so it is used only when optical flow has failed.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from odometry.motion_checks import (
    IMPLAUSIBLE_STOP,
    MotionCheckConfig,
    MotionPrediction,
    deviation_in_jumps,
    jump_reason,
    rejection_reason,
    stops_implausibly,
)
from odometry.stereo.second_view import Pair, SecondView
from odometry.stereo.stereo_frontend import StereoFrontEnd, StereoObservation
from odometry.stereo.stereo_self_calibration import Calibration
from odometry.stereo.two_view_adjustment import (
    AdjustmentConfig,
    StereoTracks,
    TwoViewEstimate,
    estimate_motion,
    ransac_motion,
)

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

SWAPPED = "the left and the right image are swapped"

# Share of the reference frame's points below which a pair is tested for swapped images: the test costs two detections,
# and a pair whose images are swapped loses most points.
_MIN_TRACKED_RATIO = 0.5

_MAX_SIFT_FEATURES = 3000  # in each image
_MAX_SIFT_RATIO = 0.8  # best over second best distance (Lowe, section 7.1)


@dataclass(frozen=True)
class TrackingResult:
    """Motion of a stereo pair relative to its reference frame.

    Attributes:
        tracks: points of the reference frame that the pair shows.
        estimate: the measured motion; None with too few tracks.
        reason: reason for which the estimate must be rejected; None if it is accepted.
        followed: whether the points were followed by optical flow, so that their tracks go on.
    """

    tracks: StereoTracks
    estimate: TwoViewEstimate | None
    reason: str | None
    followed: bool = True


def _count_agreeing(result: TrackingResult) -> int:
    """Count the tracks that agree with a motion that is accepted."""
    return 0 if result.estimate is None or result.reason else int(result.estimate.inliers.sum())


class StereoTracker:
    """Finds the reference frame's points in a new pair by the cheapest of three methods that gives a sound motion."""

    def __init__(
        self, front_end: StereoFrontEnd, adjustment: AdjustmentConfig, motion_checks: MotionCheckConfig
    ) -> None:
        self._front_end, self._adjustment, self._motion_checks = front_end, adjustment, motion_checks

    def track(
        self, reference: StereoObservation, pair: Pair, predicted: MotionPrediction | None, calibration: Calibration
    ) -> TrackingResult:
        """Estimate T_reference_pair of a pair of images (H, W) uint8, from a predicted motion if there is one."""
        search = _Search(reference, pair, predicted, calibration)
        result = self._follow(search, search.guess, wide=False)
        few = len(result.tracks) < _MIN_TRACKED_RATIO * len(reference.points.ids)
        if (result.reason or few) and self._front_end.is_swapped(pair):
            return TrackingResult(result.tracks, None, SWAPPED)
        if result.reason == IMPLAUSIBLE_STOP or not (result.reason or self._has_lost_many(search, result)):
            return result
        wide = self._follow(search, search.guess, wide=True)
        result = wide if result.reason else max(result, wide, key=_count_agreeing)
        if not (result.reason or self._has_lost_many(search, result)):
            return result
        described = self._match_descriptors(search)
        if described is None:
            return result
        return described if result.reason else max(result, described, key=_count_agreeing)

    def _has_lost_many(self, search: "_Search", result: TrackingResult) -> bool:
        """Whether so few points agree with a motion that a wider search may find more and another one."""
        return _count_agreeing(result) < self._motion_checks.min_followed_ratio * len(search.reference.points.ids)

    def follow(
        self, reference: StereoObservation, pair: Pair, predicted: MotionPrediction | None, calibration: Calibration
    ) -> TrackingResult:
        """Return the same as `track`, by optical flow alone."""
        search = _Search(reference, pair, predicted, calibration)
        return self._follow(search, search.guess, wide=False)

    def _follow(self, search: "_Search", guess: Array, wide: bool) -> TrackingResult:
        """Follow the points from a guess (4, 4), and once more from what that gives if it is far from the guess."""
        tracks = self._front_end.follow(search.reference, search.pair, guess, search.calibration, wide)
        result = self._check(search, tracks, guess)
        estimate = result.estimate
        if estimate is None or not jump_reason(estimate.T_first_second, guess, self._motion_checks):
            return result
        # Tracks that had to be found far from where they were looked for are few: look again where they are.
        guess = estimate.T_first_second
        tracks = self._front_end.follow(search.reference, search.pair, guess, search.calibration, wide)
        again = self._check(search, tracks, guess)
        better = again.estimate is not None and again.estimate.inliers.sum() >= estimate.inliers.sum()
        return again if better else result

    def _match_descriptors(self, search: "_Search") -> TrackingResult | None:
        """Track the pair by descriptors; None where they give no acceptable motion."""
        tracks = match_descriptors(
            search.reference.pair, search.pair, self._front_end.second_view, self._front_end.mask
        )
        result = self._check(search, tracks, search.guess)
        if result.estimate is None or self._stops_implausibly(search, result.estimate):
            return None
        # Two independent associations that agree on one motion may contradict the prediction.
        there = MotionPrediction(result.estimate.T_first_second)
        followed = self._follow(replace(search, predicted=there), there.T_reference_current, wide=False)
        if not followed.reason:
            return followed
        return None if result.reason else replace(result, followed=False)

    def _stops_implausibly(self, search: "_Search", estimate: TwoViewEstimate) -> bool:
        predicted = search.predicted
        return predicted is not None and stops_implausibly(estimate.T_first_second, predicted, self._motion_checks)

    def _check(self, search: "_Search", tracks: StereoTracks, guess: Array) -> TrackingResult:
        """Estimate the motion of tracks and check it."""
        estimate = None
        if tracks.has_depth.sum() >= self._motion_checks.min_tracks:
            estimate = self._estimate(search, tracks, guess)
            estimate = self._prefer_predicted(search, tracks, estimate)
        reason = rejection_reason(estimate, search.predicted, self._motion_checks)
        if estimate is None and len(tracks) >= self._motion_checks.min_tracks:
            reason = f"fewer than {self._motion_checks.min_tracks} of the points that could be followed have a depth"
        return TrackingResult(tracks, estimate, reason)

    def _estimate(self, search: "_Search", tracks: StereoTracks, guess: Array) -> TwoViewEstimate:
        """Find the motion near the guess if it passes the checks, else the one that most tracks agree with."""
        estimate = estimate_motion(tracks, search.calibration, guess, self._adjustment)
        if search.predicted is not None and not rejection_reason(estimate, search.predicted, self._motion_checks):
            return estimate
        other = ransac_motion(tracks, search.calibration)
        if other is None:
            return estimate
        second = estimate_motion(tracks, search.calibration, other, self._adjustment)
        return min(estimate, second, key=lambda found: found.noise_px)

    def _prefer_predicted(self, search: "_Search", tracks: StereoTracks, estimate: TwoViewEstimate) -> TwoViewEstimate:
        """Prefer the motion of a minority if it was predicted and that of most was not: they are another vehicle."""
        rest, config = ~estimate.inliers, self._motion_checks
        if search.predicted is None or (rest & tracks.has_depth).sum() < config.min_tracks:
            return estimate
        T_predicted = search.predicted.T_reference_current
        deviation = deviation_in_jumps(estimate.T_first_second, T_predicted, config)
        if deviation < config.minority_search_ratio * search.predicted.frames:
            return estimate
        other = estimate_motion(tracks.select(rest), search.calibration, search.guess, self._adjustment)
        inliers = np.zeros(len(tracks), dtype=bool)
        inliers[rest] = other.inliers
        other = replace(other, inliers=inliers)
        nearer = deviation_in_jumps(other.T_first_second, T_predicted, config) < 0.5 * deviation
        return other if nearer and not rejection_reason(other, search.predicted, config) else estimate


@dataclass(frozen=True)
class _Search:
    """A pair of images and what it is tracked against.

    Attributes:
        reference: observation that motion is measured from.
        pair: the new images.
        predicted: predicted motion of the pair, or None.
        calibration: error of the pair's calibration.
    """

    reference: StereoObservation
    pair: Pair
    predicted: MotionPrediction | None
    calibration: Calibration

    @property
    def guess(self) -> Array:
        """Pose (4, 4) of the pair in the reference frame where the search begins."""
        return np.eye(4) if self.predicted is None else self.predicted.T_reference_current


def match_descriptors(first: Pair, second: Pair, second_view: SecondView, mask: Image | None = None) -> StereoTracks:
    """Match points of two pairs of images (H, W) uint8, anywhere in them but where the mask is 0; there may be none."""
    sift = cv2.SIFT.create(_MAX_SIFT_FEATURES)
    pixels, descriptors = zip(*(_describe(sift, pair[0], mask) for pair in (first, second)), strict=True)
    index = np.zeros((0, 2), np.int64)
    if min(len(pixels[0]), len(pixels[1])) >= 2:
        index = _match_mutually(*descriptors)
    left = [pixels[0][index[:, 0]], pixels[1][index[:, 1]]]
    right = [second_view.find(pair, places) for pair, places in zip((first, second), left, strict=True)]
    seen = second_view.are_usable(right[0]) & second_view.are_usable(right[1])
    unnumbered = np.full(int(seen.sum()), -1)  # descriptors start no track
    return StereoTracks(left[0][seen], right[0][seen], left[1][seen], right[1][seen], unnumbered, second_view.noise)


def _describe(sift: cv2.SIFT, image: Image, mask: Image | None) -> tuple[Array, NDArray[np.float32]]:
    """Pixels (N, 2) and descriptors (N, 128) of the SIFT features of an image (H, W) uint8."""
    keypoints, descriptors = sift.detectAndCompute(image, mask)
    pixels = np.array([point.pt for point in keypoints], dtype=np.float64).reshape(-1, 2)
    return pixels, np.zeros((0, 128), np.float32) if descriptors is None else descriptors


def _match_mutually(first: NDArray[np.float32], second: NDArray[np.float32]) -> NDArray[np.int64]:
    """Pairs of indices (M, 2) of descriptors that are each other's nearest neighbour and pass the ratio test."""
    forward = cv2.BFMatcher(cv2.NORM_L2).knnMatch(first, second, k=2)
    back = {match.queryIdx: match.trainIdx for match in cv2.BFMatcher(cv2.NORM_L2).match(second, first)}
    chosen = [
        (best.queryIdx, best.trainIdx)
        for best, other in forward
        if best.distance < _MAX_SIFT_RATIO * other.distance and back[best.trainIdx] == best.queryIdx
    ]
    return np.array(chosen, dtype=np.int64).reshape(-1, 2)
