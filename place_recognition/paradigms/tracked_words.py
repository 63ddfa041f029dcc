"""Place recognition by a bag of tracked words: a vocabulary learnt online, votes, and a binomial test.

Tsintotas, Bampis, Gasteratos, 'Probabilistic Appearance-Based Place Recognition Through Bag of Tracked Words',
RA-L 4(2) 2019. Deviations from the paper (reasons: docs/decisions/tracked_words.md):
* Several voted locations are tried, and around each the image that matches best is sought.
* The search area also keeps a distance and a number of images from the query, and not the longest track counts but
  nearly the longest (`FeatureTracks`).
* Each word votes once (`count_votes`).
* Where tracks are short, the best of them become words too (`TrackConfig`).
* Geometry decides what is accepted, not the votes.
* The evidence of geometry, of this image and of those around it, is added to the score.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.belief.candidate_selection import CandidateVerifier
from place_recognition.belief.candidate_verification import CandidateVerificationConfig, VerificationResult
from place_recognition.belief.geometric_verification import EpipolarConfig
from place_recognition.belief.sequence_consensus import CandidateBeliefs, DelayedDecision, SequenceConsensusConfig
from place_recognition.belief.temporal_consistency import ConsistencyConfig
from place_recognition.belief.voting import Votes, count_votes
from place_recognition.image_processing.local_features import FeatureCache, check_gray
from place_recognition.map.image_history import ImageHistory, ImageHistoryConfig
from place_recognition.recognizer import Belief, MatrixSink, NullMatrixSink
from place_recognition.vocabulary.word_index import WordIndex
from place_recognition.vocabulary.word_tracking import FeatureTracks, TrackConfig, WordMap
from place_recognition.vocabulary.word_tree import HybridWordIndex


@dataclass(frozen=True)
class TrackedWordsConfig:
    """Settings of the paradigm: the paper's numbers and those of the deviations.

    Attributes:
        max_probability: probability by chance below which the votes of a location are significant (delta in the paper).
        tracks: how tracked features become words.
        history: which features are kept of each image, and which images may be matched.
        verification: how candidates are verified geometrically.
        consistency: which earlier results support a new one.
        consensus: the delayed decision.
        neighbor_radius: number of images before and after a voted location that are candidates too.
        max_places: number of voted locations that are tried; the paper tries the one with the most votes only.
    """

    max_probability: float = 2e-11
    tracks: TrackConfig = field(default_factory=TrackConfig)
    history: ImageHistoryConfig = field(default_factory=ImageHistoryConfig)
    verification: CandidateVerificationConfig = field(
        default_factory=lambda: CandidateVerificationConfig(epipolar=EpipolarConfig(min_inliers=9))
    )
    consistency: ConsistencyConfig = field(default_factory=ConsistencyConfig)
    consensus: SequenceConsensusConfig = field(default_factory=SequenceConsensusConfig)
    neighbor_radius: int = 6
    max_places: int = 3

    @classmethod
    def published(cls) -> "TrackedWordsConfig":
        """Return the paper's numbers (Table II): one location is tried, and 9 inliers are enough."""
        verification = CandidateVerificationConfig(epipolar=EpipolarConfig(min_inliers=9))
        consensus = SequenceConsensusConfig.disabled()
        return cls(neighbor_radius=0, max_places=1, verification=verification, consensus=consensus)


class TrackedWords:
    """Recognises places by visual words that it learns online from tracked features (a PlaceRecognizer).

    Beliefs are returned some images late (`DelayedDecision`).
    """

    def __init__(
        self,
        features: FeatureCache,
        config: TrackedWordsConfig | None = None,
        rows: MatrixSink | None = None,
        index: Callable[[], WordIndex] = HybridWordIndex,
    ) -> None:
        """Make a recogniser that has seen nothing.

        Args:
            features: local features, shared with other users of the same images.
            config: settings; the defaults if None.
            rows: receives the rows of the similarity matrix.
            index: makes the index in which all words are stored and searched.
        """
        self.config = config or TrackedWordsConfig()
        self._features = features
        self._tracks = FeatureTracks(self.config.tracks)
        self._history = ImageHistory(self.config.history)
        self._words = WordMap(index())
        self._verifier = CandidateVerifier(self._history.images, self.config.verification, self.config.consistency)
        self._decision = DelayedDecision(self._history, self.config.consensus)
        self._rows = NullMatrixSink() if rows is None else rows

    @property
    def word_count(self) -> int:
        """Number of words in the map so far."""
        return len(self._words)

    def observe(self, image_id: int, image: NDArray[np.uint8], distance_travelled_m: float) -> list[Belief]:
        """Add an image and return the beliefs that are ready now.

        Args:
            image_id: greater than the one before.
            image: (H, W) uint8, grey. After a change of size all tracks start anew.
            distance_travelled_m: length of the path so far, metres; NaN, or always the same, where it is not measured.
        """
        check_gray(image)
        features = self._features.get(image_id, image)
        self._history.add(image_id, features, distance_travelled_m)
        self._words.add(self._tracks.advance(image, features))
        return self._decision.add(self._match())

    def finish(self) -> list[Belief]:
        """Return the beliefs about the last images."""
        return self._decision.finish()

    def _match(self) -> CandidateBeliefs:
        """Match the latest image with the best candidates around the voted locations."""
        last_matchable = self._last_matchable()
        self._words.activate_until(last_matchable)  # words of later images are not hit yet
        votes = count_votes(self._words.lookup(self._tracks.descriptors), self._words)
        query = int(self._history.ids[-1])
        self._rows.add(query, self._history.ids[votes.locations], votes.votes.astype(np.float64))
        # Neighbouring images share most of their words: one location of a neighbourhood is enough.
        voted = votes.top_locations(
            self.config.max_places, self.config.neighbor_radius, math.log(self.config.max_probability)
        )
        results = self._verifier.verify(self._history.latest, self._neighbors(voted, last_matchable), last_matchable)
        return CandidateBeliefs.from_results(query, results, lambda result: self._make_belief(query, result, votes))

    def _last_matchable(self) -> int:
        """The latest location that is far enough behind and of which no feature is still tracked.

        Where the distance is not measured, only the view shows whether the camera has moved on.
        """
        behind = (
            self._history.last_outside_exclusion()
            if self._history.is_distance_measured
            else self._history.last_matchable()
        )
        return min(behind, self._history.latest - 2 * self._tracks.max_length_frames)

    def _make_belief(self, query: int, result: VerificationResult, votes: Votes) -> Belief:
        vote_evidence = votes.neg_log10_probability(result.location, self.config.neighbor_radius)
        return Belief(
            query=query,
            match=int(self._history.ids[result.location]),
            score=vote_evidence + result.evidence,
            accepted=result.verified,
            inliers=result.inliers,
            verified=result.verified,
            pixels=result.pixels,
        )

    def _neighbors(self, voted: list[int], last_matchable: int) -> list[int]:
        """The voted locations and those around them that may be matched, the nearest to a voted one first."""
        offsets = sorted(range(-self.config.neighbor_radius, self.config.neighbor_radius + 1), key=abs)
        near = dict.fromkeys(location + offset for offset in offsets for location in voted)
        return [location for location in near if 0 <= location <= last_matchable]

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {
            "tracks": self._tracks.state(),
            "history": self._history.state(),
            "words": self._words.state(),
            "consistency": self._verifier.state(),
            "decision": self._decision.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another recogniser of this configuration."""
        self._tracks.restore(state["tracks"])
        self._history.restore(state["history"])
        self._words.restore(state["words"])
        self._verifier.restore(state["consistency"])
        self._decision.restore(state["decision"])
