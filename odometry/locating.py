"""Where a pair of images was taken, seen from a reference: by following points, more widely, by descriptors."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry.calibration import Calibration
from odometry.front_end import FrontEnd, Pair, View
from odometry.plausibility import PlausibilityConfig, doubt, jump
from odometry.relocation import associate
from odometry.two_views import AdjustmentConfig, StereoTracks, TwoViewEstimate, estimate_motion, ransac_motion

Array = NDArray[np.float64]


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

    def locate(self, reference: View, pair: Pair, expected: Array | None, calibration: Calibration) -> Located:
        """Estimate T_reference_pair, expected (4, 4) or not at all; images (H, W) uint8."""
        for wide in (False, True):
            found = self._follow(reference, pair, expected, calibration, wide)
            if not found.reason:
                return found
        return self._relocate(reference, pair, expected, calibration) or found

    def _follow(
        self, reference: View, pair: Pair, expected: Array | None, calibration: Calibration, wide: bool
    ) -> Located:
        guess = np.eye(4) if expected is None else expected
        found = self._judge(
            self._front_end.follow(reference, pair, guess, calibration, wide), guess, expected, calibration
        )
        estimate = found.estimate
        if estimate is None or not jump(estimate.T_first_second, guess, self._plausibility):
            return found
        # Tracks that had to be found far from where they were looked for are few: look again where they are.
        guess = estimate.T_first_second
        again = self._judge(
            self._front_end.follow(reference, pair, guess, calibration, wide), guess, expected, calibration
        )
        better = again.estimate is not None and again.estimate.inliers.sum() >= estimate.inliers.sum()
        return again if better else found

    def _relocate(
        self, reference: View, pair: Pair, expected: Array | None, calibration: Calibration
    ) -> Located | None:
        """Find the pair by descriptors; None where they do not tell."""
        tracks = associate(reference.pair, pair, self._front_end.matching)
        guess = np.eye(4) if expected is None else expected
        found = self._judge(tracks, guess, expected, calibration)
        if found.estimate is None:
            return None
        # Two associations that agree on one motion, independently, may contradict what was expected.
        there = found.estimate.T_first_second
        followed = self._follow(reference, pair, there, calibration, wide=False)
        if not followed.reason:
            return followed
        return None if found.reason else Located(tracks, found.estimate, "", followed=False)

    def _judge(self, tracks: StereoTracks, guess: Array, expected: Array | None, calibration: Calibration) -> Located:
        estimate = self._estimate(tracks, guess, expected, calibration)
        return Located(tracks, estimate, doubt(estimate, expected, self._plausibility))

    def _estimate(
        self, tracks: StereoTracks, guess: Array, expected: Array | None, calibration: Calibration
    ) -> TwoViewEstimate | None:
        """Find the motion near the guess if it can be believed, else the one that most tracks agree with."""
        if len(tracks) < self._plausibility.tracks:
            return None
        estimate = estimate_motion(tracks, calibration, guess, self._adjustment)
        if expected is not None and not doubt(estimate, expected, self._plausibility):
            return estimate
        other = ransac_motion(tracks, calibration)
        if other is None:
            return estimate
        second = estimate_motion(tracks, calibration, other, self._adjustment)
        return min(estimate, second, key=lambda found: found.noise_px)
