"""Where the present ends and the past begins, for recognisers that know images only as a whole."""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.thumbnail import (
    MIDDLE,
    ThumbnailConfig,
    make_thumbnail,
    mean_absolute_difference,
)
from place_recognition.map.growing import GrowingArray

Picture = NDArray[np.uint8]

STEPS = 8  # images by which the beginning of the present view advances at most for each new image


@dataclass(frozen=True)
class PresentViewConfig:
    """What counts as the present rather than the past.

    Attributes:
        least_gap: images between the beginning of the present view and the latest image that may be matched.
        least_way: way between an image and its match, metres; ignored while no way has been measured.
        connected: mean absolute difference of the thumbnails of two images of one view, at most, grey levels. In
            simulated streets images one metre apart differ by 23, three metres apart by 32, and unrelated ones by 42,
            only one in twenty of them by less than 36.
        thumbnail: what is compared.
        exclusion: images nearer than this to the latest are never matched, whatever the rest says; 0 leaves it to
            the rest. For comparisons with papers, which exclude a time.
    """

    least_gap: int = 10
    least_way: float = 20.0
    connected: float = 32.0
    thumbnail: ThumbnailConfig = field(default_factory=ThumbnailConfig)
    exclusion: int = 0


class PresentView:
    """Ids and ways of all images, by location (0, 1, 2, ...), and how many of them are past.

    `Route` finds the beginning of the present view by local features; this one by whole images, which tell a standing
    camera from a moving one. A fixed number of images and a way are kept besides.
    """

    def __init__(self, config: PresentViewConfig | None = None) -> None:
        self.config = config or PresentViewConfig()
        self._ids: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._ways: GrowingArray[np.float64] = GrowingArray(np.float64)
        self._view: deque[Picture] = deque()  # of the images since the beginning of the present view

    @property
    def ids(self) -> NDArray[np.int64]:
        """(N,) id of the image at each location."""
        return self._ids.rows.reshape(-1)

    def add(self, image_id: int, image: Picture, travelled: float) -> Picture:
        """Append an image (H, W) and return its thumbnail.

        Args:
            image_id: greater than the one before.
            image: grey, uint8.
            travelled: way driven so far, metres; NaN, or always the same, where it is not measured.
        """
        thumbnail = make_thumbnail(image, self.config.thumbnail)
        if len(self.ids) and image_id <= self.ids[-1]:
            raise ValueError(f"expected an image id greater than {self.ids[-1]}, got {image_id}")
        self._ids.extend(np.array([image_id]))
        self._ways.extend(np.array([travelled], np.float64))
        self._view.append(thumbnail)
        self._follow_view()
        return thumbnail

    def past(self) -> int:
        """Images that may be matched with the latest one: the first so many."""
        begin, admitted = len(self._ids) - len(self._view), len(self._ids) - 1 - self.config.exclusion
        return max(min(begin - self.config.least_gap, self._far_behind(), admitted) + 1, 0)

    def _far_behind(self) -> int:
        """The latest location that is far enough behind in way."""
        ways = self._ways.rows
        if not np.isfinite(ways[-1]) or ways[-1] == ways[0]:
            return len(ways) - 1
        return int(np.searchsorted(ways, ways[-1] - self.config.least_way, side="right")) - 1

    def _follow_view(self) -> None:
        """Let go of the images at the beginning of the view that are no longer like the latest one.

        A blank image says nothing about where the view begins, and cannot be where it begins.
        """
        newest = self._view[-1]
        if is_blank(newest):
            return
        for _ in range(STEPS):
            begin = self._view[0]
            alike = not is_blank(begin) and mean_absolute_difference(begin, newest) <= self.config.connected
            if len(self._view) == 1 or alike:
                return
            self._view.popleft()

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {"image_ids": self._ids.state(), "distances_m": self._ways.state(), "view": list(self._view)}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._ids.restore(state["image_ids"])
        self._ways.restore(state["distances_m"])
        self._view = deque(state["view"])


def is_blank(thumbnail: Picture) -> bool:
    """Whether there is nothing to see."""
    return bool((thumbnail == MIDDLE).all())
