"""The last word on a revisit: of the places proposed for an image the one that geometry and the way so far bear out."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from place_recognition.belief.proof import Pairing, Proof, ProofConfig, pair, rank
from place_recognition.belief.temporal_consistency import ConsistencyConfig, TemporalConsistency
from place_recognition.map.image_store import ImageStore


@dataclass(frozen=True)
class Judgement:
    """The best place for an image.

    Attributes:
        proof: what geometry says of it.
        support: what the proofs of the images just before say of it, powers of ten.
        sure: whether all that is enough to act upon.
    """

    proof: Proof
    support: float
    sure: bool

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
        chosen = self._chosen(query, list(candidates), horizon)
        if not chosen:
            return None
        best = self._best(pair(self._images, query, location, self._proof) for location in chosen)
        support = self._consistency.support(best) if best.verified else 0.0
        self._consistency.remember(best)
        return Judgement(best, support, best.verified and best.evidence + support >= self._proof.sure)

    def _chosen(self, query: int, proposed: list[int], horizon: int) -> list[int]:
        """The locations that match best: one of the expected ones, and of the proposed ones."""
        expected = [k for k in self._consistency.expected(query) if 0 <= k <= horizon]
        likely = rank(self._images, query, expected, replace(self._proof, tried=1))
        return likely + rank(self._images, query, [k for k in proposed if k not in likely], self._proof)

    def _best(self, pairings: Iterable[Pairing]) -> Proof:
        """The place whose proof weighs most, and of its images that with the most inliers.

        Evidence tells places apart, but hardly two images of one place a few metres apart; inliers do.
        """
        proofs = self._proofs(pairings)
        best = max(proofs, key=self._weight)
        beside = [proof for proof in proofs if abs(proof.location - best.location) <= self._proof.beside]
        nearest = max(beside, key=lambda proof: proof.inliers)
        return replace(nearest, evidence=best.evidence * self._nearness(nearest))

    def _proofs(self, pairings: Iterable[Pairing]) -> list[Proof]:
        """The proofs of the pairings, the likeliest first, up to one that leaves no doubt: each check costs time."""
        proofs: list[Proof] = []
        for pairing in pairings:
            proofs.append(pairing.check(self._proof.verification))
            if proofs[-1].evidence >= self._proof.plenty:
                break
        return proofs

    def _nearness(self, proof: Proof) -> float:
        """1 where both images show things at about one size, less where the cameras must have stood far apart."""
        return min(1.0, (self._proof.same_size / max(abs(proof.zoom), 1e-9)) ** 2)

    def _weight(self, proof: Proof) -> float:
        """Evidence, and as much again at most by the way so far: it cannot speak where the image does not."""
        return proof.evidence + min(self._consistency.trail(proof), proof.evidence)
