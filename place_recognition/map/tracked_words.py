"""The map of the bag of tracked words: what was seen for long enough becomes a word, and knows where it was seen.

Tsintotas, Bampis, Gasteratos, 'Probabilistic Appearance-Based Place Recognition Through Bag of Tracked Words',
RA-L 4(2) 2019, sections III-A and III-B. A location is one image, counted from 0.
"""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.features import LocalFeatures
from place_recognition.image_processing.guided_tracking import (
    GuidedTrackingConfig,
    optical_flow,
    select_guided,
)
from place_recognition.map.growing import GrowingArray
from place_recognition.map.word_index import WordIndex

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class TrackConfig:
    """How features become words.

    Attributes:
        points: tracked at a time, nu in the paper.
        least_length: images a track must last to become a word, rho in the paper; less where none lasts so long.
        longest_share: quantile of the tracks' lengths that stands for the longest, c(t) in the paper.
        guided: when a feature continues a track.
    """

    points: int = 200
    least_length: int = 5
    longest_share: float = 0.95
    guided: GuidedTrackingConfig = field(default_factory=GuidedTrackingConfig)


@dataclass(frozen=True)
class Words:
    """Words with the images they were seen in.

    Attributes:
        descriptors: (K, D) float32, mean of the descriptors of a track; shorter than unit length.
        first, last: (K,) int64, first and last location of the track.
    """

    descriptors: Floats
    first: Indices
    last: Indices

    def __len__(self) -> int:
        return len(self.descriptors)


