"""A pre-trained visual vocabulary: some thousand descriptors that represent all (chapter, 4.2.1.2 and Figure 4.4).

Two ship: 10,000 words of upright SURF, and for the published presets a tree of 100,000 words of BRIEF. They were
trained on simulated towns, photographs and surfaces of games, and on no recording (docs/decisions/default_vocabulary.md
and docs/decisions/published_vocabulary.md).
"""

from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.vocabulary.vocabulary_file import (
    REMEDY,
    Contents,
    FlatContents,
    TreeContents,
    read_contents,
    write_contents,
)
from place_recognition.vocabulary.vocabulary_tree import VocabularyTree
from place_recognition.vocabulary.word_tree import nearest_words

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]

DEFAULT_FILE = "default.vocabulary"
PUBLISHED_FILE = "published.vocabulary"


class Vocabulary(Protocol):
    """Visual words and their weights: a `FlatVocabulary`, or a `VocabularyTree` of binary words."""

    @property
    def kind(self) -> str:
        """Kind of the features that the words are made of (FeatureExtractor.kind), for example "surf-upright-64"."""
        ...

    @property
    def words(self) -> Floats:
        """All words (W, D) float32 on the scale of the descriptors."""
        ...

    @property
    def weights(self) -> Floats:
        """Inverse document frequencies (W,) float32 of the words."""
        ...

    def __len__(self) -> int:
        """Number of words."""
        ...

    def assign(self, descriptors: Floats) -> Indices:
        """Find the word (N,) of each descriptor (N, D).

        Raises:
            ValueError: the descriptors have another length than the words.
        """
        ...

    def require(self, kind: str) -> "Vocabulary":
        """Return the vocabulary itself if its words are made of features of a kind.

        Raises:
            ValueError: the words are made of other features.
        """
        ...


@dataclass(frozen=True)
class FlatVocabulary:
    """Visual words that are all compared with a descriptor (a Vocabulary).

    Attributes:
        kind: kind of the features that the words are made of (FeatureExtractor.kind), for example "surf-upright-64".
        words: (W, D) float32 words on the scale of the descriptors; at least one.
        weights: (W,) float32 inverse document frequencies, log(N / N_i) over the N training features, N_i of them in
            word i (Bampis, Amanatiadis, Gasteratos, IROS 2016, eq. 3).

    Raises:
        ValueError: the shapes do not agree, there is no word, or there are numbers that are not finite.
    """

    kind: str
    words: Floats
    weights: Floats

    def __post_init__(self) -> None:
        if self.words.ndim != 2 or self.words.size == 0 or self.weights.shape != self.words.shape[:1]:
            shapes = f"{self.words.shape} and {self.weights.shape}"
            raise ValueError(f"expected words (W, D) and weights (W,) with W > 0, got {shapes}")
        if not (np.isfinite(self.words).all() and np.isfinite(self.weights).all()):
            raise ValueError("expected words and weights that are finite, got some that are not")

    def __len__(self) -> int:
        return len(self.words)

    def assign(self, descriptors: Floats) -> Indices:
        """Find the nearest word (N,) of each descriptor (N, D), Euclidean and exact; the first of equally near ones.

        Raises:
            ValueError: the descriptors have another length than the words.
        """
        if len(descriptors) == 0:
            return np.empty(0, np.int64)
        if descriptors.shape[1:] != self.words.shape[1:]:
            raise ValueError(f"expected descriptors (N, {self.words.shape[1]}), got {descriptors.shape}")
        return nearest_words(descriptors, self.words)

    def require(self, kind: str) -> "FlatVocabulary":
        """Return the vocabulary itself if its words are made of features of a kind.

        Raises:
            ValueError: the words are made of other features.
        """
        if kind != self.kind:
            raise ValueError(
                f"expected a vocabulary of {kind} features, found one of {self.kind};"
                " train one on images with: revisit vocabulary train"
            )
        return self


def save_vocabulary(path: Path, vocabulary: Vocabulary) -> None:
    """Write a vocabulary, whole or not at all; `load_vocabulary` returns the same bits.

    Raises:
        OSError: the file cannot be written.
    """
    write_contents(path, _contents_of(vocabulary))


def _contents_of(vocabulary: Vocabulary) -> Contents:
    if isinstance(vocabulary, VocabularyTree):
        tree = vocabulary
        return TreeContents(tree.kind, tree.size, tree.centers, tree.children, tree.weights)
    return FlatContents(vocabulary.kind, vocabulary.words, vocabulary.weights)


def _make_vocabulary(contents: Contents) -> Vocabulary:
    kind = VocabularyTree if isinstance(contents, TreeContents) else FlatVocabulary
    return kind(**vars(contents))


def load_vocabulary(path: Path) -> Vocabulary:
    """Read a vocabulary.

    Raises:
        ValueError: the file is missing, of another type or version, or damaged; one line that names the file, what was
            expected and found, and the remedy.
    """
    contents = read_contents(path)
    try:
        return _make_vocabulary(contents)
    except ValueError as error:
        raise ValueError(
            f"{path}: expected the contents of a vocabulary, found other ones ({error}); {REMEDY}"
        ) from error


def default_vocabulary() -> Vocabulary:
    """Load the general vocabulary that ships with the package, of "surf-upright-64" features."""
    return _load_shipped(DEFAULT_FILE)


def published_vocabulary() -> Vocabulary:
    """Load the large vocabulary that ships for the published presets, of "brief-256" features.

    Its visual word variance (Bampis et al., IJRR 2018) is near the published limit of 0.75 between neighbouring images
    of a drive, and above 0.9 between images of different places.
    """
    return _load_shipped(PUBLISHED_FILE)


def _load_shipped(name: str) -> Vocabulary:
    with as_file(files("place_recognition.vocabulary") / name) as path:
        return load_vocabulary(path)


def word_histogram(features: LocalFeatures, vocabulary: Vocabulary) -> Indices:
    """Count how often each word (W,) occurs among the features of an image: the 1 x W vector of Figure 4.4.

    For the chapter; no paradigm uses it.
    """
    return np.bincount(vocabulary.assign(features.descriptors), minlength=len(vocabulary))
