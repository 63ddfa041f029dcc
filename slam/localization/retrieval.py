"""Retrieval: the key frames of a map that an image resembles, by a bag of visual words.

The words are descriptors of the map itself, drawn at random: nothing is trained, and any kind of features
works. Sivic, Zisserman, 'Video Google', ICCV 2003.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from place_recognition.vocabulary.vocabulary_training import DescriptorSample
from place_recognition.vocabulary.word_tree import WordIndex, WordTree

Array = NDArray[np.float64]
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class IndexConfig:
    """Settings of the retrieval.

    Attributes:
        words: maximum number of words.
        seed: seed of their random choice.
    """

    words: int = 10000
    seed: int = 0


@dataclass(frozen=True)
class PlaceIndex:
    """Bags of words of the key frames.

    Attributes:
        search: index that finds the word of a descriptor.
        shares: (W,) share of the key frames in which each word occurs.
        profiles: (F, W) weighted words of each key frame, rows of unit length.
    """

    search: WordIndex
    shares: Array
    profiles: csr_array

    @classmethod
    def build(cls, frames: Callable[[], Iterable[Floats]], config: IndexConfig) -> Self:
        """Draw words from the descriptors (N, D) of all key frames, then index the key frames by them.

        Args:
            frames: returns an iterator over the descriptors of each key frame; at least one in all. Called twice.
            config: settings.
        """
        sample = DescriptorSample(config.words, config.seed)
        for descriptors in frames():
            sample.add(descriptors)
        search = WordTree()
        search.add(sample.descriptors)
        found = [_distinct(search, descriptors) for descriptors in frames()]
        columns = np.concatenate(found)
        rows = np.repeat(np.arange(len(found)), [len(words) for words in found])
        counts = np.bincount(columns, minlength=len(sample.descriptors))
        shares = (counts + 0.5) / (len(found) + 1.0)
        profiles = csr_array((-np.log(shares[columns]), (rows, columns)), shape=(len(found), len(shares)))
        lengths = np.sqrt(profiles.power(2).sum(axis=1))
        profiles.data /= np.repeat(np.maximum(lengths, 1e-12), np.diff(profiles.indptr))
        return cls(search, np.asarray(shares, np.float64), profiles)

    def similarity(self, descriptors: Floats) -> Array:
        """Similarity (F,) of each key frame to an image with descriptors (N, D): a correlation, at most 1."""
        if len(descriptors) == 0:
            return np.zeros(self.profiles.shape[0])
        words, weights = _distinct(self.search, descriptors), -np.log(self.shares)
        query = -self.shares * weights  # words that most key frames show carry no information
        query[words] += weights[words]
        return np.asarray(self.profiles @ query) / max(float(np.linalg.norm(weights[words])), 1e-12)


def _distinct(search: WordIndex, descriptors: Floats) -> NDArray[np.int64]:
    return np.unique(search.nearest(descriptors)) if len(descriptors) else np.empty(0, np.int64)
