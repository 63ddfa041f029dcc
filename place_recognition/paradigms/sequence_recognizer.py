"""Recogniser of both paradigms of sequences: word vectors of sequences, a filtered matrix, then single images.

Bampis, Amanatiadis, Gasteratos, IROS 2016 and IJRR 37(1) 2018; sections 4.4.1 and 4.4.2 of the chapter. Deviations from
the papers (reasons and figures: docs/decisions/sequence_paradigms.md):
* Sequences are proposed without a threshold: the best ones by filter response and the best ones by similarity.
* The images of the proposed sequences and of their neighbours are ranked by their word vectors, and the best ones are
  compared feature by feature. The score is the filter response plus the evidence of geometry.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from place_recognition.belief.candidate_selection import CandidateVerifier
from place_recognition.belief.candidate_verification import CandidateVerificationConfig, VerificationResult
from place_recognition.belief.distances import l2_score_of_cosine, scaled_l2_score_of_cosine
from place_recognition.belief.geometric_verification import EpipolarConfig
from place_recognition.belief.matrix_filter import FilterConfig, OnlineMatrixFilter, normalize_row
from place_recognition.belief.sequence_consensus import CandidateBeliefs, DelayedDecision, SequenceConsensusConfig
from place_recognition.belief.temporal_consistency import ConsistencyConfig
from place_recognition.image_processing.local_features import FeatureCache, check_gray
from place_recognition.map.image_history import ImageHistory, ImageHistoryConfig
from place_recognition.map.sequence_map import Segmentation, SequenceMap
from place_recognition.recognizer import Belief, MatrixSink, NullMatrixSink
from place_recognition.vocabulary.tf_idf import ImageWords, WordVector, word_vector
from place_recognition.vocabulary.vocabulary import Vocabulary
from place_recognition.vocabulary.word_tree import HybridWordIndex

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]

ALL_WORDS = 1_000_000  # more words than a sequence has

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
        max_sequences: number of best sequences by response, and of best ones by similarity, that propose images.
        max_candidates: number of best images of those that are compared feature by feature.
        response_weight: evidence, in powers of ten, of a response at the filter's threshold.
        response_threshold: smallest response of an accepted match; the default accepts any, so that geometry decides.
        history: which features are kept of each image, and which images may be matched.
        verification: how candidates are verified geometrically.
        consistency: which earlier results support a new one.
        consensus: the delayed decision.
    """

    word_features: int = 300
    tf_power: float = 0.5
    max_query_words: int = 256
    score: str = "scaled-l2"
    min_previous_score: float = 0.05
    max_sequences: int = 4
    max_candidates: int = 8
    response_weight: float = 10.0
    response_threshold: float = -100.0
    history: ImageHistoryConfig = field(default_factory=ImageHistoryConfig)
    verification: CandidateVerificationConfig = field(
        default_factory=lambda: CandidateVerificationConfig(epipolar=EpipolarConfig(min_inliers=12))
    )
    consistency: ConsistencyConfig = field(default_factory=ConsistencyConfig)
    consensus: SequenceConsensusConfig = field(default_factory=SequenceConsensusConfig)

    def __post_init__(self) -> None:
        """Raise ValueError for an unknown score."""
        if self.score not in SCORES:
            raise ValueError(f"expected a score of {', '.join(SCORES)}, got {self.score!r}")


def make_published_matching(threshold: float) -> SequenceMatchingConfig:
    """Return the papers' numbers where they are known: plain term frequencies, 12 inliers, a response at the threshold.

    The score is nevertheless the one in [0, 1]: with equation 4.6 as printed, no revisit would reach the learnt
    filter's threshold of 3.5.
    """
    return SequenceMatchingConfig(
        tf_power=1.0,
        max_query_words=ALL_WORDS,
        min_previous_score=0.005,
        response_threshold=threshold,
        verification=CandidateVerificationConfig(epipolar=EpipolarConfig(min_inliers=12)),
        consensus=SequenceConsensusConfig.disabled(),
    )


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


