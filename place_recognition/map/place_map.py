"""Place segmentation and the place map: stretches of the path whose images share features, and the words of each.

Tsintotas, Bampis, Gasteratos, 'Assigning Visual Words to Places for Loop Closure Detection', ICRA 2018, section III-B.
"""

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.growing_array import GrowingArray
from place_recognition.image_processing.matching import mutual_matches
from place_recognition.vocabulary.word_tree import WordIndex

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class PlaceSegmentationConfig:
    """Conditions under which a place ends.

    Attributes:
        min_features: an image with fewer features does not count, xi in the paper.
        min_coherent_matches: minimum number of descriptors matched through all images of a place; with fewer the next
            place begins.
        max_ratio: maximum ratio of the nearest to the second nearest descriptor distance of such a match.
        max_images: maximum number of images of a place: a standing camera keeps everything in view.
    """

    min_features: int = 5
    min_coherent_matches: int = 2
    max_ratio: float = 0.75
    max_images: int = 15


class PlaceSegmentation:
    """Divides the path into places by the coherence of feature matches (ICRA 2018, equations 1 and 2).

    The paper's program takes the image that shares nothing for the last of the old place; here it is the first of the
    new one, with whose images it does share features.
    """

    def __init__(self, config: PlaceSegmentationConfig | None = None) -> None:
        self.config = config or PlaceSegmentationConfig()
        self._images: list[Floats] = []
        self._carried: Floats | None = None  # descriptors matched through all images of the open place

    def add(self, descriptors: Floats) -> list[Floats]:
        """Add the descriptors (N, D) of the next image.

        Returns:
            The descriptors of each image of the place that has ended before this image; empty while it goes on.
        """
        ended: list[Floats] = []
        carried = self._match_through(descriptors)
        is_incoherent = carried is not None and len(carried) < self.config.min_coherent_matches
        if len(self._images) == self.config.max_images or is_incoherent:
            ended = self.flush()
            carried = self._match_through(descriptors)
        self._images.append(descriptors)
        self._carried = carried
        return ended

    def flush(self) -> list[Floats]:
        """End the open place and return the descriptors of each of its images; empty where no place is open."""
        ended, self._images, self._carried = self._images, [], None
        return ended

    def _match_through(self, descriptors: Floats) -> Floats | None:
        """Return the descriptors matched through the place and this image; None before an image with features."""
        if len(descriptors) < self.config.min_features:
            return self._carried
        if self._carried is None:
            return descriptors
        pairs = mutual_matches(self._carried, descriptors, self.config.max_ratio)
        return descriptors[pairs[:, 1]]

    def state(self) -> dict[str, Any]:
        """The open place, for a checkpoint."""
        return {"images": list(self._images), "carried": self._carried}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._images, self._carried = list(state["images"]), state["carried"]


class PlaceMap:
    """All places that have ended, in order, with the images and the words of each.

    The words themselves are kept in the index alone, which they enter once their place may be matched.
    """

    def __init__(self, index: WordIndex) -> None:
        self._index = index
        self._last: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._word_ends: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._waiting: deque[Floats] = deque()

    def __len__(self) -> int:
        return len(self._last)

    @property
    def _last_locations(self) -> Indices:
        """(P,) last location of each place."""
        return self._last.rows.reshape(-1)

    @property
    def _cumulative_words(self) -> Indices:
        """(P,) number of words of each place and all places before it."""
        return self._word_ends.rows.reshape(-1)

    @property
    def word_count(self) -> int:
        """Number of words of all places."""
        return int(self._cumulative_words[-1]) if len(self) else 0

    def add(self, words: Floats, last: int) -> None:
        """Append a place.

        Args:
            words: (K, D) words of the place, possibly none.
            last: location of the last image of the place.
        """
        self._word_ends.extend(np.array([self.word_count + len(words)]))
        self._last.extend(np.array([last]))
        self._waiting.append(words)

    def activate_until(self, location: int) -> int:
        """Make the words of the places that end at a location or before searchable; return the number of places."""
        count = int(np.searchsorted(self._last_locations, location, side="right"))
        while self._waiting and len(self) - len(self._waiting) < count:
            self._index.add(self._waiting.popleft())
        return count

    def nearest_words(self, descriptors: Floats) -> Indices:
        """Find the word (N,) nearest to each of descriptors (N, D); (0,) while no word is searchable."""
        if len(self._index) == 0 or len(descriptors) == 0:
            return np.empty(0, np.int64)
        return self._index.nearest(descriptors)

    def places_of(self, words: Indices) -> Indices:
        """Find the place (N,) of each word (N,)."""
        return np.searchsorted(self._cumulative_words, words, side="right").astype(np.int64)

    def word_counts(self, places: Indices) -> Indices:
        """Count the words (N,) of each place (N,)."""
        ends = self._cumulative_words
        return ends[places] - np.where(places > 0, ends[places - 1], 0)

    def count_words_of_first(self, places: int) -> int:
        """Count the words of the first `places` places together."""
        return int(self._cumulative_words[places - 1]) if places else 0

    def images(self, place: int) -> range:
        """Return the locations of the images of a place."""
        begin = int(self._last_locations[place - 1]) + 1 if place else 0
        return range(begin, int(self._last_locations[place]) + 1)

    def spans(self, places: Indices) -> Indices:
        """Return the first and the last location (P, 2) of each of the places (P,)."""
        first = np.where(places > 0, self._last_locations[places - 1] + 1, 0)
        return np.stack([first, self._last_locations[places]], axis=1)

    def place_of(self, location: int) -> int:
        """Find the place that a location belongs to, which has ended."""
        return int(np.searchsorted(self._last_locations, location))

    def state(self) -> dict[str, Any]:
        """All places that have ended, for a checkpoint."""
        return {
            "index": self._index.state(),
            "last_images": self._last.state(),
            "words_until": self._word_ends.state(),
            "waiting": list(self._waiting),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._index.restore(state["index"])
        self._last.restore(state["last_images"])
        self._word_ends.restore(state["words_until"])
        self._waiting = deque(state["waiting"])
