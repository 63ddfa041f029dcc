"""Temporal consistency: a revisit lasts, and its matches advance along the earlier pass as its queries do."""

from collections import deque
from dataclasses import dataclass

from place_recognition.belief.proof import Proof


@dataclass(frozen=True)
class ConsistencyConfig:
    """Which earlier proofs speak for a new one.

    Attributes:
        memory: queries before this one whose proofs count for how sure it is: short, so that the first images of a
            revisit are not worth less than the last ones of a look-alike street.
        trail: queries before this one whose proofs count for which of several places it is: long, so that a known way
            is not left for a look-alike seen in better light.
        speed: images that the match may move for each image of the query, forwards or backwards: the passes may be
            driven at different speeds and directions.
        slack: images that it may be off besides.
    """

    memory: int = 2
    trail: int = 10
    speed: float = 3.0
    slack: int = 2


class TemporalConsistency:
    """Remembers the proofs of the latest queries and adds up those that agree with a new one.

    Evidence of different images adds up like the logarithm of probabilities. Proofs come in the order of queries.
    """

    def __init__(self, config: ConsistencyConfig | None = None) -> None:
        self.config = config or ConsistencyConfig()
        self._recent: deque[Proof] = deque(maxlen=max(self.config.trail, self.config.memory))

    def remember(self, proof: Proof) -> None:
        """Let a proof speak for later ones."""
        self._recent.append(proof)

    def support(self, proof: Proof) -> float:
        """Evidence of the proofs just before that agree with this one, in powers of ten: how sure it is."""
        return self._agreeing(proof, self.config.memory)

    def trail(self, proof: Proof) -> float:
        """The same of more proofs, for the choice between places."""
        return self._agreeing(proof, self.config.trail)

    def expected(self, query: int) -> list[int]:
        """Locations to which the latest verified match has moved on if the revisit lasts; the likeliest first."""
        latest = next((proof for proof in reversed(self._recent) if proof.verified), None)
        if latest is None or query - latest.query > self.config.trail:
            return []
        centre = latest.location + self._step(latest) * (query - latest.query)
        return [centre + offset for offset in sorted(range(-2, 3), key=abs)]

    def _step(self, latest: Proof) -> int:
        """Images by which the match moves for each query: 1, or -1 where the way is driven backwards."""
        first = next(proof for proof in self._recent if proof.verified)
        return -1 if latest.location < first.location and self._agree(first, latest) else 1

    def _agreeing(self, proof: Proof, memory: int) -> float:
        recent = (earlier for earlier in self._recent if proof.query - earlier.query <= memory)
        return sum(earlier.evidence for earlier in recent if self._agree(earlier, proof))

    def _agree(self, earlier: Proof, proof: Proof) -> bool:
        reach = self.config.speed * (proof.query - earlier.query) + self.config.slack
        return abs(proof.location - earlier.location) <= reach
