"""Where a pair of images was taken, seen from a reference: by following points, more widely, by descriptors."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from odometry.calibration import Calibration
from odometry.front_end import FrontEnd, Pair, View
from odometry.plausibility import STOPS, Expectation, PlausibilityConfig, brakes, distance, doubt, jump
from odometry.relocation import associate
from odometry.two_views import AdjustmentConfig, StereoTracks, TwoViewEstimate, estimate_motion, ransac_motion

Array = NDArray[np.float64]

SWAPPED = "the left and the right image are swapped"
_FEW = 0.5  # share of the reference's points that a swapped pair does not show


@dataclass(frozen=True)
class Located:
    """What was found out about a pair.

    Attributes:
        tracks: points of the reference that the pair shows.
        estimate: where the pair is; None with too few tracks.
        reason: why that is not to be believed; empty if it is.
        followed: the points were followed, so that their tracks go on.

    """

    tracks: StereoTracks
    estimate: TwoViewEstimate | None
    reason: str
    followed: bool = True


class Locator:
    """Tries one association after the other, the cheapest first, until one can be believed."""

    def __init__(self, front_end: FrontEnd, adjustment: AdjustmentConfig, plausibility: PlausibilityConfig) -> None:
        self._front_end, self._adjustment, self._plausibility = front_end, adjustment, plausibility

    def locate(self, reference: View, pair: Pair, expected: Expectation | None, calibration: Calibration) -> Located:
        """Estimate T_reference_pair from images (H, W) uint8, whatever is expected of it, or None."""
        search = _Search(reference, pair, expected, calibration)
        found = self._follow(search, search.guess, wide=False)
        few = len(found.tracks) < _FEW * len(reference.points.ids)
        if (found.reason or few) and self._front_end.swapped(pair):
            return Located(found.tracks, None, SWAPPED)
        if found.reason in ("", STOPS):
            return found
        found = self._follow(search, search.guess, wide=True)
        return self._relocate(search) or found if found.reason else found

    def _follow(self, search: "_Search", guess: Array, wide: bool) -> Located:
        found = self._judge(search, self._front_end.follow(*search.views, guess, search.calibration, wide), guess)
        estimate = found.estimate
        if estimate is None or not jump(estimate.T_first_second, guess, self._plausibility):
            return found
        # Tracks that had to be found far from where they were looked for are few: look again where they are.
        guess = estimate.T_first_second
        again = self._judge(search, self._front_end.follow(*search.views, guess, search.calibration, wide), guess)
        better = again.estimate is not None and again.estimate.inliers.sum() >= estimate.inliers.sum()
        return again if better else found

    def _relocate(self, search: "_Search") -> Located | None:
        """Find the pair by descriptors; None where they do not tell."""
        tracks = associate(search.reference.pair, search.pair, self._front_end.matching)
        found = self._judge(search, tracks, search.guess)
        if found.estimate is None or self._brakes(search, found.estimate):
            return None
        # Two associations that agree on one motion, independently, may contradict what was expected.
        there = Expectation(found.estimate.T_first_second)
        followed = self._follow(replace(search, expected=there), there.T, wide=False)
        if not followed.reason:
            return followed
        return None if found.reason else replace(found, followed=False)

    def _brakes(self, search: "_Search", estimate: TwoViewEstimate) -> bool:
        return search.expected is not None and brakes(estimate.T_first_second, search.expected, self._plausibility)

    def _judge(self, search: "_Search", tracks: StereoTracks, guess: Array) -> Located:
        estimate = None
        if len(tracks) >= self._plausibility.tracks:
            estimate = self._estimate(search, tracks, guess)
            estimate = self._as_expected(search, tracks, estimate)
        return Located(tracks, estimate, doubt(estimate, search.expected, self._plausibility))

    def _estimate(self, search: "_Search", tracks: StereoTracks, guess: Array) -> TwoViewEstimate:
        """Find the motion near the guess if it can be believed, else the one that most tracks agree with."""
        estimate = estimate_motion(tracks, search.calibration, guess, self._adjustment)
        if search.expected is not None and not doubt(estimate, search.expected, self._plausibility):
            return estimate
        other = ransac_motion(tracks, search.calibration)
        if other is None:
            return estimate
        second = estimate_motion(tracks, search.calibration, other, self._adjustment)
        return min(estimate, second, key=lambda found: found.noise_px)

    def _as_expected(self, search: "_Search", tracks: StereoTracks, estimate: TwoViewEstimate) -> TwoViewEstimate:
        """Prefer the motion of a minority if it was expected and that of most was not: they are another car."""
        rest = ~estimate.inliers
        if search.expected is None or rest.sum() < self._plausibility.tracks:
            return estimate
        surprise = distance(estimate.T_first_second, search.expected.T, self._plausibility)
        if surprise < self._plausibility.surprise * search.expected.steps:
            return estimate
        other = estimate_motion(tracks.only(rest), search.calibration, search.guess, self._adjustment)
        inliers = np.zeros(len(tracks), dtype=bool)
        inliers[rest] = other.inliers
        other = replace(other, inliers=inliers)
        nearer = distance(other.T_first_second, search.expected.T, self._plausibility) < 0.5 * surprise
        return other if nearer and not doubt(other, search.expected, self._plausibility) else estimate


@dataclass(frozen=True)
class _Search:
    """What is looked for where.

    Attributes:
        reference: what motion is measured from.
        pair: the new images.
        expected: what is expected of them, or None.
        calibration: error of the pair's calibration.

    """

    reference: View
    pair: Pair
    expected: Expectation | None
    calibration: Calibration

    @property
    def guess(self) -> Array:
        """Where to look first, (4, 4)."""
        return np.eye(4) if self.expected is None else self.expected.T

    @property
    def views(self) -> tuple[View, Pair]:
        """The two to be compared."""
        return self.reference, self.pair
