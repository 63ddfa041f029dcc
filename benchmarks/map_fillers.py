"""Maps of any size for benchmarks, filled through the methods of the maps with features like those of real images."""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from place_recognition.belief.place_filter import PlaceFilter
from place_recognition.image_processing.local_features import FeatureCache, LocalFeatures
from place_recognition.map.image_history import ImageHistory
from place_recognition.map.place_map import PlaceMap
from place_recognition.paradigms.registry import make_recognizer
from place_recognition.vocabulary.tf_idf import word_vector
from place_recognition.vocabulary.vocabulary import default_vocabulary
from place_recognition.vocabulary.word_tracking import WordMap, Words
from place_recognition.vocabulary.word_tree import HybridWordIndex

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]

BLOCK = 1000  # images added at a time
AUDITED = 500  # descriptors whose nearest words are also found exhaustively
# As on the clips of KITTI: words an image that tracks leave, images they last; words of a place, images of a place.
TRACKED_WORDS, TRACK_LENGTH, PLACE_WORDS, PLACE_LENGTH, SEQUENCE_LENGTH = 11, 8, 145, 12, 6


class Material:
    """Features of real images, and descriptors crossed from them.

    A SURF descriptor is made of 16 cells of four numbers. A new one takes each cell from one of two real descriptors
    that are alike, so that it differs from all others, and still looks like one.
    """

    def __init__(self, features: list[LocalFeatures]) -> None:
        self.features = features
        self.rng = np.random.default_rng(0)
        self._real = np.concatenate([image.descriptors for image in features])
        self._alike = np.concatenate([self._nearest_descriptors(block) for block in np.array_split(self._real, 100)])

    def descriptors(self, count: int) -> Floats:
        """Make new descriptors (count, 64), a little shorter than unit length, as means are."""
        which = self.rng.integers(0, len(self._real), count)
        partner = self._alike[which, self.rng.integers(0, self._alike.shape[1], count)]
        swapped = np.repeat(self.rng.random((count, 16)) < 0.3, 4, axis=1)
        crossed = np.where(swapped, self._real[partner], self._real[which])
        crossed += self.rng.normal(0, 0.01, crossed.shape).astype(np.float32)
        return np.float32(0.95) * crossed / np.linalg.norm(crossed, axis=1, keepdims=True)

    def queries(self, count: int) -> Floats:
        """Choose `count` of the real descriptors."""
        return self._real[np.random.default_rng(1).permutation(len(self._real))[:count]]

    def _nearest_descriptors(self, block: Floats) -> Indices:
        """For each descriptor (N, D) the 8 nearest of a random sample of all."""
        sample = self.rng.permutation(len(self._real))[:1000]
        closeness = block @ self._real[sample].T
        return sample[np.argpartition(-closeness, 8, axis=1)[:, :8]]


class RecalledFeatures:
    """Gives the features of the queries (a FeatureExtractor) in their order, again and again."""

    def __init__(self, kind: str, features: list[LocalFeatures]) -> None:
        self.kind = kind
        self._features, self._next = features, 0

    def extract(self, image: NDArray[np.uint8], mask: NDArray[np.uint8] | None = None) -> LocalFeatures:
        """Features of the next image."""
        self._next += 1
        return self._features[(self._next - 1) % len(self._features)]


class AuditedIndex(HybridWordIndex):
    """A word index that also knows what an exhaustive search finds for a few descriptors."""

    def __init__(self, queries: Floats) -> None:
        super().__init__()
        self._queries = queries
        self._nearest = np.zeros(len(queries), np.int64)
        self._closeness = np.full(len(queries), -np.inf, np.float32)

    def add(self, descriptors: Floats) -> None:
        """Append words (K, D)."""
        if len(descriptors):
            closeness = self._queries @ descriptors.T - np.float32(0.5) * np.sum(descriptors**2, axis=1)
            best = closeness.argmax(axis=1)
            value = closeness[np.arange(len(best)), best]
            nearer = value > self._closeness
            self._nearest[nearer], self._closeness[nearer] = len(self) + best[nearer], value[nearer]
        super().add(descriptors)

    def recall(self) -> float:
        """Share of the descriptors whose nearest word is found."""
        return float(np.mean(self.nearest(self._queries) == self._nearest))


