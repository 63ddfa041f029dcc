"""An inverted index of word vectors: a query touches only the sequences that share a word with it.

Sivic, Zisserman, 'Video Google', ICCV 2003. The postings of all words lie in flat blocks of one growing array, each
word's blocks chained: at a million images (about 170,000 sequences of 6 images) six bytes a posting make about one GB.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.growing_array import GrowingArray
from place_recognition.vocabulary.tf_idf import WordVector

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]

BLOCK = 512  # postings of a block, read in one go: five times as fast as blocks of 32, and 3 kB for each word in use
STEPS = 65535  # numbers of unit vectors are stored in two bytes as multiples of 1 / STEPS
NONE = -1  # in place of the number of a block


class Postings(NamedTuple):
    """Blocks of postings, for the compiled sum.

    Attributes:
        sequences: (B, BLOCK) sequence of each posting.
        values: (B, BLOCK) weight of each posting.
        next_block: (B,) next block of each block.
    """

    sequences: NDArray[np.uint32]
    values: NDArray[np.uint16]
    next_block: Indices


class InvertedIndex:
    """Word vectors of sequences, numbered from 0, in postings by word."""

    def __init__(self, words: int) -> None:
        self._first = np.full(words, NONE, np.int64)
        self._last = np.full(words, NONE, np.int64)
        self._postings = np.zeros(words, np.int64)
        self._sequences: GrowingArray[np.uint32] = GrowingArray(np.uint32)
        self._values: GrowingArray[np.uint16] = GrowingArray(np.uint16)
        self._next: GrowingArray[np.int64] = GrowingArray(np.int64)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def bytes(self) -> int:
        """Memory of the postings."""
        return sum(rows.nbytes for rows in (self._sequences.rows, self._values.rows, self._next.rows))

    def add(self, vector: WordVector) -> None:
        """Append the vector of the next sequence."""
        if len(vector):
            self._open_blocks(vector.words)
            block, place = self._last[vector.words], self._postings[vector.words] % BLOCK
            self._sequences.rows[block, place] = self._count
            self._values.rows[block, place] = np.round(vector.values * STEPS)
            self._postings[vector.words] += 1
        self._count += 1

    def cosines(self, query: WordVector, count: int) -> Floats:
        """Compute the cosine (count,) of the query and each of the first sequences; 0 where no word is shared."""
        sums = np.zeros(count, np.float32)
        if count and len(query) and len(self._next):
            chains = np.stack([self._first[query.words], self._postings[query.words]], axis=1)
            postings = Postings(self._sequences.rows, self._values.rows, self._next.rows)
            _accumulate(chains, query.values / np.float32(STEPS), postings, sums)
        return sums

    def _open_blocks(self, words: Indices) -> None:
        """Append an empty block to the chain of each word whose last block is full, or that has no block."""
        full = words[self._postings[words] % BLOCK == 0]
        if len(full) == 0:
            return
        begin = len(self._next)
        blocks = np.arange(begin, begin + len(full))
        self._sequences.extend(np.zeros((len(full), BLOCK), np.uint32))
        self._values.extend(np.zeros((len(full), BLOCK), np.uint16))
        self._next.extend(np.full(len(full), NONE, np.int64))
        chained = self._last[full] != NONE
        self._next.rows[self._last[full[chained]]] = blocks[chained]
        self._first[full[~chained]] = blocks[~chained]
        self._last[full] = blocks

    def state(self) -> dict[str, Any]:
        """All postings, for a checkpoint."""
        return {
            "first_block": self._first,
            "last_block": self._last,
            "num_postings": self._postings,
            "sequences": self._sequences.state(),
            "values": self._values.state(),
            "next_block": self._next.state(),
            "num_sequences": self._count,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state.

        Raises:
            ValueError: of another number of words.
        """
        if len(state["first_block"]) != len(self._first):
            raise ValueError(f"expected postings of {len(self._first)} words, got {len(state['first_block'])}")
        self._first, self._last = state["first_block"], state["last_block"]
        self._postings, self._count = state["num_postings"], state["num_sequences"]
        self._sequences.restore(state["sequences"])
        self._values.restore(state["values"])
        self._next.restore(state["next_block"])


@njit(cache=True, nogil=True)
def _accumulate(chains: Indices, weights: Floats, postings: Postings, sums: Floats) -> None:
    """Add the contributions of the words (K,) of a query to the sums (M,) of the first M sequences.

    Args:
        chains: (K, 2) first block of each word and its number of postings; sequences rise along a chain.
        weights: (K,) weight of each word in the query.
        postings: all blocks.
        sums: (M,) to be added to.
    """
    for k in range(len(chains)):
        block, left = chains[k]
        weight = weights[k]
        while left > 0:
            some, theirs = postings.sequences[block], postings.values[block]
            count = min(left, BLOCK)
            if some[count - 1] >= len(sums):  # sequences rise, so this is the last block
                count, left = np.searchsorted(some[:count], np.uint32(len(sums))), 0
            for i in range(count):
                sums[some[i]] += weight * np.float32(theirs[i])
            left -= BLOCK
            block = postings.next_block[block]
