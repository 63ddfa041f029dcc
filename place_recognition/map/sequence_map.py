"""The map of sequences: the images of each sequence, and an inverted index of its words."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.growing_array import GrowingArray
from place_recognition.map.inverted_index import InvertedIndex
from place_recognition.vocabulary.tf_idf import WordVector

Indices = NDArray[np.int64]


class SequenceMap:
    """Sequences of images, numbered from 0 in the order in which they ended; together they are the whole drive.

    Attributes:
        index: inverted index of the word vectors of all sequences.
    """

    def __init__(self, words: int) -> None:
        self.index = InvertedIndex(words)
        self._lasts: GrowingArray[np.int64] = GrowingArray(np.int64)

    def __len__(self) -> int:
        return len(self._lasts)

    def add(self, last: int, vector: WordVector) -> None:
        """Append the sequence that ends at location `last` and begins behind the end of the sequence before."""
        self._lasts.extend(np.array([last]))
        self.index.add(vector)

    def count_ended_by(self, location: int) -> int:
        """Count the sequences that end at a location or before."""
        return int(np.searchsorted(self._ends, location, side="right"))

    def sequence_of(self, location: int) -> int:
        """Find the sequence of the image at a location; `len(self)` where its sequence has not ended."""
        return int(np.searchsorted(self._ends, location, side="left"))

    def first(self, sequences: Indices) -> Indices:
        """Return the location (K,) of the first image of each sequence (K,)."""
        return np.where(sequences > 0, self._ends[np.maximum(sequences - 1, 0)] + 1, 0)

    def images_near(self, sequences: Indices) -> Indices:
        """Return the locations (M,), rising, of the images of sequences (K,) and of the sequences next to each."""
        near = np.unique(sequences[:, None] + np.arange(-1, 2))
        near = near[(near >= 0) & (near < len(self))]
        first, last = self.first(near), self._ends[near]
        return np.concatenate([np.empty(0, np.int64), *map(np.arange, first, last + 1)])

    @property
    def _ends(self) -> Indices:
        return self._lasts.rows.reshape(-1)

    def state(self) -> dict[str, Any]:
        """All sequences, for a checkpoint."""
        return {"index": self.index.state(), "last_images": self._lasts.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self.index.restore(state["index"])
        self._lasts.restore(state["last_images"])
