"""Sequences of images: where one ends, by distance or by visual word variance, and the map of all that have ended.

Bampis, Amanatiadis, Gasteratos, IROS 2016 (fixed distance) and IJRR 37(1) 2018 (visual word variance).
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from place_recognition.growing_array import GrowingArray
from place_recognition.map.inverted_index import InvertedIndex
from place_recognition.vocabulary.tf_idf import WordVector

Indices = NDArray[np.int64]


class SequenceMap:
    """Sequences of images, numbered from 0 in the order in which they ended; together they are the whole recording.

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

    def images_near(self, sequences: Indices, neighbors: int = 1) -> Indices:
        """Return the locations (M,), rising, of the images of sequences (K,) and of the sequences next to each."""
        near = np.unique(sequences[:, None] + np.arange(-neighbors, neighbors + 1))
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


class Segmentation(Protocol):
    """Divides a recording into sequences that do not overlap."""

    def starts_sequence(self, words: Indices, distance_travelled_m: float) -> bool:
        """Whether the next image starts a new sequence; the very first image does.

        Args:
            words: (N,) visual words of the image.
            distance_travelled_m: length of the path so far, metres; NaN, or always the same value, where it is not
                measured.
        """
        ...

    def restart(self) -> None:
        """Let the next image start a sequence: it belongs to another recording."""
        ...

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        ...


@dataclass(frozen=True)
class FixedDistanceConfig:
    """Length of a sequence.

    Attributes:
        distance_m: length of the path of a sequence; the paper tried 3 m to 6 m.
        unmeasured_images: number of images of a sequence where no distance is measured: the paper's 5 m at 10 m/s and
            10 images a second.
        max_images: number of images at which a sequence ends even if the car has hardly moved, as at a red light.
    """

    distance_m: float = 5.0
    unmeasured_images: int = 5
    max_images: int = 20


class FixedDistanceSegmentation:
    """Sequences of a fixed path length by odometry (a Segmentation)."""

    def __init__(self, config: FixedDistanceConfig | None = None) -> None:
        self.config = config or FixedDistanceConfig()
        self._first_distance_m = self._start_distance_m = float("nan")
        self._images = 0

    def starts_sequence(self, words: Indices, distance_travelled_m: float) -> bool:
        """Whether the next image is too far from the first image of its sequence, or exceeds their number."""
        if self._images == 0:
            self._first_distance_m = distance_travelled_m
        # NaN compares as False: then the number of images decides.
        is_measured = np.isfinite(distance_travelled_m) and distance_travelled_m != self._first_distance_m
        is_far = is_measured and distance_travelled_m - self._start_distance_m >= self.config.distance_m
        is_full = self._images >= (self.config.max_images if is_measured else self.config.unmeasured_images)
        starts = self._images == 0 or is_far or is_full
        if starts:
            self._start_distance_m, self._images = distance_travelled_m, 0
        self._images += 1
        return bool(starts)

    def restart(self) -> None:
        """Let the next image start a sequence."""
        self._images = 0

    def state(self) -> dict[str, Any]:
        """Where the recording and the open sequence began, for a checkpoint."""
        return {
            "first_distance_m": self._first_distance_m,
            "start_distance_m": self._start_distance_m,
            "num_images": self._images,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._first_distance_m, self._start_distance_m = state["first_distance_m"], state["start_distance_m"]
        self._images = state["num_images"]


@dataclass(frozen=True)
class WordVarianceConfig:
    """Change of the view that ends a sequence.

    The variance of an image is the share of its distinct words that its sequence has not shown yet.

    Attributes:
        min_variance: a sequence ends before an image of a greater variance than this,
        min_variance_ratio: and than this many times the usual variance from one image to the next.
        min_images: number of images of a sequence before its variance is tested.
        max_images: number of images at which a sequence ends in any case.
    """

    min_variance: float = 0.0
    min_variance_ratio: float = 1.0
    min_images: int = 2
    max_images: int = 10


class WordVariance:
    """Sequences of images that show the same words (a Segmentation)."""

    def __init__(self, words: int, config: WordVarianceConfig | None = None) -> None:
        self.config = config or WordVarianceConfig()
        self._seen = np.zeros(words, np.bool_)
        self._images = 0
        self._latest = np.empty(0, np.int64)
        self._changes = np.zeros(2)  # sum and number of the variances from one image to the next

    def starts_sequence(self, words: Indices, distance_travelled_m: float) -> bool:
        """Whether the next image shows too many words that are new to its sequence, or exceeds its number of images."""
        distinct = np.unique(words)
        self._update_usual(distinct)
        starts = self._images == 0 or self._images >= self.config.max_images or self._has_changed(distinct)
        if starts:
            self._seen[:] = False
            self._images = 0
        self._seen[distinct] = True
        self._images += 1
        return starts

    def restart(self) -> None:
        """Let the next image start a sequence; it has not changed from the image before it."""
        self._images, self._latest = 0, np.empty(0, np.int64)

    def _has_changed(self, distinct: Indices) -> bool:
        if self._images < self.config.min_images or len(distinct) == 0:
            return False
        variance = 1.0 - float(np.mean(self._seen[distinct]))
        return variance > max(self.config.min_variance, self.config.min_variance_ratio * self._usual_variance())

    def _usual_variance(self) -> float:
        """Return the mean variance from one image to the next so far; 0 before the second image."""
        return float(self._changes[0] / max(self._changes[1], 1))

    def _update_usual(self, distinct: Indices) -> None:
        # An image without words measures no change, and is no image to compare the next one with.
        if len(distinct) and len(self._latest):
            self._changes += [1.0 - float(np.mean(np.isin(distinct, self._latest, assume_unique=True))), 1]
        if len(distinct):
            self._latest = distinct

    def state(self) -> dict[str, Any]:
        """The words of the open sequence and what usually changes, for a checkpoint."""
        return {
            "words_seen": self._seen,
            "num_images": self._images,
            "latest_words": self._latest,
            "changes": self._changes,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state.

        Raises:
            ValueError: of another number of words.
        """
        if len(state["words_seen"]) != len(self._seen):
            raise ValueError(f"expected a vocabulary of {len(self._seen)} words, got {len(state['words_seen'])}")
        self._seen, self._images = state["words_seen"], state["num_images"]
        self._latest, self._changes = state["latest_words"], state["changes"]
