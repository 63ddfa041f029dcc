"""The images observed so far with their features, and which of them may be matched with the latest one."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.image_processing.matching import count_matches
from place_recognition.map.feature_store import FeatureStore
from place_recognition.map.image_timeline import Ids, ImageTimeline

# Locations by which the beginning of the present view advances at most for each new image: bounds the time that an
# image takes when the view of a long stop ends.
MAX_VIEW_STEPS = 8


@dataclass(frozen=True)
class ImageHistoryConfig:
    """Features kept of each image, and the extent of the exclusion window before the latest one.

    Attributes:
        max_stored_features: number of the strongest features of each image that are kept.
        min_gap_frames: number of images between the beginning of the present view and the latest match candidate.
        min_distance_m: minimum path length between an image and its match; ignored while no distance is measured.
        min_shared_features: minimum number of matched descriptors by which two images show one view; images of
            different places share few by chance.
        view_features: number of the strongest features of each image that are compared for this.
        max_ratio: maximum ratio of the nearest to the second nearest descriptor distance of such a match.
        exclusion_frames: images nearer than this to the latest one are never matched, whatever the view; 0 leaves it to
            the view. For comparisons with papers, which exclude a time.
    """

    max_stored_features: int = 500
    min_gap_frames: int = 10
    min_distance_m: float = 20.0
    min_shared_features: int = 15
    view_features: int = 150
    max_ratio: float = 0.8
    exclusion_frames: int = 0


class ImageHistory:
    """All images in order, by location (0, 1, 2, ...), with their ids, distances and features.

    The images just behind are no revisits. How far they reach depends on the speed, on the view and on stops, so the
    exclusion window adapts: the present view begins at the earliest image that still shares descriptors with the latest
    one. The fixed time of the papers is too long for a short loop and too short at a red light.

    Attributes:
        config: the settings.
        images: stored features of each image, by location.
    """

    def __init__(self, config: ImageHistoryConfig | None = None) -> None:
        self.config = config or ImageHistoryConfig()
        self.images = FeatureStore(self.config.max_stored_features)
        self._timeline = ImageTimeline()
        self._view_begin = 0

    def __len__(self) -> int:
        return len(self._timeline)

    @property
    def ids(self) -> Ids:
        """(N,) id of the image at each location."""
        return self._timeline.ids

    @property
    def latest(self) -> int:
        """Location of the latest image, -1 before the first."""
        return len(self) - 1

    @property
    def is_distance_measured(self) -> bool:
        """Whether the distance travelled is known, and has not always been the same."""
        return self._timeline.is_distance_measured

    def add(self, image_id: int, features: LocalFeatures, distance_travelled_m: float) -> int:
        """Append an image and return its location.

        Args:
            image_id: greater than that of the image before.
            features: local features of the image, strongest first.
            distance_travelled_m: length of the path so far, metres; NaN, or always the same value, where it is not
                measured.
        """
        self._timeline.add(image_id, distance_travelled_m)
        self.images.add(features)
        self._follow_view()
        return self.latest

    def find_location(self, image_id: int) -> int:
        """Find the location of an image.

        Raises:
            ValueError: no image of this id was added.
        """
        return self._timeline.find_location(image_id)

    def last_outside_exclusion(self) -> int:
        """Find the latest location far enough behind in images and distance; -1 or less for none."""
        by_count = self.latest - max(self.config.min_gap_frames, self.config.exclusion_frames)
        return min(by_count, self._timeline.last_behind(self.config.min_distance_m))

    def last_matchable(self) -> int:
        """Find the latest location that is far enough behind and out of the present view; -1 for none."""
        return max(min(self._view_begin - self.config.min_gap_frames, self.last_outside_exclusion()), -1)

    def _follow_view(self) -> None:
        """Advance the beginning of the view past the images that share nothing with the latest one any more."""
        newest = self.images[self.latest].strongest(self.config.view_features).quantized
        if len(newest) < self.config.min_shared_features:
            return  # a blank image shares nothing with any other, and would end every view
        for _ in range(MAX_VIEW_STEPS):
            if self._view_begin >= self.latest or self._shared_with_begin(newest) >= self.config.min_shared_features:
                return
            self._view_begin += 1

    def _shared_with_begin(self, newest: NDArray[np.int8]) -> int:
        begin = self.images.strongest([self._view_begin], self.config.view_features)
        return int(count_matches(newest, *begin, self.config.max_ratio)[0])

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {
            "features": self.images.state(),
            "timeline": self._timeline.state(),
            "view_begin": self._view_begin,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self.images.restore(state["features"])
        self._timeline.restore(state["timeline"])
        self._view_begin = state["view_begin"]
