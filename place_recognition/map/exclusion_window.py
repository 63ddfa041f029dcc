"""The exclusion window of recognisers that compare whole images: how many of the first images may be matched."""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.global_descriptors import (
    MIDDLE,
    ThumbnailConfig,
    make_thumbnail,
    mean_absolute_difference,
)
from place_recognition.map.image_timeline import Ids, ImageTimeline

Picture = NDArray[np.uint8]

MAX_VIEW_STEPS = 8  # as that of ImageHistory


@dataclass(frozen=True)
class ExclusionWindowConfig:
    """Extent of the exclusion window before the latest image.

    Attributes:
        min_gap_frames: number of images between the beginning of the present view and the latest match candidate.
        min_distance_m: minimum path length between an image and its match; ignored while no distance is measured.
        max_thumbnail_distance: maximum mean absolute difference of the thumbnails of two images of one view, grey
            levels. In simulated streets images one metre apart differ by 23, three metres apart by 32, and unrelated
            ones by 42, only one in twenty of them by less than 36.
        thumbnail: size and normalisation of the thumbnails.
        exclusion_frames: images nearer than this to the latest one are never matched, whatever the view; 0 leaves it to
            the view. For comparisons with papers, which exclude a time.
    """

    min_gap_frames: int = 10
    min_distance_m: float = 20.0
    max_thumbnail_distance: float = 32.0
    thumbnail: ThumbnailConfig = field(default_factory=ThumbnailConfig)
    exclusion_frames: int = 0


class ExclusionWindow:
    """Ids and distances of all images, by location (0, 1, 2, ...), and how many of them may be matched.

    `ImageHistory` finds the beginning of the present view by local features; this one by thumbnails, which differ
    between a standing camera and a moving one. A fixed number of images and a distance are excluded besides.
    """

    def __init__(self, config: ExclusionWindowConfig | None = None) -> None:
        self.config = config or ExclusionWindowConfig()
        self._timeline = ImageTimeline()
        self._view: deque[Picture] = deque()  # thumbnails from the beginning of the present view on

    @property
    def ids(self) -> Ids:
        """(N,) id of the image at each location."""
        return self._timeline.ids

    def add(self, image_id: int, image: Picture, distance_travelled_m: float) -> Picture:
        """Append an image and return its thumbnail.

        Args:
            image_id: greater than that of the image before.
            image: (H, W) uint8, grey.
            distance_travelled_m: length of the path so far, metres; NaN, or always the same value, where it is not
                measured.
        """
        thumbnail = make_thumbnail(image, self.config.thumbnail)
        self._timeline.add(image_id, distance_travelled_m)
        self._view.append(thumbnail)
        self._follow_view()
        return thumbnail

    def count_matchable(self) -> int:
        """Count the first images that may be matched with the latest one."""
        count = len(self._timeline)
        before_view = count - len(self._view) - self.config.min_gap_frames
        far_behind = self._timeline.last_behind(self.config.min_distance_m)
        return max(min(before_view, far_behind, count - 1 - self.config.exclusion_frames) + 1, 0)

    def _follow_view(self) -> None:
        """Drop the images at the beginning of the view that are no longer like the latest one."""
        newest = self._view[-1]
        if is_blank(newest):
            return  # a blank image resembles no other, and would end every view
        for _ in range(MAX_VIEW_STEPS):
            begin = self._view[0]
            limit = self.config.max_thumbnail_distance
            is_alike = not is_blank(begin) and mean_absolute_difference(begin, newest) <= limit
            if len(self._view) == 1 or is_alike:
                return
            self._view.popleft()

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {"timeline": self._timeline.state(), "view": list(self._view)}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._timeline.restore(state["timeline"])
        self._view = deque(state["view"])


def is_blank(thumbnail: Picture) -> bool:
    """Whether a thumbnail shows no structure at all."""
    return bool((thumbnail == MIDDLE).all())
