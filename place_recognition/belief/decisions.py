"""From verified candidates to beliefs: a decision that is smoothed over the images around.

What the paradigm and geometry say of each candidate is smoothed over the images around: the answer for an image is the
most likely place and its probability (`place_recognition.belief.place_filter`). The pair is then verified by geometry
once more if it was not among the candidates; without geometric agreement no match is accepted, however likely the
place. The published methods have another decision (`place_recognition.paradigms.published`).
"""

import math
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.belief.likelihood_ratios import (
    RatioTable,
    RatioWeights,
    log_ratios,
    log_ratios_elsewhere,
    sharpness,
)
from place_recognition.belief.place_filter import Observation, PlaceFilter, PlaceFilterConfig, PlacePosterior
from place_recognition.map.image_history import ImageHistory
from place_recognition.recognizer import Belief, Proposals, StageScores, no_pixels
from place_recognition.verification.candidate_verification import (
    CandidateVerificationConfig,
    VerificationResult,
    verify_pair,
)
from place_recognition.verification.present_view import CameraSteps

_MIN_FEATURES = 9  # an image with fewer shows no place, neither as a query nor as a match
# The image next to the most likely one is the match if it agrees so strongly, and by this ratio better.
_EXACT_EVIDENCE, _MUCH_BETTER = 60.0, 2.0
_NEAR = 2  # steps within which a candidate shows the most likely place
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
        weights: RatioWeights | None = None,
    ) -> None:
        self._history, self._own_ratio, self._config = history, own_ratio, config
        self._verification, self._weights = verification, weights
        self._filter, self._steps = PlaceFilter(config), CameraSteps(history)
        self._waiting: deque[tuple[Proposals, Results]] = deque()

    def add(self, proposals: Proposals, results: Results) -> list[Belief]:
        """Add the candidates of the next query and return the belief that is ready now, if any."""
        if self._steps.add(proposals.query):
            self._filter.add(self._observe(proposals, results))
        self._waiting.append((proposals, results))
        return [self._answer_oldest()] if len(self._waiting) > self._config.lag_frames else []

    def finish(self) -> list[Belief]:
        """Return the beliefs about the last queries."""
        return [self._answer_oldest() for _ in range(len(self._waiting))]

    def end_reference(self) -> None:
        """Begin anew, with the places of the images so far."""
        self._filter = PlaceFilter(self._config)
        self._steps.end_reference()

    def _observe(self, proposals: Proposals, results: Results) -> Observation:
        own = dict(zip(proposals.locations, self._own_ratio(proposals.scores), strict=True))
        evidence = np.array([result.evidence for result in results], np.float64)
        # The image beside a candidate, which geometry prefers, has the score of the candidate next to it.
        nearest = [own[min(own, key=lambda k: abs(k - result.location))] for result in results]
        ratios = log_ratios(np.array(nearest), evidence, self._weights)
        elsewhere = log_ratios_elsewhere(ratios, evidence)
        return Observation(self._places(results), ratios, elsewhere, sharpness(evidence), self._steps.junctions())

    def _answer_oldest(self) -> Belief:
        proposals, results = self._waiting.popleft()
        step = self._steps.of(proposals.query)
        posterior = self._filter.posterior(len(self._steps) - 1 - step)
        query, stages = int(self._history.ids[proposals.query]), stage_scores(self._history, proposals, results)
        location = self._match(proposals, results, posterior)
        if location is None:
            return Belief(query, None, posterior.log_odds, accepted=False, probability=0.0, stages=stages)
        result = self._result(proposals.query, location, results, posterior.probability)
        location = location if result is None else result.location
        verified = result is not None and result.evidence >= min_evidence(proposals.query, self._verification)
        accepted = verified and posterior.probability >= self._config.min_probability
        if accepted and posterior.place is not None:
            self._steps.recognize(step, posterior.place)
        return Belief(
            query=query,
            match=int(self._history.ids[location]),
            score=posterior.log_odds,
            accepted=accepted,
            inliers=None if result is None else result.inliers,
            verified=verified,
            pixels=no_pixels() if result is None else result.pixels,
            probability=posterior.probability,
            stages=stages,
        )

    def _match(self, proposals: Proposals, results: Results, posterior: PlacePosterior) -> int | None:
        """The image that stands for the most likely place, or for one beside it; None for a blank query.

        Where several passes or images show the place, it is sought in the pass of the candidate of most evidence, and
        there the candidate of most evidence, else the middle image.
        """
        if posterior.place is None or not self._is_textured(proposals.query):
            return None
        step, evidence = self._find_step(results, posterior.place), {r.location: r.evidence for r in results}
        for beside in (step + offset for offset in (0, -1, 1, -2, 2)):
            images = self._steps.images(beside) if 0 <= beside < len(self._steps) else range(0)
            allowed = [k for k in images if k <= proposals.last_matchable and self._is_textured(k)]
            if allowed:
                middle = allowed[len(allowed) // 2]
                return max(allowed, key=lambda k: (evidence.get(k, 0.0), k == middle))
        return None

    def _find_step(self, results: Results, place: int) -> int:
        """The step that shows a place in the pass of the candidate near it that has most evidence."""
        places = self._places(results)
        near = [(result.evidence, k) for k, result in enumerate(results) if abs(int(places[k]) - place) <= _NEAR]
        if not near:
            return place
        best = max(near)[1]
        return self._steps.of(results[best].location) + place - int(places[best])

    def _places(self, results: Results) -> NDArray[np.int64]:
        """The places (K,) that the candidates show."""
        return self._steps.places(np.array([result.location for result in results], np.int64))

    def _result(self, query: int, location: int, results: Results, probability: float) -> VerificationResult | None:
        """The verification of the match, or of a candidate next to it that agrees much better."""
        result = next((result for result in results if result.location == location), None)
        if result is None and probability >= _LIKELY:
            result = verify_pair(self._history.images, query, location, self._verification)
        beside = [other for other in results if abs(other.location - location) == 1]
        best = max(beside, key=lambda other: other.evidence, default=None)
        if result is None or best is None:
            return result
        return best if best.evidence > max(_MUCH_BETTER * result.evidence, _EXACT_EVIDENCE) else result

    def _is_textured(self, location: int) -> bool:
        return self._history.images.count(location) >= _MIN_FEATURES

    def state(self) -> dict[str, Any]:
        """Everything that waits for later images, for a checkpoint."""
        waiting = [
            {"proposals": dict(vars(proposals)), "results": [dict(vars(result)) for result in results]}
            for proposals, results in self._waiting
        ]
        return {"filter": self._filter.state(), "steps": self._steps.state(), "waiting": waiting}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._filter.restore(state["filter"])
        self._steps.restore(state["steps"])
        for one in state["waiting"]:
            results = tuple(VerificationResult(**result) for result in one["results"])
            self._waiting.append((Proposals(**one["proposals"]), results))


class GeometricDecision:
    """Answers each query by geometry alone, at once (a Decision): for images without order.

    The match is the candidate of most evidence, which is the score; it is accepted if less than one chance match is
    expected among all tests so far.
    """

    def __init__(self, history: ImageHistory, verification: CandidateVerificationConfig) -> None:
        self._history, self._verification = history, verification

    def add(self, proposals: Proposals, results: Results) -> list[Belief]:
        """Add the candidates of the next query and return the belief about it."""
        query, stages = int(self._history.ids[proposals.query]), stage_scores(self._history, proposals, results)
        if stages.geometry_match is None or stages.geometry_score is None:
            return [Belief(query, None, 0.0, accepted=False, verified=False, stages=stages)]
        best = max(results, key=lambda result: result.evidence)
        verified = best.evidence >= min_evidence(proposals.query, self._verification)
        belief = Belief(
            query=query,
            match=stages.geometry_match,
            score=stages.geometry_score,
            accepted=verified,
            inliers=best.inliers,
            verified=True,  # geometry agrees with the match, be it too little to accept it: the curve counts it
            pixels=best.pixels,
            stages=stages,
        )
        return [belief]

    def finish(self) -> list[Belief]:
        """Return nothing: each query is answered at once."""
        return []

    def end_reference(self) -> None:
        """Do nothing: no image has a say in the answer of another."""

    def state(self) -> None:
        """Nothing."""

    def restore(self, state: None) -> None:
        """Nothing."""


def min_evidence(query: int, config: CandidateVerificationConfig) -> float:
    """Evidence from which a pair counts as verified: less than one chance match among all tests of the drive so far."""
    return math.log10(config.max_candidates * (query + 1))


def stage_scores(history: ImageHistory, proposals: Proposals, results: Results) -> StageScores:
    """What the paradigm and geometry answer by themselves, with the ids of the images."""
    ids = history.ids
    best = max(results, key=lambda result: result.evidence, default=None)
    if best is not None and best.inliers == 0:
        best = None
    return StageScores(
        candidates=tuple(int(ids[location]) for location in proposals.locations),
        own_score=proposals.scores[0] if proposals.scores else None,
        geometry_match=None if best is None else int(ids[best.location]),
        geometry_score=None if best is None else best.evidence,
    )