class FeatureTracks:
    """The points being followed now."""

    def __init__(self, config: TrackConfig) -> None:
        self.config = config
        self._image: NDArray[np.uint8] | None = None
        self._location = -1
        self._start_over()

    @property
    def descriptors(self) -> Floats:
        """(N, D) descriptors that the tracks have in the latest image: what the map is asked about."""
        return self._descriptors

    @property
    def longest(self) -> int:
        """Images that the longest track has lasted, but for the few that outlast all others; 0 without tracks.

        The paper takes the very longest. A speck on the lens or a cloud straight ahead never leaves the view, and one
        such track would keep the whole map from being searched.
        """
        if len(self._lengths) == 0:
            return 0
        return int(np.quantile(self._lengths, self.config.longest_share, method="lower"))

    def advance(self, image: NDArray[np.uint8], features: LocalFeatures) -> Words:
        """Follow the points into the next image (H, W) uint8 and return the words of the tracks that it ended."""
        chosen = np.empty(0, np.int64)
        if self._image is not None:
            positions = optical_flow(self._image, image, self._pixels, self.config.guided)
            chosen = select_guided(positions, self._descriptors, features, self.config.guided)
        ended = self._ended(chosen < 0)
        self._location += 1
        self._image = image.copy()
        self._continue(chosen, features)
        self._refill(features, chosen)
        return ended

    def _start_over(self) -> None:
        self._pixels = np.empty((0, 2), np.float32)
        self._descriptors = self._sums = np.empty((0, 0), np.float32)
        self._lengths = np.empty(0, np.int64)

    def _ended(self, lost: NDArray[np.bool_]) -> Words:
        """Words of the lost tracks that lasted long enough; they were last seen at the location so far.

        Where nothing stays in view for as long as it should, as in a corridor seen every two seconds, what stays
        longest has to do; but one image is no track.
        """
        word = lost & (self._lengths >= min(self.config.least_length, max(self.longest, 2)))
        lengths = self._lengths[word]
        last = np.full(len(lengths), self._location, np.int64)
        means = (self._sums[word] / lengths[:, None]).astype(np.float32)
        return Words(means, last - lengths + 1, last)

    def _continue(self, chosen: Indices, features: LocalFeatures) -> None:
        going, feature = np.flatnonzero(chosen >= 0), chosen[chosen >= 0]
        self._pixels, self._descriptors = features.pixels[feature], features.descriptors[feature]
        sums = self._sums[going] if len(going) else np.empty((0, features.descriptors.shape[1]), np.float32)
        self._sums = sums + self._descriptors
        self._lengths = self._lengths[going] + 1

    def _refill(self, features: LocalFeatures, chosen: Indices) -> None:
        """Start tracks at the strongest features that continue none."""
        unused = np.setdiff1d(np.arange(len(features)), chosen)[: max(self.config.points - len(self._lengths), 0)]
        self._pixels = np.concatenate([self._pixels, features.pixels[unused]])
        self._descriptors = np.concatenate([self._descriptors, features.descriptors[unused]])
        self._sums = np.concatenate([self._sums, features.descriptors[unused]])
        self._lengths = np.concatenate([self._lengths, np.ones(len(unused), np.int64)])

    def state(self) -> dict[str, Any]:
        """The tracks and the latest image, for a checkpoint."""
        return {
            "image": self._image,
            "location": self._location,
            "pixels": self._pixels,
            "descriptors": self._descriptors,
            "descriptor_sums": self._sums,
            "lengths": self._lengths,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._image, self._location = state["image"], state["location"]
        self._pixels, self._descriptors = state["pixels"], state["descriptors"]
        self._sums, self._lengths = state["descriptor_sums"], state["lengths"]


class WordMap:
    """All words, in the order in which their tracks ended; those that are past may be found.

    The index takes a word once the horizon has passed it, and the horizon never goes back.
    """

    def __init__(self, index: WordIndex) -> None:
        self._index = index
        self._spans: GrowingArray[np.int32] = GrowingArray(np.int32)
        self._covering = np.zeros(0, np.int32)
        self._waiting: deque[Words] = deque()

    def __len__(self) -> int:
        return len(self._spans) + sum(map(len, self._waiting))

    @property
    def past(self) -> int:
        """Words that may be found."""
        return len(self._spans)

    def add(self, words: Words) -> None:
        """Add words that ended at one location, no earlier than those before them."""
        if len(words):
            self._waiting.append(words)

    def pass_until(self, location: int) -> None:
        """Let the words that were last seen at a location or before be found from now on."""
        while self._waiting and self._waiting[0].last[-1] <= location:
            words = self._waiting.popleft()
            self._index.add(words.descriptors)
            self._spans.extend(np.stack([words.first, words.last], axis=1).astype(np.int32))
            self._cover(words)

    def hit(self, query: Floats) -> Indices:
        """The distinct words (K,) that are nearest to some query descriptor (N, D)."""
        if self.past == 0 or len(query) == 0:
            return np.empty(0, np.int64)
        return np.unique(self._index.nearest(query))

    def spans(self, words: Indices) -> NDArray[np.int32]:
        """First and last location (K, 2) of words (K,)."""
        return self._spans.rows.reshape(-1, 2)[words]

    def covering(self, locations: Indices) -> NDArray[np.int32]:
        """Words (K,) that may be found and were seen at each of the locations (K,)."""
        return self._covering[locations]

    def _cover(self, words: Words) -> None:
        end = int(words.last.max()) + 1
        if end > len(self._covering):
            larger = np.zeros(max(end, 2 * len(self._covering)), np.int32)
            larger[: len(self._covering)] = self._covering
            self._covering = larger
        begin = int(words.first.min())
        self._covering[begin:end] += count_covering(words.first - begin, words.last - begin, end - begin)

    def state(self) -> dict[str, Any]:
        """All words, for a checkpoint."""
        return {
            "index": self._index.state(),
            "spans": self._spans.state(),
            "num_covering": self._covering,
            "waiting": [dict(vars(words)) for words in self._waiting],
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._index.restore(state["index"])
        self._spans.restore(state["spans"])
        self._covering = state["num_covering"]
        self._waiting = deque(Words(**words) for words in state["waiting"])


def count_covering(first: Indices, last: Indices, locations: int) -> NDArray[np.int32]:
    """Spans (K,) to (K,), both ends included, that cover each of so many locations: (locations,)."""
    begins = np.bincount(first, minlength=locations + 1)
    ends = np.bincount(last + 1, minlength=locations + 1)
    return np.cumsum(begins - ends)[:locations].astype(np.int32)
