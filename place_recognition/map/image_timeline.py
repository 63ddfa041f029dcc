"""Ids and path lengths of all images, from which every exclusion window derives what is far behind."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.growing_array import GrowingArray

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
