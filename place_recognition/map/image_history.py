"""The images observed so far: their ids, the distance travelled, and their features."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.growing_array import GrowingArray
from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.map.feature_store import FeatureStore

Ids = NDArray[np.int64]


class ImageTimeline:
    """Id and distance travelled of each image, by location (0, 1, 2, ...) in the order of observation."""

    def __init__(self) -> None:
        self._ids: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._distances_m: GrowingArray[np.float64] = GrowingArray(np.float64)

    def __len__(self) -> int:
        return len(self._ids)

    @property
    def ids(self) -> Ids:
        """(N,) id of the image at each location."""
        return self._ids.rows.reshape(-1)

    @property
    def is_distance_measured(self) -> bool:
        """Whether the distance travelled is known, and has not always been the same."""
        distances_m = self._distances_m.rows
        return bool(np.isfinite(distances_m[-1]) and distances_m[-1] != distances_m[0])

    def add(self, image_id: int, distance_travelled_m: float) -> None:
        """Append an image.

        Args:
            image_id: greater than that of the image before.
            distance_travelled_m: length of the path so far, metres; NaN, or always the same value, where it is not
                measured.

        Raises:
            ValueError: the id is not greater.
        """
        if len(self) and image_id <= self.ids[-1]:
            raise ValueError(f"expected an image id greater than {self.ids[-1]}, got {image_id}")
        self._ids.extend(np.array([image_id]))
        self._distances_m.extend(np.array([distance_travelled_m], np.float64))

    def last_behind(self, min_distance_m: float) -> int:
        """Find the latest location at least so far behind the latest image; -1 for none.

        Every location counts as far enough while the distance is not measured.
        """
        distances_m = self._distances_m.rows
        if not self.is_distance_measured:
            return len(self) - 1
        return int(np.searchsorted(distances_m, distances_m[-1] - min_distance_m, side="right")) - 1

    def find_location(self, image_id: int) -> int:
        """Find the location of an image.

        Raises:
            ValueError: no image of this id was added.
        """
        location = int(np.searchsorted(self.ids, image_id))
        if location == len(self) or self.ids[location] != image_id:
            raise ValueError(f"expected the id of an image that was observed, got {image_id}")
        return location

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {"image_ids": self._ids.state(), "distances_m": self._distances_m.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._ids.restore(state["image_ids"])
        self._distances_m.restore(state["distances_m"])


@dataclass(frozen=True)
class ImageHistoryConfig:
    """What is kept of each image.

    Attributes:
        max_stored_features: number of the strongest features of each image that are kept.
    """

    max_stored_features: int = 500


class ImageHistory:
    """All images in order, by location (0, 1, 2, ...), with their ids, distances and features.

    Attributes:
        images: stored features of each image, by location.
    """

    def __init__(self, config: ImageHistoryConfig | None = None) -> None:
        self.images = FeatureStore((config or ImageHistoryConfig()).max_stored_features)
        self._timeline = ImageTimeline()

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

    def add(self, image_id: int, features: LocalFeatures, distance_travelled_m: float) -> int:
        """Append an image and return its location.

        Args:
            image_id: greater than the one before.
            features: local features of the image, strongest first.
            distance_travelled_m: length of the path so far, metres; NaN, or always the same value, where it is not
                measured.
        """
        self._timeline.add(image_id, distance_travelled_m)
        self.images.add(features)
        return self.latest

    def find_location(self, image_id: int) -> int:
        """Find the location of an image.

        Raises:
            ValueError: no image of this id was added.
        """
        return self._timeline.find_location(image_id)

    def last_behind(self, min_distance_m: float) -> int:
        """Find the latest location at least so far behind the latest image; all are, while no distance is measured."""
        return self._timeline.last_behind(min_distance_m)

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {"features": self.images.state(), "timeline": self._timeline.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self.images.restore(state["features"])
        self._timeline.restore(state["timeline"])
