"""The decision of the published methods: their own threshold, geometric verification and a temporal gate, at once.

Nothing is shared between images but the gate: a match counts once it follows others on the same stretch of the map.
Thresholds: section 4.4 of the chapter and the papers named in each paradigm.
"""

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

from place_recognition.belief.candidate_verification import VerificationResult
from place_recognition.belief.smoothed_decision import stage_scores
from place_recognition.map.image_history import ImageHistory
from place_recognition.proposals import Proposals
from place_recognition.recognizer import Belief


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
    """Accepts the first candidate of each query if it passes every threshold (a Decision)."""

    def __init__(self, history: ImageHistory, config: PublishedDecisionConfig) -> None:
        self._history, self._config = history, config
        self._recent: deque[int | None] = deque(maxlen=config.min_consistent_frames)  # matches of the latest queries

    def add(self, proposals: Proposals, results: tuple[VerificationResult, ...]) -> list[Belief]:
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

    def state(self) -> list[int | None]:
        """The matches of the latest queries, for a checkpoint."""
        return list(self._recent)

    def restore(self, state: list[int | None]) -> None:
        """Continue from a state."""
        self._recent.extend(state)
