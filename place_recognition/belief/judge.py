"""The proofs of a revisit: of the places proposed for an image, and of those expected, what geometry says of each."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from place_recognition.belief.proof import Pairing, Proof, ProofConfig, pair, rank
from place_recognition.belief.temporal_consistency import ConsistencyConfig, TemporalConsistency
from place_recognition.map.image_store import FeatureStore


class Judge:
    """Chooses among candidate images and those to which an earlier match has moved on: where all paradigms end."""

    def __init__(self, images: FeatureStore, proof: ProofConfig, consistency: ConsistencyConfig) -> None:
        self._images, self._proof = images, proof
        self._consistency = TemporalConsistency(consistency)

    def judge(self, query: int, candidates: Iterable[int], horizon: int) -> tuple[Proof, ...]:
        """What geometry says of the likeliest places of the image at location `query`; nothing without candidates.

        Args:
            query: later than the one before.
            candidates: locations that the paradigm proposes, best first.
            horizon: the latest location that may be matched.
        """
        chosen = self._chosen(query, list(candidates), horizon)
        proofs = self._proofs(pair(self._images, query, location, self._proof) for location in chosen)
        if proofs:
            proofs = self._followed(proofs, horizon)
            self._consistency.remember(max(proofs, key=self._weight))
        return tuple(proofs)

    def _chosen(self, query: int, proposed: list[int], horizon: int) -> list[int]:
        """The locations that match best: one of the expected ones, and of the proposed ones."""
        expected = [k for k in self._consistency.expected(query) if 0 <= k <= horizon]
        likely = rank(self._images, query, expected, replace(self._proof, tried=1))
        return likely + rank(self._images, query, [k for k in proposed if k not in likely], self._proof)

    def _proofs(self, pairings: Iterable[Pairing]) -> list[Proof]:
        """The proofs of the pairings, the likeliest first, up to one that leaves no doubt: each check costs time."""
        proofs: list[Proof] = []
        for pairing in pairings:
            proofs.append(pairing.check(self._proof.verification))
            if proofs[-1].evidence >= self._proof.plenty:
                break
        return proofs

    def _followed(self, proofs: list[Proof], horizon: int) -> list[Proof]:
        """The proofs, and those of the locations beside the likeliest one, on to the neighbour that says most.

        Only on a way that is certain: where it ends, images show less and less of it, and the best match counts. To
        search everywhere for what fits best by chance makes false matches surer as well.
        """
        likeliest = max(proofs, key=self._weight)
        if likeliest.evidence == 0.0 or not self._consistency.is_certain(likeliest):
            return proofs
        known = {proof.location: proof for proof in proofs}
        for _ in range(self._proof.followed):
            if likeliest.evidence >= self._proof.plenty:
                break
            beside = [k for k in (likeliest.location - 1, likeliest.location + 1) if 0 <= k <= horizon]
            new = [pair(self._images, likeliest.query, k, self._proof) for k in beside if k not in known]
            known |= {proof.location: proof for proof in self._proofs(new)}
            best = max((known[k] for k in beside if k in known), key=lambda proof: proof.evidence, default=likeliest)
            if best.evidence <= likeliest.evidence:
                break
            likeliest = best
        return list(known.values())

    def _weight(self, proof: Proof) -> float:
        """Evidence, and as much again at most by the way so far: it cannot speak where the image does not."""
        return proof.evidence + min(self._consistency.trail(proof), proof.evidence)

    def state(self) -> list[dict[str, Any]]:
        """The latest proofs, for a checkpoint."""
        return self._consistency.state()

    def restore(self, state: list[dict[str, Any]]) -> None:
        """Continue from a state."""
        self._consistency.restore(state)
