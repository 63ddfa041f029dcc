"""The images observed so far: their ids, the distance travelled, and their features."""

from dataclasses import dataclass
from typing import Any

from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.map.feature_store import FeatureStore
from place_recognition.map.image_timeline import Ids, ImageTimeline


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
