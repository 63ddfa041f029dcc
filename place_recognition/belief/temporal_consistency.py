"""Temporal consistency: a revisit lasts, and its matches advance along the earlier pass as its queries do.

Why the settings are what they are: docs/decisions/candidate_verification.md.
"""

from collections import deque
from dataclasses import dataclass
from typing import Any

from place_recognition.belief.proof import VerificationResult


@dataclass(frozen=True)
class ConsistencyConfig:
    """Which earlier results support a new one.

    Attributes:
        history: number of images before the query whose results count. It is long, so that a place is not exchanged
            for a look-alike that is seen in better light.
        max_speed_ratio: images by which the match may move for each image of the query, forwards or backwards: the two
            passes may be driven at different speeds and in different directions.
        tolerance: images by which the match may be off besides.
        search_radius: images before and after the predicted match that are candidates too.
        certain_evidence: sum of the agreeing evidence, in powers of ten, from which the place is taken for certain:
            twice what is enough for a match (`SequenceConsensusConfig.min_total_evidence`).
    """

    history: int = 10
    max_speed_ratio: float = 3.0
    tolerance: int = 2
    search_radius: int = 4
    certain_evidence: float = 200.0


class TemporalConsistency:
    """Keeps the best results of the latest queries, predicts the next match, and sums the evidence that agrees.

    The evidence of different images is summed like logarithms of probabilities. Results come in the order of queries.
    """

    def __init__(self, config: ConsistencyConfig | None = None) -> None:
        self.config = config or ConsistencyConfig()
        self._recent: deque[VerificationResult] = deque(maxlen=self.config.history)

    def add(self, result: VerificationResult) -> None:
        """Add the best result of the latest query."""
        self._recent.append(result)

    def sum_agreeing_evidence(self, result: VerificationResult) -> float:
        """Sum the evidence, in powers of ten, of the earlier results that agree with this one."""
        recent = (earlier for earlier in self._recent if result.query - earlier.query <= self.config.history)
        return sum(earlier.evidence for earlier in recent if self._agree(earlier, result))

    def predict_locations(self, query: int) -> list[int]:
        """Predict the locations that match a query if the revisit goes on, the likeliest first.

        The prediction starts at the recent result of the most evidence. The very latest one would be worse: an image
        with little evidence may have been matched with a look-alike.
        """
        recent = [past for past in self._recent if past.verified and query - past.query <= self.config.history]
        if not recent:
            return []
        best = max(recent, key=lambda result: result.evidence)
        center = best.location + self._direction(best) * (query - best.query)
        radius = self.config.search_radius
        return [center + offset for offset in sorted(range(-radius, radius + 1), key=abs)]

    def is_certain(self, result: VerificationResult) -> bool:
        """Whether the earlier results that agree with this one leave no doubt of the place."""
        return self.sum_agreeing_evidence(result) >= self.config.certain_evidence

    def _direction(self, best: VerificationResult) -> int:
        """Images by which the match moves for each query: 1, or -1 where the earlier pass is driven backwards."""
        first = next(result for result in self._recent if result.verified)
        return -1 if best.location < first.location and self._agree(first, best) else 1

    def _agree(self, earlier: VerificationResult, result: VerificationResult) -> bool:
        reach = self.config.max_speed_ratio * (result.query - earlier.query) + self.config.tolerance
        return abs(result.location - earlier.location) <= reach

    def state(self) -> list[dict[str, Any]]:
        """The latest proofs, for a checkpoint."""
        return [dict(vars(proof)) for proof in self._recent]

    def restore(self, state: list[dict[str, Any]]) -> None:
        """Continue from a state."""
        self._recent = deque((VerificationResult(**proof) for proof in state), maxlen=self._recent.maxlen)
