"""Words from many descriptors: k-means for float descriptors, hierarchical k-majority for binary ones.

`revisit vocabulary train` works with it, and `benchmarks/default_vocabulary.py`, which built the words that ship.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from place_recognition.map.k_majority import k_majority
from place_recognition.map.k_means import Rows, Spread, blocks, k_means
from place_recognition.map.vocabulary import Vocabulary
from place_recognition.map.vocabulary_file import bit_size, on_steps

Floats = NDArray[np.float32]

BRANCHING = 10  # of the tree of binary words (Bampis et al., IROS 2016, Table III)


@dataclass(frozen=True)
class TrainingConfig:
    """How words are trained.

    Attributes:
        words: how many; fewer come out where the descriptors do not differ enough.
        sample: descriptors kept of all that are seen, at most; each has the same chance.
        iterations: of k-means.
        seed: of every random choice.
    """

    words: int = 10000
    sample: int = 1000000
    iterations: int = 20
    seed: int = 0

    def __post_init__(self) -> None:
        if min(self.words, self.iterations) < 1 or self.sample < self.words:
            raise ValueError(
                f"expected words and iterations from 1 and a sample of at least as many descriptors as words,"
                f" got {self.words} words, {self.iterations} iterations, a sample of {self.sample}"
            )


class DescriptorSample:
    """A sample of a stream of descriptors in bounded memory: whatever their number, each is kept with the same chance.

    Vitter, 'Random sampling with a reservoir', ACM TOMS 11(1) 1985, algorithm R.
    """

    def __init__(self, limit: int, seed: int) -> None:
        self._limit, self._rng = limit, np.random.default_rng(seed)
        self._kept: list[Floats] = []  # until the reservoir is full
        self._reservoir: Floats | None = None
        self.seen = 0

    @property
    def descriptors(self) -> Floats:
        """Those kept (K, D); (0, 0) before the first."""
        if self._reservoir is not None:
            return self._reservoir
        return np.concatenate(self._kept) if self._kept else np.empty((0, 0), np.float32)

    def add(self, descriptors: Floats) -> None:
        """See the descriptors (N, D) of one more image."""
        free = max(0, self._limit - self.seen)
        if free and len(descriptors):
            self._kept.append(descriptors[:free].copy())
        self.seen += min(free, len(descriptors))
        self._replace(descriptors[free:])

    def _replace(self, descriptors: Floats) -> None:
        if len(descriptors) == 0:
            return
        if self._reservoir is None:
            self._reservoir, self._kept = np.concatenate(self._kept), []
        slots = self._rng.integers(0, self.seen + 1 + np.arange(len(descriptors)))
        chosen = slots < self._limit
        self._reservoir[slots[chosen]] = descriptors[chosen]  # of equal slots the last stays, as one after the other
        self.seen += len(descriptors)


def train_vocabulary(kind: str, descriptors: Floats, config: TrainingConfig, spread: Spread = map) -> Vocabulary:
    """Words and weights from descriptors.

    Args:
        kind: of the features (FeatureExtractor.kind).
        descriptors: (N, D); binary ones, all of +-1 / sqrt(D), get binary words.
        config: how.
        spread: what shares the work; the bits do not depend on it. The tree of binary words is made here alone.

    Raises:
        ValueError: fewer descriptors than words.
    """
    if len(descriptors) < config.words:
        raise ValueError(
            f"expected at least {config.words} descriptors for {config.words} words, got {len(descriptors)};"
            " give more images or ask for fewer words"
        )
    make_words = _binary_words if _is_binary(descriptors) else _float_words
    words = make_words(descriptors, config, spread)
    unweighted = Vocabulary(kind, words, np.zeros(len(words), np.float32))
    return Vocabulary(kind, words, inverse_frequencies(unweighted, descriptors, spread))


def inverse_frequencies(vocabulary: Vocabulary, descriptors: Floats, spread: Spread = map) -> Floats:
    """Weights (W,) log(N / N_i): N descriptors in all, N_i of them nearest to word i (Bampis et al., IROS 2016, eq. 3).

    A word that no descriptor is nearest to weighs as if one were.
    """
    counts = sum(spread(partial(_count, vocabulary), blocks(descriptors)), np.zeros(len(vocabulary), np.int64))
    return np.log(len(descriptors) / np.maximum(counts, 1)).astype(np.float32)


def _count(vocabulary: Vocabulary, rows: Rows) -> NDArray[np.int64]:
    return np.bincount(vocabulary.assign(rows.values), minlength=len(vocabulary))


def _float_words(descriptors: Floats, config: TrainingConfig, spread: Spread) -> Floats:
    return on_steps(k_means(descriptors, config.words, config.iterations, config.seed, spread))


def _binary_words(descriptors: Floats, config: TrainingConfig, _: Spread) -> Floats:
    size = descriptors.shape[1]
    bits = k_majority(descriptors > 0, config.words, BRANCHING, np.random.default_rng(config.seed))
    return np.where(bits, bit_size(size), -bit_size(size)).astype(np.float32)


def _is_binary(descriptors: Floats) -> bool:
    return bool((np.abs(descriptors[:1000]) == bit_size(descriptors.shape[1])).all())
