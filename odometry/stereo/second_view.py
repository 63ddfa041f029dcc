"""The second view of a stereo pair: an image of a right camera, in which points are matched.

A depth camera takes the place of the right one: its second view is `odometry.stereo.depth_view`. Both give, for points
of the left image, their places in a right image, and say what these places are worth.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from odometry.klt_tracking import level_pair
from odometry.stereo.stereo_matching import Half, StereoMatchingConfig, halve, match_right, refine_right

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]
# The left image and the second view: the right image (H, W) uint8, or a depth image (H, W) float32, metres
Pair = tuple[Image, NDArray[Any]]

_MIN_CLEAR_DISPARITY_PX = 2.0  # larger disparities than a calibration error explains
_MIN_SWAPPED = 20  # points that must match only the other way round in a swapped pair


@dataclass(frozen=True)
class SecondViewNoise:
    """What the place of a point in a second view measures, and how well.

    Attributes:
        rows: independent measurements: column and row in a right image; of a depth image the column alone.
        weight: noise of a track in the left image over that of the disparity.
    """

    rows: int = 2
    weight: float = 1.0

    def weights(self, left: Array, right: Array, fill: bool = False) -> tuple[Array, Array]:
        """Places (N, 2) without gaps, and their weights (N,), of pixels (N, 2) left and right with NaN where unknown.

        An unknown disparity has weight 0; with `fill` it is expected to be the median of the others, give or take as
        much at least, so that the depth of the point is never without any bound.
        """
        known = np.isfinite(right[:, 0])
        if known.all():
            return right, np.full(len(left), self.weight)
        disparity = left[:, 0] - right[:, 0]
        median = max(float(np.median(disparity[known])), 1.0) if known.any() else 1.0
        places = np.where(known[:, None], right, left - [median, 0.0])
        return places, np.where(known, self.weight, _TRACK_NOISE_PX / median if fill else 0.0)


_TRACK_NOISE_PX = 0.05  # of a point tracked in the left image, at least
RIGHT_IMAGE_NOISE = SecondViewNoise()


class SecondView(Protocol):
    """Finds the points of a left image in the second view."""

    @property
    def noise(self) -> SecondViewNoise:
        """What the places are worth."""
        ...

    def check(self, left: Image, second: NDArray[Any], shape: tuple[int, int]) -> None:
        """Check that both images have a shape (H, W) and the type that is expected.

        Raises:
            ValueError: they do not.
        """
        ...

    def prepare(self, left: Image, second: NDArray[Any]) -> NDArray[Any]:
        """Make the second view comparable with the left image."""
        ...

    def find(self, pair: Pair, pixels: Array) -> Array:
        """Places (N, 2) in a right image of pixels (N, 2) of the left one; NaN where they are unknown."""
        ...

    def follow(self, pair: Pair, pixels: Array, guess: Array) -> Array:
        """Return the same as `find`, starting at a guess (N, 2)."""
        ...

    def are_usable(self, places: Array) -> Mask:
        """Which points (N,) may be used, by their places (N, 2)."""
        ...

    def is_swapped(self, pair: Pair, detect: Callable[[Image], Array]) -> bool:
        """Whether the left and the right image are swapped, by corners (N, 2) that are detected in either."""
        ...


class RightImage:
    """An image of the right camera of a rectified pair (a SecondView)."""

    noise = RIGHT_IMAGE_NOISE

    def __init__(self, matching: StereoMatchingConfig | None = None) -> None:
        self._matching = matching or StereoMatchingConfig()
        self._halved: tuple[Pair, tuple[Half, Half]] | None = None  # of the pair in which was searched last

    def check(self, left: Image, second: NDArray[Any], shape: tuple[int, int]) -> None:
        """Check that both images have the shape (H, W) and are uint8."""
        for side, image in (("left", left), ("right", second)):
            if image.shape != shape or image.dtype != np.uint8:
                raise ValueError(
                    f"expected the {side} image to be {shape} uint8 as the camera says, "
                    f"got left {left.shape} {left.dtype} and right {second.shape} {second.dtype}"
                )

    def prepare(self, left: Image, second: NDArray[Any]) -> NDArray[Any]:
        """Return the right image as bright as the left one."""
        return level_pair(left, second)

    def find(self, pair: Pair, pixels: Array) -> Array:
        """Places (N, 2) by a search along the rows."""
        if self._halved is None or self._halved[0] is not pair:  # callers may use one buffer for all images
            self._halved = pair, halve(*pair)
        return match_right(*pair, pixels, self._matching, self._halved[1])

    def follow(self, pair: Pair, pixels: Array, guess: Array) -> Array:
        """Places (N, 2) by Lucas and Kanade's tracker."""
        return refine_right(pair, pixels, guess, self._matching)

    def are_usable(self, places: Array) -> Mask:
        """Which places were found: the tracker has not confirmed the others."""
        return np.isfinite(places[:, 0])

    def is_swapped(self, pair: Pair, detect: Callable[[Image], Array]) -> bool:
        """Whether far more points match the other way round."""
        counts = []
        for one, other in (pair, pair[::-1]):
            corners = detect(one)
            shifts = corners[:, 0] - match_right(one, other, corners, self._matching)[:, 0]
            counts.append(int((shifts > _MIN_CLEAR_DISPARITY_PX).sum()))
        return counts[1] > max(_MIN_SWAPPED, 3 * counts[0])
