"""Place recognition by places with visual words of their own: first the place is found, then the image in it.

Tsintotas, Bampis, Gasteratos, 'Assigning Visual Words to Places for Loop Closure Detection', ICRA 2018; section 4.4.3
of the chapter. Deviations from the paper (reasons and figures: docs/decisions/hierarchical_places.md):
* Several of the likeliest places are searched, and the places beside the best one.
* The best image of a place is the one with the most mutual matches, not the one with the most nearest descriptors. It
  is sought among every third image; the neighbours of the best ones are candidates too.
* The candidates go to the verification that all paradigms share. It adds temporal consistency, which the paper
  describes and its program leaves out, and its evidence is added to the score.
* Each word votes once (`vote_for_places`); the last place ends with the recording.
* Images of the present view are excluded, not those of the last 40 s.
* Geometry decides what is accepted, not the votes.
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
from place_recognition.belief.voting import PlaceVotes, vote_for_places
from place_recognition.image_processing.local_features import FeatureCache, check_gray
from place_recognition.image_processing.matching import count_matches
from place_recognition.map.image_history import ImageHistory, ImageHistoryConfig
from place_recognition.map.place_map import PlaceMap, PlaceSegmentation, PlaceSegmentationConfig
from place_recognition.recognizer import Belief, MatrixSink, NullMatrixSink
from place_recognition.vocabulary.growing_neural_gas import GasConfig, grow_gas
from place_recognition.vocabulary.word_index import WordIndex
from place_recognition.vocabulary.word_tree import HybridWordIndex

Floats = NDArray[np.float32]

UNLIMITED = 1_000_000  # more images than a place has


@dataclass(frozen=True)
class HierarchicalPlacesConfig:
    """Settings of the paradigm: the paper's numbers and those of the deviations.

    Attributes:
        max_probability: largest probability by chance of the votes of a revisited place (sigma in the paper); 1 accepts
            any votes.
        word_features: number of strongest features of an image that make words (nu in the paper).
        voting_features: number of strongest features of an image that vote; half of the paper's.
        max_places: number of likeliest places that are searched, besides the two beside the best one.
        image_stride: every `image_stride`-th image of a place is compared with the query.
        ranking_features: number of strongest features of each image used for this comparison.
        ranking_ratio: largest ratio of nearest to second nearest descriptor distance of its matches.
        max_candidates: number of best images that become candidates.
        neighbor_radius: number of images before and after each of them that become candidates too.
        seed: seed of the order in which the growing neural gas sees the descriptors.
        place: when a place ends.
        gas: growing neural gas, which makes the words of a place.
        history: which features are kept of each image, and which images may be matched.
        verification: how candidates are verified geometrically.
        consistency: which earlier results support a new one.
        consensus: the delayed decision.
    """

    max_probability: float = 1.0
    word_features: int = 300
    voting_features: int = 150
    max_places: int = 5
    image_stride: int = 3
    ranking_features: int = 150
    ranking_ratio: float = 0.8
    max_candidates: int = 6
    neighbor_radius: int = 2
    seed: int = 0
    place: PlaceSegmentationConfig = field(default_factory=PlaceSegmentationConfig)
    gas: GasConfig = field(default_factory=GasConfig)
    history: ImageHistoryConfig = field(default_factory=ImageHistoryConfig)
    verification: CandidateVerificationConfig = field(
        default_factory=lambda: CandidateVerificationConfig(epipolar=EpipolarConfig(min_inliers=12))
    )
    consistency: ConsistencyConfig = field(default_factory=ConsistencyConfig)
    consensus: SequenceConsensusConfig = field(default_factory=SequenceConsensusConfig)

    @classmethod
    def published(cls) -> "HierarchicalPlacesConfig":
        """Return the numbers of the paper's Table II and, for the gas, of its authors' program.

        All 300 features vote, one place is searched, places end by coherence alone, and votes alone decide. The paper's
        40 s are left to the exclusion window, which counts images.
        """
        return cls(
            voting_features=300,
            max_places=1,
            image_stride=1,
            ranking_features=300,
            max_candidates=1,
            neighbor_radius=0,
            max_probability=1e-12,
            consensus=SequenceConsensusConfig.disabled(),
            verification=CandidateVerificationConfig(epipolar=EpipolarConfig(min_inliers=12)),
            place=PlaceSegmentationConfig(max_images=UNLIMITED),
            gas=GasConfig(winner_step_ratio=0.8, neighbor_step_ratio=0.01, max_edge_age=10),
        )


class HierarchicalPlaces:
    """Recognises places by the visual words that each has of its own (a PlaceRecognizer).

    Beliefs are returned some images late (`DelayedDecision`).
    """

    def __init__(
        self,
        features: FeatureCache,
        config: HierarchicalPlacesConfig | None = None,
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
        self.config = config or HierarchicalPlacesConfig()
        self._features = features
        self._history = ImageHistory(self.config.history)
        self._open = PlaceSegmentation(self.config.place)
        self._places = PlaceMap(index())
        self._verifier = CandidateVerifier(self._history.images, self.config.verification, self.config.consistency)
        self._decision = DelayedDecision(self._history, self.config.consensus)
        self._rows = NullMatrixSink() if rows is None else rows

    @property
    def word_count(self) -> int:
        """Number of words in the map so far."""
        return self._places.word_count

    def observe(self, image_id: int, image: NDArray[np.uint8], distance_travelled_m: float) -> list[Belief]:
        """Add an image and return the beliefs that are ready now.

        Args:
            image_id: greater than the one before.
            image: (H, W) uint8, grey.
            distance_travelled_m: length of the path so far, metres; NaN, or always the same, where it is not measured.
        """
        check_gray(image)
        features = self._features.get(image_id, image)
        self._history.add(image_id, features, distance_travelled_m)
        descriptors = features.descriptors[: self.config.word_features]
        self._learn(self._open.add(descriptors), self._history.latest - 1)
        if len(descriptors) < self.config.place.min_features:
            # A nearly blank image cannot be matched.
            return self._decision.add(CandidateBeliefs.without_match(image_id))
        return self._decision.add(self._match(descriptors[: self.config.voting_features]))

    def finish(self) -> list[Belief]:
        """End the last place and return the beliefs about the last images."""
        self._learn(self._open.flush(), self._history.latest)
        return self._decision.finish()

    def _learn(self, ended: list[Floats], last: int) -> None:
        """Make the words of a place that has ended at location `last` from its descriptors; nothing if none ended."""
        if ended:
            # A generator of its own for each place: its words do not depend on how many numbers others have drawn.
            rng = np.random.default_rng((self.config.seed, len(self._places)))
            self._places.add(grow_gas(np.concatenate(ended), rng, self.config.gas).nodes, last)

    def _match(self, descriptors: Floats) -> CandidateBeliefs:
        """Match the latest image, whose strongest descriptors (N, D) vote, with the images of the likeliest places."""
        last_matchable = self._history.last_matchable()
        count = self._places.activate_until(last_matchable)  # places that hold a later image get no votes
        votes = vote_for_places(self._places.nearest_words(descriptors), self._places, count)
        self._record(votes)
        results = self._verifier.verify(self._history.latest, self._propose(votes, count), last_matchable)
        query = int(self._history.ids[-1])
        return CandidateBeliefs.from_results(query, results, lambda result: self._make_belief(result, votes))

    def _make_belief(self, result: VerificationResult, votes: PlaceVotes) -> Belief:
        vote_evidence = votes.neg_log10_probability(self._places.place_of(result.location))
        return Belief(
            query=int(self._history.ids[-1]),
            match=int(self._history.ids[result.location]),
            score=vote_evidence + result.evidence,
            accepted=result.verified and vote_evidence >= -math.log10(self.config.max_probability),
            inliers=result.inliers,
            verified=result.verified,
            pixels=result.pixels,
        )

    def _propose(self, votes: PlaceVotes, count: int) -> list[int]:
        """Candidate locations in the likeliest of the first `count` places: the best images, then neighbours."""
        if len(votes.places) == 0:
            return []
        locations = self._sample_images(votes, count)
        images, features = self._history.images, self.config.ranking_features
        query = images[self._history.latest].strongest(features).quantized
        matches = count_matches(query, *images.strongest(locations, features), self.config.ranking_ratio)
        best = [locations[k] for k in np.argsort(-matches, kind="stable")[: self.config.max_candidates]]
        last = self._places.images(count - 1)[-1]
        offsets = sorted(range(-self.config.neighbor_radius, self.config.neighbor_radius + 1), key=abs)
        near = [k for offset in offsets for k in (location + offset for location in best)]
        return list(dict.fromkeys(k for k in near if 0 <= k <= last))

    def _sample_images(self, votes: PlaceVotes, count: int) -> list[int]:
        """Every `image_stride`-th location of the likeliest places and of the two places beside the best one."""
        best, stride = int(votes.places[0]), self.config.image_stride
        # Near its ends a place and its neighbour look alike.
        beside = [place for place in (best - 1, best + 1) if 0 <= place < count]
        places = dict.fromkeys([*votes.places[: self.config.max_places].tolist(), *beside])
        spans = [self._places.images(place) for place in places]
        # From the middle of the first stride on: the ends of a place look like the places beside it.
        return [location for span in spans for location in span[min(stride, len(span)) // 2 :: stride]]

    def _record(self, votes: PlaceVotes) -> None:
        """Hand the votes of each place to the matrix sink, for all images of the place."""
        spans = [self._places.images(int(place)) for place in votes.places]
        locations = np.array([location for span in spans for location in span], np.int64)
        values = np.repeat(votes.votes.astype(np.float64), [len(span) for span in spans])
        self._rows.add(int(self._history.ids[-1]), self._history.ids[locations], values)

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {
            "history": self._history.state(),
            "open_place": self._open.state(),
            "places": self._places.state(),
            "consistency": self._verifier.state(),
            "decision": self._decision.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another recogniser of this configuration."""
        self._history.restore(state["history"])
        self._open.restore(state["open_place"])
        self._places.restore(state["places"])
        self._verifier.restore(state["consistency"])
        self._decision.restore(state["decision"])
