"""Temporal consistency: a revisit lasts, and its matches advance along the earlier pass as its queries do."""

from collections import deque
from dataclasses import dataclass

from place_recognition.belief.proof import Proof


@dataclass(frozen=True)
class ConsistencyConfig:
    """Which earlier proofs speak for a new one.

    Attributes:
        memory: queries before this one whose proofs count.
        speed: images that the match may move for each image of the query, forwards or backwards: the passes may be
            driven at different speeds and directions.
        slack: images that it may be off besides.
    """

    memory: int = 2
    speed: float = 3.0
    slack: int = 2


class TemporalConsistency:
    """Remembers the proofs of the latest queries and adds up those that agree."""

    def __init__(self, config: ConsistencyConfig | None = None) -> None:
        self.config = config or ConsistencyConfig()
        self._recent: deque[Proof] = deque(maxlen=self.config.memory)

    def support(self, proof: Proof) -> float:
        """Evidence of the remembered proofs that agree with this one, in powers of ten; then remember it too.

        Evidence of different images adds up like the logarithm of probabilities. Proofs come in the order of queries.
        """
        support = sum(earlier.evidence for earlier in self._recent if self._agree(earlier, proof))
        self._recent.append(proof)
        return support

    def _agree(self, earlier: Proof, proof: Proof) -> bool:
        passed = proof.query - earlier.query
        reach = self.config.speed * passed + self.config.slack
        return passed <= self.config.memory and abs(proof.location - earlier.location) <= reach
