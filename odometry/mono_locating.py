"""Where an image was taken, seen from the map: by following the points of an earlier image, then more widely."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odometry.bundle import Bundle
from odometry.mono_tracks import Followed, MonoFrontEnd, Tracks
from odometry.placing import Placed, PlacingConfig, place
from odometry.plausibility import Expectation, PlausibilityConfig, doubt, jump

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class Located:
    """What was found out about an image.

    Attributes:
        followed: points of the reference that it shows.
        placed: where it was taken; None with too few points.
        reason: why that is not to be believed; empty if it is.

    """

    followed: Followed
    placed: Placed | None
    reason: str


@dataclass(frozen=True)
class Known:
    """An image whose place in the map is known.

    Attributes:
        tracks: its points.
        T_map_camera: (4, 4) where it was taken.

    """

    tracks: Tracks
    T_map_camera: Array


class MonoLocator:
    """Follows points from an image of known place, and places the next one by them."""

    def __init__(
        self, front_end: MonoFrontEnd, bundle: Bundle, placing: PlacingConfig, plausibility: PlausibilityConfig
    ) -> None:
        self._front_end, self._bundle = front_end, bundle
        self._placing, self._plausibility = placing, plausibility

    def locate(self, reference: Known, image: Image, expected: Expectation | None) -> Located:
        """Place an image (H, W) uint8, whatever is expected of its motion since the reference, or None."""
        guess = np.eye(4) if expected is None else expected.T
        found = self._judged(reference, image, guess, expected, wide=False)
        return self._judged(reference, image, guess, expected, wide=True) if found.reason else found

    def _judged(
        self, reference: Known, image: Image, guess: Array, expected: Expectation | None, wide: bool
    ) -> Located:
        followed, placed = self._follow(reference, image, guess, wide)
        if placed is not None and jump(placed.T_first_second, guess, self._plausibility):
            # Tracks that had to be found far from where they were looked for are few: look again where they are.
            again, second = self._follow(reference, image, placed.T_first_second, wide)
            if second is not None and second.inliers.sum() >= placed.inliers.sum():
                followed, placed = again, second
        return Located(followed, placed, doubt(placed, expected, self._plausibility))

    def _follow(self, reference: Known, image: Image, guess: Array, wide: bool) -> tuple[Followed, Placed | None]:
        ahead = self._bundle.predict(reference.tracks.ids, reference.T_map_camera @ guess)
        followed = self._front_end.follow(reference.tracks, image, ahead, wide)
        if len(followed.tracks) < self._plausibility.tracks:
            return followed, None
        return followed, place(self._bundle, followed.tracks, reference.T_map_camera, guess, self._placing)
