"""The decision of this project: what the paradigm and geometry say of each candidate, smoothed over the images around.

The answer for an image is the most likely location and its probability (`place_recognition.belief.place_filter`). The
pair is then verified by geometry once more if it was not among the candidates; without geometric agreement no match is
accepted, however likely the place.
"""

import math
from collections import deque
from typing import Any

import numpy as np

from place_recognition.belief.candidate_verification import (
    CandidateVerificationConfig,
    VerificationResult,
    verify_pair,
)
from place_recognition.belief.likelihood_ratios import GEOMETRY, RatioTable, sharpness
from place_recognition.belief.place_filter import Observation, PlaceFilter, PlaceFilterConfig, Posterior
from place_recognition.map.image_history import ImageHistory
from place_recognition.proposals import Proposals
from place_recognition.recognizer import Belief, StageScores

_MIN_FEATURES = 9  # an image with fewer shows no place, neither as a query nor as a match
_LIKELY = 0.5  # only pairs more likely than not are worth a verification of their own

Results = tuple[VerificationResult, ...]


class SmoothedDecision:
    """Turns verified candidates into beliefs with probabilities, `lag_frames` images late (a Decision)."""

    def __init__(
        self,
        history: ImageHistory,
        own_ratio: RatioTable,
        config: PlaceFilterConfig,
        verification: CandidateVerificationConfig,
    ) -> None:
        self._history, self._own_ratio, self._config = history, own_ratio, config
        self._verification = verification
        self._filter = PlaceFilter(config)
        self._waiting: deque[tuple[Proposals, Results]] = deque()

    def add(self, proposals: Proposals, results: Results) -> list[Belief]:
        """Add the candidates of the next query and return the belief that is ready now, if any."""
        self._waiting.append((proposals, results))
        return self._answer(self._filter.add(self._observe(proposals, results)))

    def finish(self) -> list[Belief]:
        """Return the beliefs about the last queries."""
        return self._answer(self._filter.finish())

    def _observe(self, proposals: Proposals, results: Results) -> Observation:
        own = dict(zip(proposals.locations, self._own_ratio(proposals.scores), strict=True))
        evidence = np.array([result.evidence for result in results], np.float64)
        # The image beside a candidate, which geometry prefers, has the score of the candidate next to it.
        ratios = [own[min(own, key=lambda k: abs(k - result.location))] for result in results]
        locations = np.array([result.location for result in results], np.int64)
        return Observation(locations, GEOMETRY(evidence) + np.array(ratios), sharpness(evidence))

    def _answer(self, posteriors: list[Posterior]) -> list[Belief]:
        return [self._make_belief(*self._waiting.popleft(), posterior) for posterior in posteriors]

    def _make_belief(self, proposals: Proposals, results: Results, posterior: Posterior) -> Belief:
        stages = stage_scores(self._history, proposals, results)
        query = int(self._history.ids[proposals.query])
        location = self._match(proposals, posterior)
        if location is None:
            return Belief(query, None, posterior.log_odds, accepted=False, probability=0.0, stages=stages)
        result = self._result(proposals.query, location, results, posterior.probability)
        verified = result is not None and result.evidence >= min_evidence(proposals.query, self._verification)
        return Belief(
            query=query,
            match=int(self._history.ids[location]),
            score=posterior.log_odds,
            accepted=verified and posterior.probability >= self._config.min_probability,
            inliers=None if result is None else result.inliers,
            verified=verified,
            **({} if result is None else {"pixels": result.pixels}),
            probability=posterior.probability,
            stages=stages,
        )

    def _match(self, proposals: Proposals, posterior: Posterior) -> int | None:
        """The location of the posterior, or the nearest one beside it that shows something; None for a blank query."""
        if posterior.location is None or not self._is_textured(proposals.query):
            return None
        beside = [posterior.location + step for step in (0, -1, 1, -2, 2)]
        allowed = (k for k in beside if 0 <= k <= proposals.last_matchable and self._is_textured(k))
        return next(allowed, None)

    def _result(self, query: int, location: int, results: Results, probability: float) -> VerificationResult | None:
        known = next((result for result in results if result.location == location), None)
        if known is not None or probability < _LIKELY:
            return known
        return verify_pair(self._history.images, query, location, self._verification)

    def _is_textured(self, location: int) -> bool:
        return self._history.images.count(location) >= _MIN_FEATURES

    def state(self) -> dict[str, Any]:
        """Everything that waits for later images, for a checkpoint."""
        waiting = [
            {"proposals": dict(vars(proposals)), "results": [dict(vars(result)) for result in results]}
            for proposals, results in self._waiting
        ]
        return {"filter": self._filter.state(), "waiting": waiting}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._filter.restore(state["filter"])
        for one in state["waiting"]:
            results = tuple(VerificationResult(**result) for result in one["results"])
            self._waiting.append((Proposals(**one["proposals"]), results))


def min_evidence(query: int, config: CandidateVerificationConfig) -> float:
    """Evidence from which a pair counts as verified: less than one chance match among all tests of the drive so far."""
    return math.log10(config.max_candidates * (query + 1))


def stage_scores(history: ImageHistory, proposals: Proposals, results: Results) -> StageScores:
    """What the paradigm and geometry answer by themselves, with the ids of the images."""
    ids = history.ids
    best = max(results, key=lambda result: result.evidence, default=None)
    if best is None or best.inliers == 0:
        best = None
    return StageScores(
        candidates=tuple(int(ids[location]) for location in proposals.locations),
        own_score=proposals.scores[0] if proposals.scores else None,
        geometry_match=None if best is None else int(ids[best.location]),
        geometry_score=None if best is None else best.evidence,
    )
