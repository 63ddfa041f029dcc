"""What the two paradigms of sequences have in common: words, sequences, the filtered matrix, then the images.

Bampis, Amanatiadis, Gasteratos, IROS 2016 and IJRR 37(1) 2018; sections 4.4.1 and 4.4.2 of the chapter. What differs
from the papers, each for a reason found on images that do not judge:
* A lone response is no revisit yet, and a revisit need not have one: the filters suppress a way driven backwards. So
  the best sequences by response and the best by plain similarity propose, whatever the threshold.
* The images of the proposed sequences and of their neighbours are ranked by their word vectors; the best are compared
  feature by feature, and the geometry of an image and of those around it joins the response in the score.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from place_recognition.belief.distances import l2_score_of_cosine, scaled_l2_score_of_cosine
from place_recognition.belief.geometric_verification import VerificationConfig
from place_recognition.belief.hindsight import HindsightConfig, Opinion
from place_recognition.belief.judge import Judge
from place_recognition.belief.matrix_filter import CausalFilter, FilterConfig, normalised
from place_recognition.belief.proof import Proof, ProofConfig
from place_recognition.belief.temporal_consistency import ConsistencyConfig
from place_recognition.belief.verdicts import Verdicts
from place_recognition.image_processing.features import FeatureCache, check_gray
from place_recognition.map.route import ImageHistory, ImageHistoryConfig
from place_recognition.map.sequence_map import SequenceMap
from place_recognition.map.sequences import Segmentation
from place_recognition.map.vocabulary import Vocabulary
from place_recognition.map.word_tree import HybridWordIndex
from place_recognition.map.word_vectors import ImageWords, WordVector, word_vector
from place_recognition.recognizer import Belief, NoRows, RowSink

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]

ALL = 1_000_000  # more words than a sequence has

SCORES: dict[str, Callable[[ArrayLike], NDArray[np.float64]]] = {
    "scaled-l2": scaled_l2_score_of_cosine,
    "l2": l2_score_of_cosine,
    "cosine": np.asarray,
}


@dataclass(frozen=True)
class MatchingConfig:
    """How sequences are matched, and then images.

    Attributes:
        features: strongest of an image that become words.
        power: of the number of times that a word occurs in a sequence (see `word_vector`). With 1, as published, the
            best four sequences hold the right one in 0.86 of the revisits of simulated blocks, with 0.5 in 0.91.
        asked: words of greatest weight of a sequence with which it is compared with earlier ones. The time of a query
            grows with it and with the map; at a million images all thousand words would take most of a second.
        score: of two word vectors: scaled-l2, l2 (equation 4.6 as printed) or cosine.
        least_divisor: a row is divided by at least so much (eq. 4.7).
        sequences: best sequences by response, and as many by similarity, whose images are looked at.
        images: best images of those that are compared feature by feature.
        worth: powers of ten that a response at the filter's threshold adds to the evidence of geometry.
        least_response: a match whose sequence responds less is not accepted; any will do where geometry decides.
        route: what is kept of each image, and which are past.
        proof: how a revisit is proved.
        consistency: which earlier proofs speak for a new one.
        hindsight: what the images around one say for it.
    """

    features: int = 300
    power: float = 0.5
    asked: int = 256
    score: str = "scaled-l2"
    least_divisor: float = 0.05
    sequences: int = 4
    images: int = 8
    worth: float = 10.0
    least_response: float = -100.0
    route: ImageHistoryConfig = field(default_factory=ImageHistoryConfig)
    proof: ProofConfig = field(default_factory=lambda: ProofConfig(verification=VerificationConfig(least_inliers=12)))
    consistency: ConsistencyConfig = field(default_factory=ConsistencyConfig)
    hindsight: HindsightConfig = field(default_factory=HindsightConfig)

    def __post_init__(self) -> None:
        if self.score not in SCORES:
            raise ValueError(f"expected a score of {', '.join(SCORES)}, got {self.score!r}")


def published_matching(threshold: float) -> MatchingConfig:
    """The papers' numbers where they are known: plain term frequencies, 12 inliers, no revisit without a response.

    The score is the one in [0, 1] all the same: with equation 4.6 as printed, no revisit would reach the learnt
    filter's threshold of 3.5.
    """
    proof = ProofConfig(verification=VerificationConfig(least_inliers=12))
    return MatchingConfig(
        power=1.0,
        asked=ALL,
        least_divisor=0.005,
        least_response=threshold,
        proof=proof,
        hindsight=HindsightConfig.none(),
    )


@dataclass(frozen=True)
class _Sequence:
    """A sequence that has ended and waits for the next one, without which its row cannot be filtered.

    Attributes:
        images: locations of its images.
        horizons: the latest location that each of them may be matched with.
        vector: of its words.
        row: (S,) normalised scores with earlier sequences.
    """

    images: range
    horizons: list[int]
    vector: WordVector
    row: Floats

    def state(self) -> dict[str, Any]:
        """The sequence as plain values and arrays, for a checkpoint."""
        return {
            "first_image": self.images.start,
            "last_image": self.images.stop - 1,
            "horizons": self.horizons,
            "vector": dict(vars(self.vector)),
            "row": self.row,
        }

    @classmethod
    def from_state(cls, state: dict[str, Any]) -> "_Sequence":
        """The sequence of a state."""
        images = range(state["first_image"], state["last_image"] + 1)
        return cls(images, state["horizons"], WordVector(**state["vector"]), state["row"])


class SequenceMatching:
    """Finds revisits through sequences of images: both paradigms consist of this, a segmentation and a filter."""

    def __init__(
        self,
        features: FeatureCache,
        vocabulary: Vocabulary,
        segmentation: Segmentation,
        config: MatchingConfig,
        matrix_filter: FilterConfig,
    ) -> None:
        self.config = config
        self._features, self._segmentation = features, segmentation
        self._vocabulary = vocabulary.require(features.kind)
        self._index = HybridWordIndex()  # 99.4 % of the words that an exhaustive search finds, in 0.6 of the time
        self._index.add(vocabulary.words)
        self._threshold, self._filter = matrix_filter.threshold, CausalFilter(matrix_filter.kernel)
        self._route = ImageHistory(config.route)
        self._words = ImageWords(len(vocabulary))
        self._map = SequenceMap(len(vocabulary))
        self._judge = Judge(self._route.images, config.proof, config.consistency)
        self._verdicts = Verdicts(self._route, self.config.hindsight)
        self._open: list[int] = []  # horizons of the images of the sequence that has not ended
        self._waiting: _Sequence | None = None
        self._rows: RowSink = NoRows()

    def show_rows(self, rows: RowSink) -> None:
        """Hand the matrix's rows to a sink from now on: one a sequence, known by its first image."""
        self._rows = rows

    def observe(self, image_id: int, image: NDArray[np.uint8], travelled: float) -> list[Belief]:
        """Add an image; if it begins a sequence, answer for the images of the last but one before it."""
        check_gray(image)
        features = self._features.get(image_id, image)
        location = self._route.add(image_id, features, travelled)
        words = self._assign(features.descriptors[: self.config.features])
        begins = self._segmentation.starts_sequence(words, travelled)
        opinions = self._end_sequence(location - 1) if begins else []
        self._words.add(words)
        self._open.append(self._route.last_matchable())
        return self._settled(opinions)

    def finish(self) -> list[Belief]:
        """Answer for the images of the last two sequences."""
        opinions = self._end_sequence(self._route.latest)
        if self._waiting is not None:
            opinions += self._answer(self._waiting, self._filter.finish())
        self._waiting = None
        return self._settled(opinions) + self._verdicts.finish()

    def _settled(self, opinions: list[Opinion]) -> list[Belief]:
        return [belief for opinion in opinions for belief in self._verdicts.add(opinion)]

    def _assign(self, descriptors: Floats) -> Indices:
        return self._index.nearest(descriptors) if len(descriptors) else np.empty(0, np.int64)

    def _end_sequence(self, last: int) -> list[Opinion]:
        """Compare the open sequence with earlier ones; that completes the neighbourhood of the one before it."""
        if not self._open:
            return []
        ended = self._compare(range(last + 1 - len(self._open), last + 1))
        response, waiting = self._filter.add(ended.row), self._waiting
        self._map.add(last, ended.vector)
        self._open, self._waiting = [], ended
        return [] if waiting is None else self._answer(waiting, response)

    def _compare(self, images: range) -> _Sequence:
        vector = word_vector(
            self._words.words_between(images[0], images[-1]), self._vocabulary.weights, self.config.power
        )
        asked, score = vector.strongest(self.config.asked), SCORES[self.config.score]
        scores = score(self._map.index.cosines(asked, self._map.count_ended_by(self._open[-1]))).astype(np.float32)
        previous = float(score(asked.cosine(self._waiting.vector))) if self._waiting else 1.0
        row = normalised(scores, previous, self.config.least_divisor)
        return _Sequence(images, self._open, vector, row)

    def _answer(self, sequence: _Sequence, response: Floats | None) -> list[Opinion]:
        assert response is not None  # a sequence waits, so the filter has its row
        self._show(sequence.images[0], sequence.row, "similarity")
        self._show(sequence.images[0], response, "filtered")
        pool = self._map.images_near(_best_of((response, sequence.row), self.config.sequences))
        return [
            self._opinion(location, pool[pool <= horizon], horizon, response)
            for location, horizon in zip(sequence.images, sequence.horizons, strict=True)
        ]

    def _show(self, query: int, row: Floats, stage: str) -> None:
        firsts = self._map.first(np.arange(len(row)))
        self._rows.add(int(self._route.ids[query]), self._route.ids[firsts], row.astype(np.float64), stage)

    def _opinion(self, query: int, pool: Indices, horizon: int, response: Floats) -> Opinion:
        alike = _spread(pool, self._words.correlation(query, pool), self.config.images)
        proofs = self._judge.judge(query, alike, horizon)
        return Opinion.of(int(self._route.ids[query]), proofs, lambda proof: self._belief(proof, response))

    def _response_at(self, location: int, response: Floats) -> float:
        """The response of the sequence of an image, or of the one before or after it if that is greater."""
        sequence = self._map.sequence_of(location)
        around = response[max(sequence - 1, 0) : sequence + 2]
        return float(around.max()) if len(around) else 0.0

    def _belief(self, proof: Proof, responses: Floats) -> Belief:
        response = self._response_at(proof.location, responses)
        return Belief(
            query=int(self._route.ids[proof.query]),
            match=int(self._route.ids[proof.location]),
            score=self.config.worth * max(response, 0.0) / self._threshold + proof.evidence,
            accepted=proof.verified and response >= self.config.least_response,
            inliers=proof.inliers,
            verified=proof.verified,
            pixels=proof.pixels,
        )

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint; the vocabulary stays as it is."""
        return {
            "segmentation": self._segmentation.state(),
            "filter": self._filter.state(),
            "history": self._route.state(),
            "words": self._words.state(),
            "sequences": self._map.state(),
            "consistency": self._judge.state(),
            "decision": self._verdicts.state(),
            "open_horizons": list(self._open),
            "waiting": None if self._waiting is None else self._waiting.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another recogniser of this configuration and vocabulary."""
        self._segmentation.restore(state["segmentation"])
        self._filter.restore(state["filter"])
        self._route.restore(state["history"])
        self._words.restore(state["words"])
        self._map.restore(state["sequences"])
        self._judge.restore(state["consistency"])
        self._verdicts.restore(state["decision"])
        self._open = list(state["open_horizons"])
        self._waiting = None if state["waiting"] is None else _Sequence.from_state(state["waiting"])


def _best_of(rows: tuple[Floats, ...], count: int) -> Indices:
    """Columns, rising, that are among the first so many of at least one of the rows (S,), and above 0 there."""
    return np.unique(np.concatenate([_best(row, count) for row in rows]))


def _best(row: Floats, count: int) -> Indices:
    best = np.argpartition(-row, count)[:count] if len(row) > count else np.arange(len(row))
    return best[row[best] > 0].astype(np.int64)


def _spread(locations: Indices, likeness: Floats, count: int) -> list[int]:
    """So many of the locations (K,), the most alike first; of neighbours the better one, as they show the same.

    Images that are no more alike than any two, like those without features, are left out.
    """
    chosen: list[int] = []
    order = np.argsort(-likeness, kind="stable")
    for k in order[likeness[order] > 0]:
        location = int(locations[k])
        if location - 1 not in chosen and location + 1 not in chosen:
            chosen.append(location)
        if len(chosen) == count:
            break
    return chosen
