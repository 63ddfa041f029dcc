"""The images seen so far, and which of them are past enough to be matched with the latest one."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.belief.quantised_matching import count_matches
from place_recognition.image_processing.features import LocalFeatures
from place_recognition.map.growing import GrowingArray
from place_recognition.map.image_store import ImageStore

Ids = NDArray[np.int64]

STEPS = 8  # images by which the beginning of the present view advances at most for each new image


@dataclass(frozen=True)
class RouteConfig:
    """What is kept of each image, and what counts as the present rather than the past.

    Attributes:
        stored: strongest features of each image that are kept.
        least_gap: images between the beginning of the present view and the latest image that may be matched.
        least_way: way between an image and its match, metres; ignored while no way has been measured.
        connected: descriptors that two images of one view share; images of different places share few by chance.
        compared: strongest features of each of the two that are compared for this.
        ratio: nearest to second nearest descriptor distance of a match for this.
        exclusion: images nearer than this to the latest are never matched, whatever the rest says; 0 leaves it to
            the rest. For comparisons with papers, which exclude a time.
    """

    stored: int = 500
    least_gap: int = 10
    least_way: float = 20.0
    connected: int = 15
    compared: int = 150
    ratio: float = 0.8
    exclusion: int = 0


class Route:
    """All images in order, by location (0, 1, 2, ...), with their ids, ways and features.

    What lies just behind is no revisit. How far that reaches depends on the speed, on the view and on stops, so it is
    found out rather than set: the present view begins at the earliest image that still shares descriptors with the
    latest one. A time, as the papers take it, is too long for a short loop and too short at a red light.
    """

    def __init__(self, config: RouteConfig | None = None) -> None:
        self.config = config or RouteConfig()
        self.images = ImageStore(self.config.stored)
        self._ids: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._ways: GrowingArray[np.float64] = GrowingArray(np.float64)
        self._view_begin = 0

    def __len__(self) -> int:
        return len(self._ids)

    @property
    def ids(self) -> Ids:
        """(N,) id of the image at each location."""
        return self._ids.rows.reshape(-1)

    @property
    def latest(self) -> int:
        """Location of the latest image, -1 before the first."""
        return len(self._ids) - 1

    def add(self, image_id: int, features: LocalFeatures, travelled: float) -> int:
        """Append an image and return its location.

        Args:
            image_id: greater than the one before.
            features: strongest first.
            travelled: way driven so far, metres; NaN, or always the same, where it is not measured.
        """
        if len(self) and image_id <= self.ids[-1]:
            raise ValueError(f"expected an image id greater than {self.ids[-1]}, got {image_id}")
        self._ids.extend(np.array([image_id]))
        self._ways.extend(np.array([travelled], np.float64))
        self.images.add(features)
        self._follow_view()
        return self.latest

    def location(self, image_id: int) -> int:
        """Location of an image.

        Raises:
            ValueError: no image of this id was added.
        """
        location = int(np.searchsorted(self.ids, image_id))
        if location == len(self) or self.ids[location] != image_id:
            raise ValueError(f"expected the id of an image that was observed, got {image_id}")
        return location

    def guarded(self) -> int:
        """The latest location that is far enough behind in images and way; -1 or less for none."""
        return min(self.latest - max(self.config.least_gap, self.config.exclusion), self._far_behind())

    def horizon(self) -> int:
        """The latest location that may be matched: out of the present view, and far enough behind; -1 for none."""
        return max(min(self._view_begin - self.config.least_gap, self.guarded()), -1)

    @property
    def measured(self) -> bool:
        """Whether the way driven is measured: it is known, and has not always been the same."""
        ways = self._ways.rows
        return bool(np.isfinite(ways[-1]) and ways[-1] != ways[0])

    def way_since(self, location: int) -> float:
        """Way from an earlier image to the latest, metres; NaN where it is not measured."""
        ways = self._ways.rows
        return float(ways[-1] - ways[location])

    def _far_behind(self) -> int:
        ways = self._ways.rows
        if not self.measured:
            return self.latest
        return int(np.searchsorted(ways, ways[-1] - self.config.least_way, side="right")) - 1

    def _follow_view(self) -> None:
        """Advance the beginning of the view past the images that share nothing with the latest one any more.

        A blank image says nothing about where the view begins.
        """
        newest = self.images[self.latest].strongest(self.config.compared).quantised
        if len(newest) < self.config.connected:
            return
        for _ in range(STEPS):
            if self._view_begin >= self.latest or self._shared_with_begin(newest) >= self.config.connected:
                return
            self._view_begin += 1

    def _shared_with_begin(self, newest: NDArray[np.int8]) -> int:
        begin = self.images.strongest([self._view_begin], self.config.compared)
        return int(count_matches(newest, *begin, self.config.ratio)[0])

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {
            "features": self.images.state(),
            "image_ids": self._ids.state(),
            "distances_m": self._ways.state(),
            "view_begin": self._view_begin,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self.images.restore(state["features"])
        self._ids.restore(state["image_ids"])
        self._ways.restore(state["distances_m"])
        self._view_begin = state["view_begin"]
