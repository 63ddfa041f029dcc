"""Words of a map that grows without end, found approximately in nearly constant time.

A balanced tree of cells of like words that split when they are full, as a B-tree's pages do: the K-tree of Geva,
'K-tree: A Height Balanced Tree Structured Vector Quantizer', NNSP 2000. It needs no training, and no word added takes
long: at most one cell a level is split. A search follows the nearest cells of each level, not one path alone.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.map.growing import GrowingArray
from place_recognition.map.image_store import STEPS
from place_recognition.map.word_index import ExactWordIndex, WordIndex
from place_recognition.map.word_tree_kernels import CAPACITY, FINE, Nodes, insert_words, search_words

Floats = NDArray[np.float32]
Bytes = NDArray[np.int8]
Shorts = NDArray[np.int16]
Indices = NDArray[np.int64]

BATCH = 64  # words for which room is made at a time
GROWTH = 1.5  # of the pools


class WordTree:
    """Words found by a beam through a tree of cells (a WordIndex): by one byte a number, the last few by two.

    About 240 bytes a word of 64 numbers.
    """

    def __init__(self) -> None:
        self._nodes: Nodes | None = None
        self._words: GrowingArray[np.int16] = GrowingArray(np.int16)

    def __len__(self) -> int:
        return len(self._words)

    def add(self, descriptors: Floats) -> None:
        """Append words (K, D), at most of unit length."""
        words = quantised(descriptors)
        for begin in range(0, len(words), BATCH):
            batch = words[begin : begin + BATCH]
            self._nodes = with_room(self._nodes, batch.shape[1])
            insert_words(self._nodes, batch, len(self._words))
            self._words.extend(batch)

    def nearest(self, query: Floats) -> Indices:
        """The nearest word (N,) of each query descriptor (N, D) that the beam reaches; needs at least one word."""
        assert self._nodes is not None  # the contract: at least one word
        return search_words(self._nodes, self._words.rows, quantised(query), beam(len(self)))

    def state(self) -> Any:
        """All nodes and words, for a checkpoint."""
        nodes = None if self._nodes is None else self._nodes._asdict()
        return {"nodes": nodes, "words": self._words.state()}

    def restore(self, state: Any) -> None:
        """Continue from a state."""
        self._nodes = None if state["nodes"] is None else Nodes(**state["nodes"])
        self._words.restore(state["words"])


class GrowingWordIndex:
    """Compares every word while there are few, and searches a tree when there are many (a WordIndex)."""

    def __init__(self, exact: int = 4096) -> None:
        """Start without words; up to `exact` of them all are compared."""
        self._exact, self._limit, self._tree = ExactWordIndex(), exact, WordTree()

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
        """The nearest word (N,) of each query descriptor (N, D); needs at least one word."""
        index: WordIndex = self._exact if len(self._tree) <= self._limit else self._tree
        return index.nearest(query)

    def state(self) -> Any:
        """All words, for a checkpoint."""
        return {"exact": self._exact.state(), "tree": self._tree.state()}

    def restore(self, state: Any) -> None:
        """Continue from a state."""
        self._exact.restore(state["exact"])
        self._tree.restore(state["tree"])


def beam(words: int) -> int:
    """Cells that a search follows among so many words.

    With SURF words of which each cell was crossed from two real descriptors, 0.97 of the nearest are found at 50,000
    words with 16 cells and at 1,000,000 with 32.
    """
    return max(round(16 * (words / 65536) ** 0.25), 16)


def quantised(descriptors: Floats) -> Shorts:
    """Descriptors (N, D) of at most unit length in steps of 1 / (STEPS FINE)."""
    return np.round(descriptors * (STEPS * FINE)).astype(np.int16)


def with_room(nodes: Nodes | None, dimension: int) -> Nodes:
    """The nodes, or a copy of them in larger pools where a batch of words might not find room."""
    if nodes is None:
        return empty_nodes(2 * BATCH, dimension)
    used, levels = int(nodes.shape[0]), int(nodes.shape[2])
    # a node takes LEAST_FILL new entries before it splits again, so a batch splits each at most once or twice a level
    if used + BATCH * (levels + 1) <= len(nodes.counts):
        return nodes
    larger = empty_nodes(int(GROWTH * len(nodes.counts)) + BATCH * (levels + 1), dimension)
    larger.vectors[:used], larger.half_norms[:used] = nodes.vectors[:used], nodes.half_norms[:used]
    larger.entries[:used], larger.counts[:used] = nodes.entries[:used], nodes.counts[:used]
    return larger._replace(shape=nodes.shape)


def empty_nodes(pool: int, dimension: int) -> Nodes:
    """A root without entries; pages of the pools that nothing was written to cost no memory."""
    return Nodes(
        vectors=np.zeros((pool, dimension, CAPACITY), np.int8),
        half_norms=np.zeros((pool, CAPACITY), np.int16),
        entries=np.zeros((pool, CAPACITY), np.int32),
        counts=np.zeros(pool, np.int32),
        shape=np.array([1, 0, 1]),
    )
