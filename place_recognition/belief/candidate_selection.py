"""Choice of the candidate images that are verified geometrically: the last step that all paradigms share.

Candidates come from the paradigm and from the prediction of where an earlier match has moved on to. Why each rule is
there: docs/decisions/candidate_verification.md.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from place_recognition.belief.candidate_verification import (
    CandidateVerificationConfig,
    ImagePairMatches,
    VerificationResult,
    match_images,
    rank_candidates,
)
from place_recognition.belief.temporal_consistency import ConsistencyConfig, TemporalConsistency
from place_recognition.map.feature_store import FeatureStore


class CandidateVerifier:
    """Verifies the best candidates of each query image geometrically."""

    def __init__(
        self, images: FeatureStore, verification: CandidateVerificationConfig, consistency: ConsistencyConfig
    ) -> None:
        self._images, self._config = images, verification
        self._consistency = TemporalConsistency(consistency)

    def verify(self, query: int, candidates: Iterable[int], last_matchable: int) -> tuple[VerificationResult, ...]:
        """Return the results of the verified candidates of a query; empty without candidates.

        Args:
            query: location of the query image, greater than the one before.
            candidates: locations that the paradigm proposes, best first.
            last_matchable: latest location that may be matched.
        """
        selected = self._select(query, list(candidates), last_matchable)
        pairs = (match_images(self._images, query, location, self._config) for location in selected)
        results = self._verify_in_order(pairs)
        if results:
            results = self._follow_neighbors(results, last_matchable)
            self._consistency.add(max(results, key=self._weight))
        return tuple(results)

    def _select(self, query: int, proposed: list[int], last_matchable: int) -> list[int]:
        """Locations with the most feature matches: one of the predicted ones, then those of the proposed ones."""
        predicted = [k for k in self._consistency.predict_locations(query) if 0 <= k <= last_matchable]
        # Predicted locations are adjacent and look alike, so one of them is enough; it needs no vote to be tried.
        first = rank_candidates(self._images, query, predicted, replace(self._config, max_verified=1))
        others = [k for k in proposed if k not in first]
        return first + rank_candidates(self._images, query, others, self._config)

    def _verify_in_order(self, pairs: Iterable[ImagePairMatches]) -> list[VerificationResult]:
        """Verify image pairs in order, up to the first one whose evidence makes the others needless."""
        results: list[VerificationResult] = []
        for pair in pairs:
            results.append(pair.verify(self._config.epipolar))
            if results[-1].evidence >= self._config.early_stop_evidence:
                break
        return results

    def _follow_neighbors(self, results: list[VerificationResult], last_matchable: int) -> list[VerificationResult]:
        """Verify the images beside the best result too, and move on to the neighbour while its evidence is greater.

        This is done only where the earlier results make the place certain. Near the end of a revisit the images
        show less and less of it, and the best match counts. Elsewhere, a search for the largest evidence would raise
        that of false matches as well.
        """
        best = max(results, key=self._weight)
        if best.evidence == 0.0 or not self._consistency.is_certain(best):
            return results
        by_location = {result.location: result for result in results}
        for _ in range(self._config.max_follow_steps):
            if best.evidence >= self._config.early_stop_evidence:
                break
            neighbor = self._best_neighbor(best, by_location, last_matchable)
            if neighbor.evidence <= best.evidence:
                break
            best = neighbor
        return list(by_location.values())

    def _best_neighbor(
        self, result: VerificationResult, by_location: dict[int, VerificationResult], last_matchable: int
    ) -> VerificationResult:
        """The result of more evidence of the two images beside a result, verified and added to `by_location` if new."""
        beside = [k for k in (result.location - 1, result.location + 1) if 0 <= k <= last_matchable]
        unseen = [k for k in beside if k not in by_location]
        pairs = [match_images(self._images, result.query, k, self._config) for k in unseen]
        by_location |= {new.location: new for new in self._verify_in_order(pairs)}
        neighbors = (by_location[k] for k in beside if k in by_location)
        return max(neighbors, key=lambda neighbor: neighbor.evidence, default=result)

    def _weight(self, result: VerificationResult) -> float:
        """Evidence of the image, plus that of earlier images, which counts up to the image's own evidence."""
        return result.evidence + min(self._consistency.sum_agreeing_evidence(result), result.evidence)

    def state(self) -> list[dict[str, Any]]:
        """The best results of the latest queries, for a checkpoint."""
        return self._consistency.state()

    def restore(self, state: list[dict[str, Any]]) -> None:
        """Continue from a state."""
        self._consistency.restore(state)
