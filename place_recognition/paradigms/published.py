"""The published methods by name: every number of section 4.4 and of the papers in force, and nothing beside it.

What the papers leave open, and how it is filled here: docs/decisions/published_presets.md.
"""

import math
from collections import deque
from dataclasses import dataclass
from itertools import pairwise

from place_recognition.belief.decisions import Results, stage_scores
from place_recognition.belief.matrix_filter import DIAGONAL, LEARNED, FilterConfig
from place_recognition.map.image_history import ImageHistory
from place_recognition.map.place_map import PlaceSegmentationConfig
from place_recognition.map.sequence_map import FixedDistanceConfig, WordVarianceConfig
from place_recognition.paradigms.hierarchical_places import HierarchicalPlacesConfig
from place_recognition.paradigms.sequences import (
    DynamicSequencesConfig,
    SequenceHistogramsConfig,
    SequenceMatchingConfig,
)
from place_recognition.paradigms.tracked_words import TrackedWordsConfig
from place_recognition.paradigms.whole_images import PixelSequencesConfig
from place_recognition.recognizer import Belief, Proposals
from place_recognition.vocabulary.growing_neural_gas import GasConfig
from place_recognition.vocabulary.word_tracking import TrackConfig

_UNLIMITED = 1_000_000  # more images than a place has, more words than a sequence has


def sequence_histograms() -> SequenceHistogramsConfig:
    """Return the settings of IROS 2016: sequences of 5 m, the hand-made kernel, plain tf-idf vectors."""
    return SequenceHistogramsConfig(
        FixedDistanceConfig(distance_m=5.0), FilterConfig(DIAGONAL, 0.32), _sequence_matching()
    )


def dynamic_sequences() -> DynamicSequencesConfig:
    """Return the settings of IJRR 2018: sequences that end at a visual word variance of 0.75, the learnt kernel."""
    # Within a sequence the variance only falls, so it ends after one image or hardly ever: two images at least and
    # fifteen at most are guards that the paper does not state.
    sequences = WordVarianceConfig(min_variance=0.75, min_variance_ratio=0.0, min_images=2, max_images=15)
    return DynamicSequencesConfig(sequences, FilterConfig(LEARNED, 3.5), _sequence_matching())


def _sequence_matching() -> SequenceMatchingConfig:
    """Sequences and images by the L2 score of plain tf-idf vectors; the filter's response is the score.

    The score is the one in [0, 1]: with equation 4.6 as printed, no revisit would reach the learnt filter's 3.5.
    """
    return SequenceMatchingConfig(
        tf_power=1.0,
        max_query_words=_UNLIMITED,
        min_previous_score=0.005,
        max_sequences=1,
        max_similar_sequences=0,
        neighbor_sequences=0,
        image_score="l2",
        response_weight=math.inf,
        max_candidates=1,
    )


def hierarchical_places() -> HierarchicalPlacesConfig:
    """Return the numbers of ICRA 2018, Table II, and for the gas those of its authors' program.

    All 300 features vote, one place is searched, and places end by coherence alone.
    """
    return HierarchicalPlacesConfig(
        voting_features=300,
        max_places=1,
        neighbor_places=0,
        image_stride=1,
        ranking_features=300,
        max_candidates=1,
        distinct_votes=False,
        place=PlaceSegmentationConfig(max_images=_UNLIMITED),
        gas=GasConfig(winner_step_ratio=0.8, neighbor_step_ratio=0.01, max_edge_age=10),
    )


def tracked_words() -> TrackedWordsConfig:
    """Return the numbers of RA-L 2019, Table II: the location of most votes, older than twice the longest track."""
    tracks = TrackConfig(max_length_quantile=1.0)
    return TrackedWordsConfig(
        tracks=tracks, max_places=1, ranking="votes", distinct_votes=False, exclusion_track_lengths=2
    )


def pixel_sequences() -> PixelSequencesConfig:
    """Return the numbers of ICRA 2012: lines of 10 images at 0.8 to 1.2 of the speed."""
    return PixelSequencesConfig(speed_ratios=(0.8, 0.9, 1.0, 1.1, 1.2), max_candidates=1)


