"""Tf-idf vectors of visual words, of images and of sequences.

Bampis, Amanatiadis, Gasteratos, IROS 2016, equations 1 to 4: the vector of a sequence is made of the words of all its
images, each as often as it occurs. The share of a word in them (term frequency) is multiplied by its rarity in general
(inverse document frequency).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.growing_array import GrowingArray

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class WordVector:
    """A sparse vector of unit length over all words, or an empty one.

    Attributes:
        words: (K,) int64 words whose weight is not 0, in rising order.
        values: (K,) float32 weights of these words.
    """

    words: Indices
    values: Floats

    def __len__(self) -> int:
        return len(self.words)

    def strongest(self, count: int) -> "WordVector":
        """Keep at most `count` words of greatest weight with their values; the first of equal ones."""
        if len(self) <= count:
            return self
        kept = np.sort(np.argsort(-self.values, kind="stable")[:count])
        return WordVector(self.words[kept], self.values[kept])

    def cosine(self, other: "WordVector") -> float:
        """Compute the cosine of the angle to another vector; 0 if either has no words."""
        _, mine, theirs = np.intersect1d(self.words, other.words, assume_unique=True, return_indices=True)
        return float(np.sum(self.values[mine].astype(np.float64) * other.values[theirs]))


def word_vector(words: Indices, weights: Floats, tf_power: float = 1.0) -> WordVector:
    """Make the tf-idf vector of an image or a sequence.

    Args:
        words: (N,) words below W in any order, each as often as it occurs.
        weights: (W,) inverse document frequencies of all words.
        tf_power: exponent of the number of times that a word occurs; 1 is the paper's term frequency. Less keeps a
            fence from counting as much as all else (burstiness: Jegou, Douze, Schmid, CVPR 2009).
    """
    distinct, counts = np.unique(words, return_counts=True)
    values = counts**tf_power * weights[distinct].astype(np.float64)
    known = values > 0
    length = max(float(np.linalg.norm(values[known])), 1e-12)
    return WordVector(distinct[known].astype(np.int64), (values[known] / length).astype(np.float32))


class ImageWords:
    """The words of every image by location, two bytes a word in a vocabulary of up to 65,536 words."""

    def __init__(self, words: int) -> None:
        self._words: GrowingArray[np.uint16] | GrowingArray[np.uint32] = (
            GrowingArray(np.uint16) if words <= 1 << 16 else GrowingArray(np.uint32)
        )
        self._ends: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._images_with = np.zeros(words, np.int64)

    def __len__(self) -> int:
        return len(self._ends)

    def add(self, words: Indices) -> None:
        """Append the words (N,) of the next image."""
        self._words.extend(words)  # type: ignore[arg-type]
        self._ends.extend(np.array([len(self._words)]))
        self._images_with[np.unique(words)] += 1

    def words_between(self, first: int, last: int) -> Indices:
        """Return the words of the images from `first` to `last`, both included, each as often as it occurs."""
        ends = self._ends.rows.reshape(-1)
        begin = int(ends[first - 1]) if first else 0
        return self._words.rows.reshape(-1)[begin : int(ends[last])].astype(np.int64)

    def correlation(self, query: int, locations: Indices) -> Floats:
        """Correlate the words of the image at a location with those of other images: (K,), at most about 1.

        Each word counts once and is weighted by its rarity among the images so far. Weights are centred, so that words
        present in most images carry no information. This puts the right image among the best eight of a proposal in
        0.94 of the revisits of simulated blocks, tf-idf counts with general weights in 0.89.

        Args:
            query: location of the image.
            locations: (K,) locations of the other images.
        """
        share = (self._images_with + 0.5) / (len(self) + 1.5)
        squares = np.log(share) ** 2
        present = np.zeros(len(share))
        present[self.words_between(query, query)] = 1.0
        length = np.sqrt(np.sum(squares * present))
        weights = np.stack([(present - share) * squares / max(length, 1e-12), squares], axis=1)
        ends = self._ends.rows.reshape(-1)
        return _correlate(weights.astype(np.float32), self._words.rows.reshape(-1), ends, locations)

    def state(self) -> dict[str, Any]:
        """The words of all images, for a checkpoint."""
        return {"words": self._words.state(), "ends": self._ends.state(), "images_with_word": self._images_with}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._words.restore(state["words"])
        self._ends.restore(state["ends"])
        self._images_with = state["images_with_word"]


@njit(cache=True)
def _correlate(weights: Floats, words: NDArray[np.uint16], ends: Indices, locations: Indices) -> Floats:
    """Correlate a query with the words of each location (K,), each word counted once.

    weights: (W, 2) contribution of a word to the product and to the squared length of the location's vector.
    """
    alike = np.zeros(len(locations), np.float32)
    counted = np.full(len(weights), -1, np.int64)
    for i, location in enumerate(locations):
        product, square = np.float32(0), np.float32(1e-12)
        for k in range(ends[location - 1] if location else 0, ends[location]):
            word = words[k]
            if counted[word] != i:  # the mark of this image: no array must be cleared between images
                counted[word] = i
                product += weights[word, 0]
                square += weights[word, 1]
        alike[i] = product / np.sqrt(square)
    return alike
