"""Word indices: find the nearest of all words of a growing map."""

from typing import Any, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.growing_array import GrowingArray
from place_recognition.image_processing.matching import add_products

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]

BLOCK = 128  # words compared at a time: 32 kB of 64 floats each, so that they stay in the cache for all queries


class WordIndex(Protocol):
    """Words in the order in which they were added, found by their descriptors."""

    def __len__(self) -> int:
        """Number of words so far."""
        ...

    def add(self, descriptors: Floats) -> None:
        """Append words (K, D)."""
        ...

    def nearest(self, query: Floats) -> Indices:
        """Find the nearest word (N,) of each query descriptor (N, D), Euclidean; needs at least one word."""
        ...

    def state(self) -> Any:
        """All words, for a checkpoint."""
        ...

    def restore(self, state: Any) -> None:
        """Continue from a state."""
        ...


class ExactWordIndex:
    """Compares a query with every word (a WordIndex)."""

    def __init__(self) -> None:
        self._words: GrowingArray[np.float32] = GrowingArray(np.float32)

    def __len__(self) -> int:
        return len(self._words)

    def add(self, descriptors: Floats) -> None:
        """Append words (K, D)."""
        if len(descriptors):
            self._words.extend(descriptors)

    def nearest(self, query: Floats) -> Indices:
        """Find the nearest word (N,) of each query descriptor (N, D); the first of equally near ones."""
        return nearest_words(query, self._words.rows)

    def state(self) -> Any:
        """All words, for a checkpoint."""
        return self._words.state()

    def restore(self, state: Any) -> None:
        """Continue from a state."""
        self._words.restore(state)


@njit(cache=True)
def nearest_words(query: Floats, words: Floats) -> Indices:
    """Find the word (K, D) at the least Euclidean distance of each query descriptor (N, D), by comparing all.

    Args:
        query: (N, D) float32.
        words: (K, D) float32, K at least 1.

    Returns:
        (N,) index of the nearest word; the first of equally near ones.
    """
    nearest = np.zeros(len(query), np.int64)
    best = np.full(len(query), -np.inf, np.float32)
    # Blocks outside, queries inside: each block is read from memory once, and from the cache for every query.
    for begin in range(0, len(words), BLOCK):
        # Words as columns: the products of one number of a query with all words of the block are one SIMD loop.
        block = np.ascontiguousarray(words[begin : begin + BLOCK].T)
        # |q - w|^2 = |q|^2 - 2 (q.w - |w|^2 / 2) is least where q.w - |w|^2 / 2, the closeness, is greatest.
        penalty = np.zeros(block.shape[1], np.float32)
        for k in range(len(block)):
            penalty -= np.float32(0.5) * block[k] * block[k]
        closeness = np.empty_like(penalty)
        for i in range(len(query)):
            closeness[:] = penalty
            add_products(query[i], block, closeness)
            index = closeness.argmax()
            if closeness[index] > best[i]:  # not >=: the first of equally near words stays
                nearest[i], best[i] = begin + index, closeness[index]
    return nearest
