"""Both paradigms of sequences: word vectors of sequences, a filtered matrix, then single images.

Bampis, Amanatiadis, Gasteratos, IROS 2016 and IJRR 37(1) 2018; sections 4.4.1 and 4.4.2 of the chapter. Deviations of
the default from the papers (reasons and figures: docs/decisions/sequence_paradigms.md):
* Sequences are proposed without a threshold: the best ones by filter response and the best ones by similarity.
* The images of these sequences and of their neighbours are ranked by the correlation of their words plus the response
  of their sequences, where the papers take the L2 score of the images of one sequence.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter1d

from place_recognition.belief.distances import l2_score_of_cosine, scaled_l2_score_of_cosine
from place_recognition.belief.matrix_filter import DIAGONAL, LEARNED, FilterConfig, OnlineMatrixFilter, normalize_row
from place_recognition.map.sequence_map import (
    FixedDistanceConfig,
    FixedDistanceSegmentation,
    Segmentation,
    SequenceMap,
    WordVariance,
    WordVarianceConfig,
)
from place_recognition.recognizer import (
    MAX_STAGE_CANDIDATES,
    MatrixSink,
    NullMatrixSink,
    ObservedImage,
    Proposals,
    select_apart,
)
from place_recognition.vocabulary.tf_idf import ImageWords, WordVector, word_vector
from place_recognition.vocabulary.vocabulary import Vocabulary
from place_recognition.vocabulary.vocabulary_tree import VocabularyTree
from place_recognition.vocabulary.word_tree import HybridWordIndex

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]


# Scores of two word vectors by their cosine.
SCORES: dict[str, Callable[[ArrayLike], NDArray[np.float64]]] = {
    "scaled-l2": scaled_l2_score_of_cosine,
    "l2": l2_score_of_cosine,
    "cosine": np.asarray,
}


@dataclass(frozen=True)
class SequenceMatchingConfig:
    """How sequences, and then images, are matched.

    Attributes:
        word_features: number of strongest features of an image that become visual words.
        tf_power: exponent of the term frequency of a word in a sequence (`word_vector`). The papers' 1 gives repeated
            structure more weight than 0.5.
        max_query_words: number of words of largest weight of a sequence with which it is compared with earlier ones.
            The time of a query grows with it and with the map.
        score: score of two word vectors: "scaled-l2", "l2" (equation 4.6 as printed) or "cosine".
        min_previous_score: lower bound of the divisor of a row (eq. 4.7).
        max_sequences: number of best sequences by response that propose images.
        max_similar_sequences: number of best sequences by plain similarity that propose images too: the filters
            suppress a pass in the opposite direction.
        neighbor_sequences: number of sequences before and after each of them that propose images too.
        image_score: "correlation" of the words of two images, or "l2", the score of their word vectors.
        response_weight: weight of the response, in units of the filter's threshold, in the score of an image, which is
            the score of the two images plus this; infinity counts the response alone, as the papers do.
        max_candidates: number of best images of those that are proposed.
        min_separation: smallest number of images between any two of them.
    """

    word_features: int = 300
    tf_power: float = 0.5
    max_query_words: int = 256
    score: str = "scaled-l2"
    min_previous_score: float = 0.05
    max_sequences: int = 4
    max_similar_sequences: int = 4
    neighbor_sequences: int = 1
    image_score: str = "correlation"
    response_weight: float = 0.05
    max_candidates: int = MAX_STAGE_CANDIDATES
    min_separation: int = 4

    def __post_init__(self) -> None:
        """Raise ValueError for an unknown score."""
        if self.score not in SCORES:
            raise ValueError(f"expected a score of {', '.join(SCORES)}, got {self.score!r}")
        if self.image_score not in ("correlation", "l2"):
            raise ValueError(f"expected an image_score of correlation, l2, got {self.image_score!r}")


@dataclass(frozen=True)
class _EndedSequence:
    """A sequence that has ended; its row can be filtered when the next sequence has ended too.

    Attributes:
        images: locations of its images.
        last_matchable: latest location that each of its images may be matched with.
        vector: word vector of the sequence.
        row: (S,) normalised scores with earlier sequences.
    """

    images: range
    last_matchable: list[int]
    vector: WordVector
    row: Floats

    def state(self) -> dict[str, Any]:
        """The sequence as plain values and arrays, for a checkpoint."""
        return {
            "first_image": self.images.start,
            "last_image": self.images.stop - 1,
            "last_matchable": self.last_matchable,
            "vector": dict(vars(self.vector)),
            "row": self.row,
        }

    @classmethod
    def from_state(cls, state: dict[str, Any]) -> "_EndedSequence":
        """The sequence of a state."""
        images = range(state["first_image"], state["last_image"] + 1)
        return cls(images, state["last_matchable"], WordVector(**state["vector"]), state["row"])


class SequenceProposer:
    """Proposes images by sequences of images (a Proposer); answers when the next sequence has ended.

    Each paradigm of `place_recognition.paradigms.sequences` is this with its own segmentation and filter.
    """

    def __init__(
        self,
        kind: str,
        vocabulary: Vocabulary,
        segmentation: Segmentation,
        config: SequenceMatchingConfig,
        matrix_filter: FilterConfig,
        rows: MatrixSink | None = None,
    ) -> None:
        self.config = config
        self._segmentation = segmentation
        self._vocabulary = vocabulary.require(kind)
        self._find_words = _make_word_search(vocabulary)
        self._threshold, self._kernel = matrix_filter.threshold, matrix_filter.kernel
        self._filter = OnlineMatrixFilter(self._kernel)
        self._previous_score = 1.0  # of the latest sequence with the one before it
        self._words = ImageWords(len(vocabulary))
        self._map = SequenceMap(len(vocabulary))
        self._open: list[int] = []  # latest matchable location of each image of the sequence that has not ended
        self._waiting: _EndedSequence | None = None
        self._rows = NullMatrixSink() if rows is None else rows

    @property
    def word_count(self) -> int:
        """Number of words of the vocabulary."""
        return len(self._vocabulary)

    def observe(self, image: ObservedImage) -> list[Proposals]:
        """Add an image; if it begins a sequence, propose images for those of the last but one sequence before it."""
        words = self._assign(image.features.descriptors[: self.config.word_features])
        begins = self._segmentation.starts_sequence(words, image.distance_travelled_m)
        answered = self._end_sequence(image.location - 1) if begins else []
        self._words.add(words)  # after the sequence has ended, to which this image does not belong
        self._open.append(image.last_matchable)
        return answered

    def finish(self) -> list[Proposals]:
        """Propose images for those of the last two sequences."""
        answered = self._end_sequence(len(self._words) - 1)
        if self._waiting is not None:
            answered += self._answer(self._waiting, self._filter.finish())
        self._waiting = None
        return answered

    def end_reference(self) -> None:
        """Begin a new sequence with the next image, whose rows have none before them (a ReferenceProposer)."""
        self._segmentation.restart()
        self._filter = OnlineMatrixFilter(self._kernel)

    def _assign(self, descriptors: Floats) -> Indices:
        return self._find_words(descriptors) if len(descriptors) else np.empty(0, np.int64)

    def _end_sequence(self, last: int) -> list[Proposals]:
        """End the open sequence at location `last` and answer for the sequence before it, whose row can be filtered."""
        if not self._open:
            return []
        ended = self._compare(range(last + 1 - len(self._open), last + 1))
        response, waiting = self._filter.add(ended.row), self._waiting
        self._map.add(last, ended.vector)
        self._open, self._waiting = [], ended
        return [] if waiting is None else self._answer(waiting, response)

    def _compare(self, images: range) -> _EndedSequence:
        """Compare the sequence of these images with all earlier sequences."""
        vector = word_vector(
            self._words.words_between(images[0], images[-1]), self._vocabulary.weights, self.config.tf_power
        )
        heaviest, score = vector.strongest(self.config.max_query_words), SCORES[self.config.score]
        scores = score(self._map.index.cosines(heaviest, self._map.count_ended_by(self._open[-1]))).astype(np.float32)
        # The first sequence has no predecessor, and no earlier sequences to compare with either. That of the first one
        # after a reference recording is as alike as the last two of the reference.
        if self._waiting:
            self._previous_score = float(score(heaviest.cosine(self._waiting.vector)))
        row = normalize_row(scores, self._previous_score, self.config.min_previous_score)
        return _EndedSequence(images, self._open, vector, row)

    def _answer(self, sequence: _EndedSequence, response: Floats | None) -> list[Proposals]:
        assert response is not None  # the filter has the row of each waiting sequence
        self._record(sequence.images[0], sequence.row, "similarity")
        self._record(sequence.images[0], response, "filtered")
        sequences = np.union1d(
            _best_of_row(response, self.config.max_sequences),
            _best_of_row(sequence.row, self.config.max_similar_sequences),
        )
        pool = self._map.images_near(sequences, self.config.neighbor_sequences)
        return [
            self._propose(location, last_matchable, pool[pool <= last_matchable], response)
            for location, last_matchable in zip(sequence.images, sequence.last_matchable, strict=True)
        ]

    def _record(self, query: int, row: Floats, stage: str) -> None:
        """Hand a row to the matrix sink; each sequence has the location of its first image."""
        self._rows.add(query, self._map.first(np.arange(len(row))), row.astype(np.float64), stage)

    def _propose(self, query: int, last_matchable: int, pool: Indices, response: Floats) -> Proposals:
        """Propose the images of a pool of locations that are most similar to the image at location `query`."""
        similarity = self._image_similarity(query, pool)
        # An image without any similarity, like one without features, shows nothing.
        pool, similarity = pool[similarity > 0], similarity[similarity > 0]
        scores, weight = self._responses_at(pool, response), self.config.response_weight
        if np.isfinite(weight):
            scores = similarity + weight * np.maximum(scores, 0.0) / self._threshold
        order = np.lexsort((-similarity, -scores))
        chosen = order[select_apart(pool[order].tolist(), self.config.max_candidates, self.config.min_separation)]
        return Proposals(query, last_matchable, tuple(pool[chosen].tolist()), tuple(scores[chosen].tolist()))

    def _image_similarity(self, query: int, pool: Indices) -> NDArray[np.float64]:
        """Similarity (K,) of the image at location `query` with those of a pool (K,)."""
        if self.config.image_score == "correlation":
            return self._words.correlation(query, pool).astype(np.float64)
        vectors = [self._image_vector(location) for location in pool.tolist()]
        own = self._image_vector(query)
        return SCORES[self.config.score](np.array([own.cosine(vector) for vector in vectors]))

    def _image_vector(self, location: int) -> WordVector:
        words = self._words.words_between(location, location)
        return word_vector(words, self._vocabulary.weights, self.config.tf_power)

    def _responses_at(self, locations: Indices, response: Floats) -> NDArray[np.float64]:
        """The largest response (K,) of the sequence of each image (K,) and of its neighbours that propose too."""
        # Sequences of two passes are cut at different images, so a match near the end may respond in the next one.
        if len(response) == 0:
            return np.zeros(len(locations))
        largest = maximum_filter1d(response.astype(np.float64), 2 * self.config.neighbor_sequences + 1, mode="nearest")
        sequences = np.array([self._map.sequence_of(location) for location in locations.tolist()], np.int64)
        return largest[np.minimum(sequences, len(largest) - 1)]

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint; the vocabulary stays as it is."""
        return {
            "segmentation": self._segmentation.state(),
            "filter": self._filter.state(),
            "words": self._words.state(),
            "sequences": self._map.state(),
            "open_last_matchable": list(self._open),
            "waiting": None if self._waiting is None else self._waiting.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another proposer of this configuration and vocabulary."""
        self._segmentation.restore(state["segmentation"])
        self._filter.restore(state["filter"])
        self._words.restore(state["words"])
        self._map.restore(state["sequences"])
        self._open = list(state["open_last_matchable"])
        self._waiting = None if state["waiting"] is None else _EndedSequence.from_state(state["waiting"])


def _make_word_search(vocabulary: Vocabulary) -> Callable[[Floats], Indices]:
    """Make the function that finds the word (N,) of each descriptor (N, D)."""
    if isinstance(vocabulary, VocabularyTree):
        return vocabulary.assign
    index = HybridWordIndex()  # finds 99.4 % of the words of an exhaustive search in 0.6 of its time
    index.add(vocabulary.words)
    return index.nearest


def _best_of_row(row: Floats, max_count: int) -> Indices:
    """Columns that are among the `max_count` best of a row (S,) and positive."""
    # Their order does not matter, so a partition is enough: O(S) instead of O(S log S).
    best = np.argpartition(-row, max_count)[:max_count] if len(row) > max_count else np.arange(len(row))
    return best[row[best] > 0].astype(np.int64)


@dataclass(frozen=True)
class SequenceHistogramsConfig:
    """Settings of the paradigm of sequences of a fixed distance.

    Attributes:
        sequences: length of a sequence.
        filter: kernel of equation 4.8 and the threshold of its response.
        matching: how sequences, and then images, are matched.
    """

    sequences: FixedDistanceConfig = field(default_factory=FixedDistanceConfig)
    filter: FilterConfig = field(default_factory=lambda: FilterConfig(DIAGONAL, 0.32))
    matching: SequenceMatchingConfig = field(default_factory=SequenceMatchingConfig)


@dataclass(frozen=True)
class DynamicSequencesConfig:
    """Settings of the paradigm of sequences that end where the view changes.

    Attributes:
        sequences: when a sequence ends.
        filter: kernel of equation 4.12 and the threshold of its response. The paper's threshold is 3.5; damped term
            frequencies (`SequenceMatchingConfig.tf_power`) make all responses smaller, and in simulated blocks those of
            other places stayed below 2.2.
        matching: how sequences, and then images, are matched.
    """

    sequences: WordVarianceConfig = field(default_factory=WordVarianceConfig)
    filter: FilterConfig = field(default_factory=lambda: FilterConfig(LEARNED, 2.2))
    matching: SequenceMatchingConfig = field(default_factory=SequenceMatchingConfig)


def make_sequence_histograms(
    kind: str,
    vocabulary: Vocabulary,
    config: SequenceHistogramsConfig | None = None,
    rows: MatrixSink | None = None,
) -> SequenceProposer:
    """Make a proposer of sequences of a fixed distance that has seen nothing."""
    config = config or SequenceHistogramsConfig()
    segmentation = FixedDistanceSegmentation(config.sequences)
    return SequenceProposer(kind, vocabulary, segmentation, config.matching, config.filter, rows)


def make_dynamic_sequences(
    kind: str,
    vocabulary: Vocabulary,
    config: DynamicSequencesConfig | None = None,
    rows: MatrixSink | None = None,
) -> SequenceProposer:
    """Make a proposer of sequences that end where the view changes; it has seen nothing."""
    config = config or DynamicSequencesConfig()
    segmentation = WordVariance(len(vocabulary), config.sequences)
    return SequenceProposer(kind, vocabulary, segmentation, config.matching, config.filter, rows)