def fill_history(recognizer: Any, material: Material, size: int) -> int:
    """Add real images up to a size, each a step of the camera and none of them looked at; return the size before."""
    recognizer.finish()
    history, decision = recognizer._history, recognizer._decision
    before, steps = len(history), decision._steps
    for location in range(before, size):
        history.add(location, material.features[location % len(material.features)], float(location))
        steps._steps.extend(np.array([len(steps._firsts)]))
        steps._places.extend(np.array([len(steps._firsts)]))
        steps._firsts.append(location)
    view = {"view_begin": size - 1, "reach_frames": 0, "whole_view": [size - 1] * 2, "least_agreeing": np.inf}
    recognizer._view.restore({**recognizer._view.state(), **view, "returns": False})
    decision._filter = PlaceFilter(decision._config)
    return before


class Filler(Protocol):
    """Fills the map of one paradigm.

    Attributes:
        recognizer: whose map it is.
        history: its history.
    """

    recognizer: Any
    history: ImageHistory

    def fill(self, size: int) -> None:
        """Bring the map to so many images."""
        ...

    def recall(self) -> float:
        """Share of nearest words found; NaN where the search is exhaustive."""
        ...


class TrackedWordsFiller:
    """Fills the map of tracked-words (a Filler)."""

    def __init__(self, features: RecalledFeatures, material: Material) -> None:
        self._material, self._index = material, AuditedIndex(material.queries(AUDITED))
        self.recognizer: Any = make_recognizer("tracked-words", FeatureCache(features))
        self.recognizer._proposer._words = WordMap(self._index)
        self.history = self.recognizer._history

    def fill(self, size: int) -> None:
        """Add the words of tracks that end at each image up to a size."""
        proposer = self.recognizer._proposer
        words = proposer._words
        words.activate_until(size)
        for begin in range(fill_history(self.recognizer, self._material, size), size, BLOCK):
            last = np.repeat(np.arange(begin, min(begin + BLOCK, size)), TRACKED_WORDS)
            first = np.maximum(last - self._material.rng.integers(4, 2 * TRACK_LENGTH - 4, len(last)), 0)
            words.add(Words(self._material.descriptors(len(last)), first, last))
            words.activate_until(int(last[-1]))
        proposer._tracks._location = size - 1

    def recall(self) -> float:
        """Share of nearest words found."""
        return self._index.recall()


class PlacesFiller:
    """Fills the map of hierarchical-places (a Filler)."""

    def __init__(self, features: RecalledFeatures, material: Material) -> None:
        self._material, self._index = material, AuditedIndex(material.queries(AUDITED))
        self.recognizer: Any = make_recognizer("hierarchical-places", FeatureCache(features))
        self.recognizer._proposer._places = PlaceMap(self._index)
        self.history = self.recognizer._history

    def fill(self, size: int) -> None:
        """Add places up to a size; the open place is ended."""
        before, places = fill_history(self.recognizer, self._material, size), self.recognizer._proposer._places
        for last in range(before + PLACE_LENGTH - 1, size, PLACE_LENGTH):
            places.add(self._material.descriptors(PLACE_WORDS), last)
            places.activate_until(last)

    def recall(self) -> float:
        """Share of nearest words found."""
        return self._index.recall()


class SequencesFiller:
    """Fills the map of a paradigm of sequences (a Filler)."""

    def __init__(self, name: str, features: RecalledFeatures, material: Material) -> None:
        self._vocabulary, self._material = default_vocabulary(), material
        self.recognizer: Any = make_recognizer(name, FeatureCache(features))
        self.history = self.recognizer._history
        shown = self.recognizer._proposer.config.word_features
        self._images = [self._vocabulary.assign(image.descriptors[:shown]) for image in material.features]

    def fill(self, size: int) -> None:
        """Add sequences up to a size; the open ones are ended."""
        fill_history(self.recognizer, self._material, size)
        matching = self.recognizer._proposer
        while len(matching._words) < size:
            begin = len(matching._words)
            words = [self._mixed() for _ in range(min(SEQUENCE_LENGTH, size - begin))]
            for image in words:
                matching._words.add(image)
            vector = word_vector(np.concatenate(words), self._vocabulary.weights, matching.config.tf_power)
            matching._map.add(len(matching._words) - 1, vector)

    def recall(self) -> float:
        """Return NaN: an inverted index searches exhaustively."""
        return float("nan")

    def _mixed(self) -> Indices:
        """Return the words of an image that shares half with each of two real ones."""
        one, other = (self._images[k] for k in self._material.rng.integers(0, len(self._images), 2))
        return np.concatenate([one[::2], other[1::2]])


FILLERS: dict[str, Callable[[RecalledFeatures, Material], Filler]] = {
    "sequence-histograms": lambda *parts: SequencesFiller("sequence-histograms", *parts),
    "dynamic-sequences": lambda *parts: SequencesFiller("dynamic-sequences", *parts),
    "hierarchical-places": PlacesFiller,
    "tracked-words": TrackedWordsFiller,
}
