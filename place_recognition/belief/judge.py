"""The last word on a revisit: of the places proposed for an image the one that geometry and the way so far bear out."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from place_recognition.belief.proof import Proof, ProofConfig, prove
from place_recognition.belief.temporal_consistency import ConsistencyConfig, TemporalConsistency
from place_recognition.map.image_store import ImageStore


@dataclass(frozen=True)
class Judgement:
    """The best place for an image.

    Attributes:
        proof: what geometry says of it.
        support: what the proofs of the images just before say of it, powers of ten.
    """

    proof: Proof
    support: float

    @property
    def evidence(self) -> float:
        """All evidence, in powers of ten by which it is unlikely to be chance."""
        return self.proof.evidence + self.support


class Judge:
    """Chooses among candidate images and those to which an earlier match has moved on: where all paradigms end."""

    def __init__(self, images: ImageStore, proof: ProofConfig, consistency: ConsistencyConfig) -> None:
        self._images, self._proof = images, proof
        self._consistency = TemporalConsistency(consistency)

    def judge(self, query: int, candidates: Iterable[int], horizon: int) -> Judgement | None:
        """The best place for the image at location `query`; None without candidates.

        Args:
            query: later than the one before.
            candidates: locations that the paradigm proposes, best first.
            horizon: the latest location that may be matched.
        """
        proposed = list(candidates)
        expected = [k for k in self._consistency.expected(query) if 0 <= k <= horizon and k not in proposed]
        proofs = prove(self._images, query, proposed, self._proof)
        proofs += prove(self._images, query, expected, replace(self._proof, tried=1))
        if not proofs:
            return None
        best = max(proofs, key=lambda proof: proof.evidence + self._consistency.trail(proof) * proof.verified)
        judgement = Judgement(best, self._consistency.support(best) if best.verified else 0.0)
        self._consistency.remember(best)
        return judgement
