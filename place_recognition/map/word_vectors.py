"""What visual words say of an image or a sequence: a vector of word weights, few of them not 0.

Bampis, Amanatiadis, Gasteratos, IROS 2016, equations 1 to 4: the word vector of a sequence is made of the words of all
its images, each as often as it occurs. The share of a word in them (term frequency) is multiplied by how rare it is in
general (inverse document frequency): tf-idf.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.map.growing import GrowingArray

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class WordVector:
    """A vector of unit length, or of no words at all.

    Attributes:
        words: (K,) int64, those whose weight is not 0, rising.
        values: (K,) float32, their weights.
    """

    words: Indices
    values: Floats

    def __len__(self) -> int:
        return len(self.words)

    def cosine(self, other: "WordVector") -> float:
        """Cosine of the angle to another vector; 0 if either has no words."""
        _, mine, theirs = np.intersect1d(self.words, other.words, assume_unique=True, return_indices=True)
        return float(np.sum(self.values[mine].astype(np.float64) * other.values[theirs]))


def word_vector(words: Indices, weights: Floats) -> WordVector:
    """Tf-idf vector of words (N,), each as often as it occurs, by the weights (W,) of all words."""
    distinct, counts = np.unique(words, return_counts=True)
    values = counts * weights[distinct].astype(np.float64)
    known = values > 0
    length = np.linalg.norm(values[known])
    return WordVector(distinct[known].astype(np.int64), (values[known] / max(length, 1e-12)).astype(np.float32))


class ImageWords:
    """The words of every image, by location: two bytes a word in a vocabulary of up to 65,536."""

    def __init__(self, weights: Floats) -> None:
        self._weights = weights.astype(np.float32)
        self._words: GrowingArray[np.uint16] | GrowingArray[np.uint32] = (
            GrowingArray(np.uint16) if len(weights) <= 1 << 16 else GrowingArray(np.uint32)
        )
        self._ends: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._lengths: GrowingArray[np.float32] = GrowingArray(np.float32)

    def __len__(self) -> int:
        return len(self._ends)

    def add(self, words: Indices) -> None:
        """Keep the words (N,) of the next image."""
        self._words.extend(words)  # type: ignore[arg-type]
        counts = np.unique(words, return_counts=True)
        self._ends.extend(np.array([len(self._words)]))
        self._lengths.extend(np.array([np.linalg.norm(counts[1] * self._weights[counts[0]])], np.float32))

    def of(self, first: int, last: int) -> Indices:
        """The words of the images from one location to another, both included, each as often as it occurs."""
        ends = self._ends.rows.reshape(-1)
        begin = int(ends[first - 1]) if first else 0
        return self._words.rows.reshape(-1)[begin : int(ends[last])].astype(np.int64)

    def cosines(self, query: int, locations: Indices) -> Floats:
        """Cosines (K,) of the word vector of the image at a location with those of the images at others (K,)."""
        vector = np.zeros(len(self._weights), np.float32)
        words, counts = np.unique(self.of(query, query), return_counts=True)
        vector[words] = counts * self._weights[words] ** 2
        ends, lengths = self._ends.rows.reshape(-1), self._lengths.rows.reshape(-1)
        products = _sum_weights(vector, self._words.rows.reshape(-1), ends, locations)
        return products / np.maximum(lengths[locations] * lengths[query], np.float32(1e-12))


@njit(cache=True)
def _sum_weights(vector: Floats, words: NDArray[np.uint16], ends: Indices, locations: Indices) -> Floats:
    """Sum (K,) of the numbers that the words of each location have in a vector (W,)."""
    sums = np.zeros(len(locations), np.float32)
    for i, location in enumerate(locations):
        begin = ends[location - 1] if location else 0
        for k in range(begin, ends[location]):
            sums[i] += vector[words[k]]
    return sums
