"""The word tree: approximate nearest-word search in a map that grows without end, in nearly constant time.

A balanced tree of cells of like words that split when they are full, as the pages of a B-tree do: the K-tree of Geva,
'K-tree: A Height Balanced Tree Structured Vector Quantizer', NNSP 2000. It needs no training, and no insertion takes
long: at most one cell a level is split. A search is a beam search: it follows the nearest cells of each level, not one
path alone. docs/decisions/word_index.md compares it with the indices of FAISS.
"""

from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.growing_array import GrowingArray
from place_recognition.image_processing.local_features import DESCRIPTOR_STEPS
from place_recognition.image_processing.matching import add_products
from place_recognition.vocabulary.word_tree_kernels import CAPACITY, FINE, Nodes, insert_words, search_words

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


@njit(cache=True, nogil=True)
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


Bytes = NDArray[np.int8]
Shorts = NDArray[np.int16]

BATCH = 64  # words for which room is reserved at a time
GROWTH = 1.5  # factor by which the pools are enlarged


class WordTree:
    """Balanced tree of cells of words, searched by a beam (a WordIndex).

    Vectors in the tree have one byte a number, which one compiled product compares quickly; the last few candidates are
    compared by two bytes a number. A word of 64 numbers takes about 240 bytes.
    """

    def __init__(self) -> None:
        self._nodes: Nodes | None = None
        self._words: GrowingArray[np.int16] = GrowingArray(np.int16)
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="words")

    def __len__(self) -> int:
        return len(self._words)

    def add(self, descriptors: Floats) -> None:
        """Append words (K, D), at most of unit length."""
        words = quantize(descriptors)
        for begin in range(0, len(words), BATCH):
            batch = words[begin : begin + BATCH]
            self._nodes = reserve(self._nodes, batch.shape[1])
            insert_words(self._nodes, batch, len(self._words))
            self._words.extend(batch)

    def nearest(self, query: Floats) -> Indices:
        """Find the nearest word (N,) of each query (N, D) that the beam reaches, one half in a second thread."""
        assert self._nodes is not None  # the contract: at least one word
        words, beam, half = self._words.rows, beam_width(len(self)), len(query) // 2
        other = self._pool.submit(search_words, self._nodes, words, quantize(query[half:]), beam)
        return np.concatenate([search_words(self._nodes, words, quantize(query[:half]), beam), other.result()])

    def state(self) -> Any:
        """All nodes and words, for a checkpoint."""
        nodes = None if self._nodes is None else self._nodes._asdict()
        return {"nodes": nodes, "words": self._words.state()}

    def restore(self, state: Any) -> None:
        """Continue from a state."""
        self._nodes = None if state["nodes"] is None else Nodes(**state["nodes"])
        self._words.restore(state["words"])


class HybridWordIndex:
    """Compares every word while there are few, and searches a tree when there are many (a WordIndex).

    Among 4,096 words the exact search of 200 descriptors takes 2.2 ms, where the tree takes 1.0 ms and misses some.
    """

    def __init__(self, max_exact_words: int = 4096) -> None:
        """Make an index without words; up to `max_exact_words` of them are all compared."""
        self._exact, self._limit, self._tree = ExactWordIndex(), max_exact_words, WordTree()

    def __len__(self) -> int:
        return len(self._tree)

    def add(self, descriptors: Floats) -> None:
        """Append words (K, D), at most of unit length."""
        self._tree.add(descriptors)  # from the first word on, so that it need not be grown all at once
        if len(self._tree) <= self._limit:
            self._exact.add(descriptors)
        else:
            self._exact = ExactWordIndex()

    def nearest(self, query: Floats) -> Indices:
        """Find the nearest word (N,) of each query descriptor (N, D); needs at least one word."""
        index: WordIndex = self._exact if len(self._tree) <= self._limit else self._tree
        return index.nearest(query)

    def state(self) -> Any:
        """All words, for a checkpoint."""
        return {"exact": self._exact.state(), "tree": self._tree.state()}

    def restore(self, state: Any) -> None:
        """Continue from a state."""
        self._exact.restore(state["exact"])
        self._tree.restore(state["tree"])


def beam_width(words: int) -> int:
    """Choose the number of cells that a search follows on the last level but one.

    With SURF words of which each cell was crossed from two real descriptors, 0.97 of the nearest are found at 50,000
    words with 16 cells and at 1,000,000 with 32.
    """
    return max(round(16 * (words / 65536) ** 0.25), 16)


def quantize(descriptors: Floats) -> Shorts:
    """Round descriptors (N, D) of at most unit length to steps of 1 / (DESCRIPTOR_STEPS FINE)."""
    return np.round(descriptors * (DESCRIPTOR_STEPS * FINE)).astype(np.int16)


def reserve(nodes: Nodes | None, dimension: int) -> Nodes:
    """Return the nodes, or a copy of them in larger pools where a batch of words might not find room."""
    if nodes is None:
        return allocate_nodes(2 * BATCH, dimension)
    used, levels = int(nodes.shape[0]), int(nodes.shape[2])
    # A node takes MIN_FILL new entries before it splits again, so a batch splits each at most once or twice a level.
    if used + BATCH * (levels + 1) <= len(nodes.counts):
        return nodes
    larger = allocate_nodes(int(GROWTH * len(nodes.counts)) + BATCH * (levels + 1), dimension)
    larger.vectors[:used], larger.half_norms[:used] = nodes.vectors[:used], nodes.half_norms[:used]
    larger.entries[:used], larger.counts[:used] = nodes.entries[:used], nodes.counts[:used]
    return larger._replace(shape=nodes.shape)


def allocate_nodes(pool: int, dimension: int) -> Nodes:
    """Allocate pools with a root without entries; pages that nothing is written to cost no memory."""
    return Nodes(
        vectors=np.zeros((pool, dimension, CAPACITY), np.int8),
        half_norms=np.zeros((pool, CAPACITY), np.int16),
        entries=np.zeros((pool, CAPACITY), np.int32),
        counts=np.zeros(pool, np.int32),
        shape=np.array([1, 0, 1]),
    )
