"""Temporal consistency: a revisit lasts, and its matches advance along the earlier pass as its queries do.

`TemporalConsistency` uses the images before a query: it predicts the next match and adds up the evidence that agrees.
`GapFiller` uses the images before and after, so its answer is a little late: an image between two accepted matches
gets the interpolated match. A blank wall, a passing lorry or the blur of a bump leaves such images without matches.
Reasons of the settings: docs/decisions/candidate_verification.md.
"""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from place_recognition.belief.candidate_verification import VerificationResult
from place_recognition.map.image_history import ImageHistory
from place_recognition.recognizer import Belief, no_pixels


@dataclass(frozen=True)
class ConsistencyConfig:
    """Which earlier results support a new one.

    Attributes:
        history_images: number of images before the query whose results count. It is long, so that a place is not
            exchanged for a look-alike that is seen in better light.
        max_speed_ratio: images by which the match may move for each image of the query, forwards or backwards: the two
            passes may be driven at different speeds and in different directions.
        tolerance_images: images by which the match may be off besides.
        search_radius: images before and after the predicted match that are candidates too.
        certain_evidence: sum of the agreeing evidence, in powers of ten, from which the place is taken for certain:
            twice what is enough for a match (`SequenceConsensusConfig.min_total_evidence`).
    """

    history_images: int = 10
    max_speed_ratio: float = 3.0
    tolerance_images: int = 2
    search_radius: int = 4
    certain_evidence: float = 200.0


class TemporalConsistency:
    """Keeps the best results of the latest queries, predicts the next match, and sums the evidence that agrees.

    The evidence of different images is summed like logarithms of probabilities. Results come in the order of queries.
    """

    def __init__(self, config: ConsistencyConfig | None = None) -> None:
        self.config = config or ConsistencyConfig()
        self._recent: deque[VerificationResult] = deque(maxlen=self.config.history_images)

    def add(self, result: VerificationResult) -> None:
        """Add the best result of the latest query."""
        self._recent.append(result)

    def sum_agreeing_evidence(self, result: VerificationResult) -> float:
        """Sum the evidence, in powers of ten, of the earlier results that agree with this one."""
        recent = (earlier for earlier in self._recent if result.query - earlier.query <= self.config.history_images)
        return sum(earlier.evidence for earlier in recent if self._agree(earlier, result))

    def predict_locations(self, query: int) -> list[int]:
        """Predict the locations that match a query if the revisit goes on, the likeliest first.

        The prediction starts at the recent result of the most evidence. The very latest one would be worse: an image
        with little evidence may have been matched with a look-alike.
        """
        recent = [past for past in self._recent if past.verified and query - past.query <= self.config.history_images]
        if not recent:
            return []
        best = max(recent, key=lambda result: result.evidence)
        center = best.location + self._direction(best) * (query - best.query)
        radius = self.config.search_radius
        return [center + offset for offset in sorted(range(-radius, radius + 1), key=abs)]

    def is_certain(self, result: VerificationResult) -> bool:
        """Whether the earlier results that agree with this one are enough to take the place for certain."""
        return self.sum_agreeing_evidence(result) >= self.config.certain_evidence

    def _direction(self, best: VerificationResult) -> int:
        """Images by which the match moves for each query: 1, or -1 where the earlier pass is driven backwards."""
        first = next(result for result in self._recent if result.verified)
        return -1 if best.location < first.location and self._agree(first, best) else 1

    def _agree(self, earlier: VerificationResult, result: VerificationResult) -> bool:
        reach = self.config.max_speed_ratio * (result.query - earlier.query) + self.config.tolerance_images
        return abs(result.location - earlier.location) <= reach

    def state(self) -> list[dict[str, Any]]:
        """The best results of the latest queries, for a checkpoint."""
        return [dict(vars(result)) for result in self._recent]

    def restore(self, state: list[dict[str, Any]]) -> None:
        """Continue from a state."""
        self._recent = deque((VerificationResult(**result) for result in state), maxlen=self._recent.maxlen)