@dataclass(frozen=True)
class PublishedDecisionConfig:
    """Thresholds of a published method.

    Attributes:
        min_score: smallest score of the paradigm of an accepted match, on its own scale.
        min_exclusion_s: age below which no image is matched, seconds; 0 leaves it to the paradigm.
        min_inliers: smallest number of matches that agree with one fundamental matrix; 0 asks for no geometry.
        min_consistent_frames: number of successive images, the query included, whose matches must lie near one another;
            1 asks for no temporal consistency. beta in the paper of the hierarchical places.
        max_gap_frames: largest distance of the matches of two successive images that lie near one another.
    """

    min_score: float = 0.0
    min_exclusion_s: float = 40.0
    min_inliers: int = 12
    min_consistent_frames: int = 1
    max_gap_frames: int = 10


class PublishedDecision:
    """Accepts the first candidate of each query if it passes every threshold (a Decision).

    Nothing is shared between images but a temporal gate.
    """

    def __init__(self, history: ImageHistory, config: PublishedDecisionConfig) -> None:
        self._history, self._config = history, config
        self._recent: deque[int | None] = deque(maxlen=config.min_consistent_frames)  # matches of the latest queries

    def add(self, proposals: Proposals, results: Results) -> list[Belief]:
        """Add the candidates of the next query and return the belief about it."""
        query, stages = int(self._history.ids[proposals.query]), stage_scores(self._history, proposals, results)
        result = results[0] if results else None
        verified = result is not None and result.inliers >= self._config.min_inliers
        passes = verified and proposals.scores[0] >= self._config.min_score
        self._recent.append(result.location if passes and result is not None else None)
        if result is None or not verified:
            return [Belief(query, None, 0.0, accepted=False, verified=False, stages=stages)]
        belief = Belief(
            query=query,
            match=int(self._history.ids[result.location]),
            score=proposals.scores[0],
            accepted=self._is_consistent(),
            inliers=result.inliers,
            verified=verified,
            pixels=result.pixels,
            stages=stages,
        )
        return [belief]

    def _is_consistent(self) -> bool:
        """Whether the latest matches, that of the query included, all passed and lie near one another."""
        recent = [location for location in self._recent if location is not None]
        if len(recent) < self._config.min_consistent_frames:
            return False
        return all(abs(b - a) <= self._config.max_gap_frames for a, b in pairwise(recent))

    def finish(self) -> list[Belief]:
        """Return nothing: each query is answered at once."""
        return []

    def end_reference(self) -> None:
        """Forget the matches of the latest queries."""
        self._recent.clear()

    def state(self) -> list[int | None]:
        """The matches of the latest queries, for a checkpoint."""
        return list(self._recent)

    def restore(self, state: list[int | None]) -> None:
        """Continue from a state."""
        self._recent.extend(state)


# Thresholds of the decisions. P1 and P2: the threshold of the filter, 12 inliers (IROS 2016, Table III) and two
# successive images for the temporal consistency whose number the papers do not state. P3: sigma = 1e-12, tau = 12 and
# beta = 2. P4: delta = 2e-11 and phi = 9. The baselines have no geometry in their papers; their thresholds are the
# largest scores of unrelated images of simulated towns; that of SeqSLAM is the quotient 0.9 of OpenSeqSLAM's example.
DECISIONS: dict[str, PublishedDecisionConfig] = {
    "sequence-histograms": PublishedDecisionConfig(0.32, min_consistent_frames=2),
    "dynamic-sequences": PublishedDecisionConfig(3.5, min_consistent_frames=2),
    "hierarchical-places": PublishedDecisionConfig(12.0, min_consistent_frames=2),
    "tracked-words": PublishedDecisionConfig(-math.log10(2e-11), min_exclusion_s=0.0, min_inliers=9),
    "pixel-sequences": PublishedDecisionConfig(1.1, min_inliers=0),
    "global-descriptor": PublishedDecisionConfig(0.93, min_inliers=0),
    "seq-slam": PublishedDecisionConfig(0.1, min_inliers=0),
}

# Of random images, which have no score: geometry and the temporal gate of most methods.
CONTROL = PublishedDecisionConfig(min_consistent_frames=2)
