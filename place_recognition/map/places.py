"""Places: stretches of the way whose images share something that stays in view, and the words of each.

Tsintotas, Bampis, Gasteratos, 'Assigning Visual Words to Places for Loop Closure Detection', ICRA 2018, section III-B.
"""

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.belief.matching import mutual_matches
from place_recognition.map.growing import GrowingArray
from place_recognition.map.word_index import WordIndex

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class PlaceConfig:
    """When a place ends.

    Attributes:
        least_features: an image with fewer says nothing about the place, xi in the paper.
        coherent: descriptors that must be matched through all images of a place; with fewer the next one begins.
        ratio: nearest to second nearest descriptor distance of such a match.
        longest: images of a place at most: while one stands still everything stays in view.
    """

    least_features: int = 5
    coherent: int = 2
    ratio: float = 0.75
    longest: int = 15


class PlaceFormation:
    """Cuts the way into places by the coherence of feature matches (ICRA 2018, equations 1 and 2).

    The paper's program takes the image that shares nothing for the last of the old place; here it is the first of the
    new one, with whose images it does share something.
    """

    def __init__(self, config: PlaceConfig | None = None) -> None:
        self.config = config or PlaceConfig()
        self._images: list[Floats] = []
        self._carried: Floats | None = None

    def add(self, descriptors: Floats) -> list[Floats]:
        """Take the descriptors (N, D) of the next image.

        Returns:
            The descriptors of each image of the place that has ended before this image; none while it goes on.
        """
        ended: list[Floats] = []
        carried = self._carry(descriptors)
        if len(self._images) == self.config.longest or (carried is not None and len(carried) < self.config.coherent):
            ended = self.flush()
            carried = self._carry(descriptors)
        self._images.append(descriptors)
        self._carried = carried
        return ended

    def flush(self) -> list[Floats]:
        """End the open place; the descriptors of each of its images, none where there is no open place."""
        ended, self._images, self._carried = self._images, [], None
        return ended

    def _carry(self, descriptors: Floats) -> Floats | None:
        """What would be matched through the place with this image; None while no image has said anything."""
        if len(descriptors) < self.config.least_features:
            return self._carried
        if self._carried is None:
            return descriptors
        pairs = mutual_matches(self._carried, descriptors, self.config.ratio)
        return descriptors[pairs[:, 1]]

    def state(self) -> dict[str, Any]:
        """The open place, for a checkpoint."""
        return {"images": list(self._images), "carried": self._carried}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._images, self._carried = list(state["images"]), state["carried"]


class PlaceMap:
    """All places that have ended, in order: which images and which words are whose.

    The words themselves live in the index alone, and get there when their place may be matched; until then they wait.
    """

    def __init__(self, index: WordIndex) -> None:
        self._index = index
        self._last: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._words_until: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._waiting: deque[Floats] = deque()

    def __len__(self) -> int:
        return len(self._last)

    @property
    def _ends(self) -> Indices:
        """(P,) last location of each place."""
        return self._last.rows.reshape(-1)

    @property
    def _until(self) -> Indices:
        """(P,) words of each place and all before it."""
        return self._words_until.rows.reshape(-1)

    @property
    def word_count(self) -> int:
        """Words of all places."""
        return int(self._until[-1]) if len(self) else 0

    def add(self, words: Floats, last: int) -> None:
        """Append a place of words (K, D), maybe none, whose last image is at a location."""
        self._words_until.extend(np.array([self.word_count + len(words)]))
        self._last.extend(np.array([last]))
        self._waiting.append(words)

    def until(self, location: int) -> int:
        """Places that end at a location or before; their words can be found from now on."""
        count = int(np.searchsorted(self._ends, location, side="right"))
        while self._waiting and len(self) - len(self._waiting) < count:
            self._index.add(self._waiting.popleft())
        return count

    def nearest_words(self, descriptors: Floats) -> Indices:
        """The word (N,) nearest to each of descriptors (N, D); none while no word can be found."""
        if len(self._index) == 0 or len(descriptors) == 0:
            return np.empty(0, np.int64)
        return self._index.nearest(descriptors)

    def owners(self, words: Indices) -> Indices:
        """The place (N,) of each word (N,)."""
        return np.searchsorted(self._until, words, side="right").astype(np.int64)

    def word_counts(self, places: Indices) -> Indices:
        """Words (N,) of each place (N,)."""
        until = self._until
        return until[places] - np.where(places > 0, until[places - 1], 0)

    def words_of_first(self, places: int) -> int:
        """Words of the first so many places together."""
        return int(self._until[places - 1]) if places else 0

    def images(self, place: int) -> range:
        """Locations of a place."""
        begin = int(self._ends[place - 1]) + 1 if place else 0
        return range(begin, int(self._ends[place]) + 1)

    def place_of(self, location: int) -> int:
        """The place to which a location belongs, which has ended."""
        return int(np.searchsorted(self._ends, location))

    def state(self) -> dict[str, Any]:
        """All places that have ended, for a checkpoint."""
        return {
            "index": self._index.state(),
            "last_images": self._last.state(),
            "words_until": self._words_until.state(),
            "waiting": list(self._waiting),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._index.restore(state["index"])
        self._last.restore(state["last_images"])
        self._words_until.restore(state["words_until"])
        self._waiting = deque(state["waiting"])