@dataclass(frozen=True)
class GapFillerConfig:
    """Which gaps are filled.

    Attributes:
        max_gap_images: largest number of consecutive images without accepted match that are filled; also the largest
            delay of an answer.
        max_speed_ratio: images by which the match may move for each image of the query, forwards or backwards.
        tolerance_images: images by which the match may be off besides.
        min_features: an image with fewer features shows no place, neither as a query nor as a match.
    """

    max_gap_images: int = 2
    max_speed_ratio: float = 3.0
    tolerance_images: int = 2
    min_features: int = 9


class GapFiller:
    """Takes the beliefs of a paradigm in order and returns them in order, with matches filled into short gaps.

    A filled belief is never accepted, because no geometry measures it: only its match, score and `verified` change.
    """

    def __init__(self, history: ImageHistory, config: GapFillerConfig | None = None) -> None:
        self.config = config or GapFillerConfig()
        self._history = history
        self._before: Belief | None = None  # latest accepted belief
        self._gap: list[Belief] = []  # beliefs since then, which wait for the next accepted one

    def add(self, beliefs: Iterable[Belief]) -> list[Belief]:
        """Add beliefs and return those that are final now."""
        return [final for belief in beliefs for final in self._add_one(belief)]

    def finish(self) -> list[Belief]:
        """Return the waiting beliefs, which no accepted one has followed, as they are."""
        gap, self._gap, self._before = self._gap, [], None
        return gap

    def _add_one(self, belief: Belief) -> list[Belief]:
        if belief.accepted:
            filled = [self._fill(waiting, belief) for waiting in self._gap]
            self._before, self._gap = belief, []
            return [*filled, belief]
        if self._before is not None and len(self._gap) < self.config.max_gap_images:
            self._gap.append(belief)
            return []
        return [*self.finish(), belief]

    def _fill(self, belief: Belief, after: Belief) -> Belief:
        """The belief with the interpolated match; the belief itself where its neighbours disagree or it is blank."""
        before = self._before
        assert before is not None  # a belief waits only after an accepted one
        location = self._interpolate(before, belief, after)
        if location is None:
            return belief
        chosen = self._nearest_textured(location, self._location(belief.match))
        if chosen is None or not self._is_textured(self._history.find_location(belief.query)):
            return belief
        score, match_id = min(before.score, after.score), int(self._history.ids[chosen])
        pixels = belief.pixels if match_id == belief.match else no_pixels()
        return replace(belief, match=match_id, score=score, verified=True, pixels=pixels)

    def _nearest_textured(self, location: int, own: int | None) -> int | None:
        """The belief's own location if it is within the tolerance, else the nearest one with enough features."""
        steps = sorted(range(-self.config.tolerance_images, self.config.tolerance_images + 1), key=abs)
        near = [location + step for step in steps if 0 <= location + step < len(self._history)]
        return next((k for k in sorted(near, key=lambda k: k != own) if self._is_textured(k)), None)

    def _interpolate(self, before: Belief, belief: Belief, after: Belief) -> int | None:
        """Location between the matches of two accepted beliefs; None if these lie too far apart for one revisit."""
        start, query, end = (self._history.find_location(one.query) for one in (before, belief, after))
        first, last = self._location(before.match), self._location(after.match)
        if first is None or last is None:
            return None
        if abs(last - first) > self.config.max_speed_ratio * (end - start) + self.config.tolerance_images:
            return None
        return first + round((query - start) / (end - start) * (last - first))

    def _location(self, image_id: int | None) -> int | None:
        return None if image_id is None else self._history.find_location(image_id)

    def _is_textured(self, location: int) -> bool:
        return len(self._history.images[location]) >= self.config.min_features

    def state(self) -> dict[str, Any]:
        """The latest accepted belief and those after it, for a checkpoint."""
        before = None if self._before is None else dict(vars(self._before))
        return {"accepted": before, "waiting": [dict(vars(belief)) for belief in self._gap]}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._before = None if state["accepted"] is None else Belief(**state["accepted"])
        self._gap = [Belief(**belief) for belief in state["waiting"]]