class SequenceRecognizer:
    """Recognises places by sequences of images (a PlaceRecognizer); answers when the next sequence has ended.

    Each paradigm of `place_recognition.paradigms.sequence_paradigms` is this with its own segmentation and filter.
    """

    def __init__(
        self,
        features: FeatureCache,
        vocabulary: Vocabulary,
        segmentation: Segmentation,
        config: SequenceMatchingConfig,
        matrix_filter: FilterConfig,
        rows: MatrixSink | None = None,
    ) -> None:
        self.config = config
        self._features, self._segmentation = features, segmentation
        self._vocabulary = vocabulary.require(features.kind)
        self._index = HybridWordIndex()  # finds 99.4 % of the words of an exhaustive search in 0.6 of its time
        self._index.add(vocabulary.words)
        self._threshold, self._filter = matrix_filter.threshold, OnlineMatrixFilter(matrix_filter.kernel)
        self._history = ImageHistory(config.history)
        self._words = ImageWords(len(vocabulary))
        self._map = SequenceMap(len(vocabulary))
        self._verifier = CandidateVerifier(self._history.images, config.verification, config.consistency)
        self._decision = DelayedDecision(self._history, config.consensus)
        self._open: list[int] = []  # latest matchable location of each image of the sequence that has not ended
        self._waiting: _EndedSequence | None = None
        self._rows = NullMatrixSink() if rows is None else rows

    @property
    def word_count(self) -> int:
        """Number of words of the vocabulary."""
        return len(self._vocabulary)

    def observe(self, image_id: int, image: NDArray[np.uint8], distance_travelled_m: float) -> list[Belief]:
        """Add an image; if it begins a sequence, answer for the images of the last but one before it.

        Args:
            image_id: greater than the one before.
            image: (H, W) uint8, grey.
            distance_travelled_m: length of the path so far, metres; NaN, or always the same, where it is not measured.
        """
        check_gray(image)
        features = self._features.get(image_id, image)
        location = self._history.add(image_id, features, distance_travelled_m)
        words = self._assign(features.descriptors[: self.config.word_features])
        begins = self._segmentation.starts_sequence(words, distance_travelled_m)
        answered = self._end_sequence(location - 1) if begins else []
        self._words.add(words)  # after the sequence has ended, to which this image does not belong
        self._open.append(self._history.last_matchable())
        return self._decide(answered)

    def finish(self) -> list[Belief]:
        """Answer for the images of the last two sequences."""
        answered = self._end_sequence(self._history.latest)
        if self._waiting is not None:
            answered += self._answer(self._waiting, self._filter.finish())
        self._waiting = None
        return self._decide(answered) + self._decision.finish()

    def _decide(self, answered: list[CandidateBeliefs]) -> list[Belief]:
        return [belief for candidates in answered for belief in self._decision.add(candidates)]

    def _assign(self, descriptors: Floats) -> Indices:
        return self._index.nearest(descriptors) if len(descriptors) else np.empty(0, np.int64)

    def _end_sequence(self, last: int) -> list[CandidateBeliefs]:
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
        # The first sequence has no predecessor, and no earlier sequences to compare with either.
        previous = float(score(heaviest.cosine(self._waiting.vector))) if self._waiting else 1.0
        row = normalize_row(scores, previous, self.config.min_previous_score)
        return _EndedSequence(images, self._open, vector, row)

    def _answer(self, sequence: _EndedSequence, response: Floats | None) -> list[CandidateBeliefs]:
        assert response is not None  # the filter has the row of each waiting sequence
        self._record(sequence.images[0], sequence.row, "similarity")
        self._record(sequence.images[0], response, "filtered")
        # The filters suppress a pass in the opposite direction, so the best ones by plain similarity propose too.
        pool = self._map.images_near(_best_columns((response, sequence.row), self.config.max_sequences))
        return [
            self._match(location, pool[pool <= last_matchable], last_matchable, response)
            for location, last_matchable in zip(sequence.images, sequence.last_matchable, strict=True)
        ]

    def _record(self, query: int, row: Floats, stage: str) -> None:
        """Hand a row to the matrix sink; each sequence has the id of its first image."""
        firsts = self._map.first(np.arange(len(row)))
        self._rows.add(int(self._history.ids[query]), self._history.ids[firsts], row.astype(np.float64), stage)

    def _match(self, query: int, pool: Indices, last_matchable: int, response: Floats) -> CandidateBeliefs:
        """Match the image at location `query` with the most similar images of a pool of locations."""
        candidates = _rank_by_similarity(pool, self._words.correlation(query, pool), self.config.max_candidates)
        results = self._verifier.verify(query, candidates, last_matchable)
        query_id = int(self._history.ids[query])
        return CandidateBeliefs.from_results(query_id, results, lambda result: self._make_belief(result, response))

    def _response_at(self, location: int, response: Floats) -> float:
        """The largest response of the sequence of an image and of the sequences before and after it."""
        # Sequences of two passes are cut at different images, so a match near the end may respond in the next one.
        sequence = self._map.sequence_of(location)
        around = response[max(sequence - 1, 0) : sequence + 2]
        return float(around.max()) if len(around) else 0.0

    def _make_belief(self, result: VerificationResult, responses: Floats) -> Belief:
        response = self._response_at(result.location, responses)
        return Belief(
            query=int(self._history.ids[result.query]),
            match=int(self._history.ids[result.location]),
            score=self.config.response_weight * max(response, 0.0) / self._threshold + result.evidence,
            accepted=result.verified and response >= self.config.response_threshold,
            inliers=result.inliers,
            verified=result.verified,
            pixels=result.pixels,
        )

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint; the vocabulary stays as it is."""
        return {
            "segmentation": self._segmentation.state(),
            "filter": self._filter.state(),
            "history": self._history.state(),
            "words": self._words.state(),
            "sequences": self._map.state(),
            "consistency": self._verifier.state(),
            "decision": self._decision.state(),
            "open_last_matchable": list(self._open),
            "waiting": None if self._waiting is None else self._waiting.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another recogniser of this configuration and vocabulary."""
        self._segmentation.restore(state["segmentation"])
        self._filter.restore(state["filter"])
        self._history.restore(state["history"])
        self._words.restore(state["words"])
        self._map.restore(state["sequences"])
        self._verifier.restore(state["consistency"])
        self._decision.restore(state["decision"])
        self._open = list(state["open_last_matchable"])
        self._waiting = None if state["waiting"] is None else _EndedSequence.from_state(state["waiting"])


def _best_columns(rows: tuple[Floats, ...], max_count: int) -> Indices:
    """Columns, rising, that are among the `max_count` best of at least one of the rows (S,) and positive there."""
    return np.unique(np.concatenate([_best_of_row(row, max_count) for row in rows]))


def _best_of_row(row: Floats, max_count: int) -> Indices:
    # Their order does not matter, so a partition is enough: O(S) instead of O(S log S).
    best = np.argpartition(-row, max_count)[:max_count] if len(row) > max_count else np.arange(len(row))
    return best[row[best] > 0].astype(np.int64)


def _rank_by_similarity(locations: Indices, similarity: Floats, max_count: int) -> list[int]:
    """Up to `max_count` of the locations (K,), the most similar first, no two of them adjacent.

    Adjacent images show the same, so the better one is enough. Images without any similarity are left out, like those
    without features.
    """
    chosen: list[int] = []
    order = np.argsort(-similarity, kind="stable")
    for k in order[similarity[order] > 0]:
        location = int(locations[k])
        if location - 1 not in chosen and location + 1 not in chosen:
            chosen.append(location)
        if len(chosen) == max_count:
            break
    return chosen
