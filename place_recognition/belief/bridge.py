"""Fill short gaps: an image between two accepted matches gets the interpolated match.

A blank wall, a passing lorry or the blur of a bump leaves an image without matches, while those before and after it
are accepted. This is temporal consistency in both directions of time, so the answer is a little late.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from place_recognition.map.route import ImageHistory
from place_recognition.recognizer import Belief, no_pixels


@dataclass(frozen=True)
class GapFillerConfig:
    """Which gaps are filled.

    Attributes:
        max_gap_images: largest number of consecutive images without accepted match that are filled; also the largest
            delay of an answer.
        max_speed_ratio: images by which the match may move for each image of the query, forwards or backwards.
        tolerance: images by which the match may be off besides.
        min_features: an image with fewer features shows no place, neither as a query nor as a match.
    """

    max_gap_images: int = 2
    max_speed_ratio: float = 3.0
    tolerance: int = 2
    min_features: int = 9


class GapFiller:
    """Takes the beliefs of a paradigm in order and returns them in order, with matches filled into short gaps.

    A filled belief is never accepted, because no geometry measures it: only its match, score and `verified` change.
    """

    def __init__(self, route: ImageHistory, config: GapFillerConfig | None = None) -> None:
        self.config = config or GapFillerConfig()
        self._route = route
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
        if chosen is None or not self._is_textured(self._route.find_location(belief.query)):
            return belief
        score, match_id = min(before.score, after.score), int(self._route.ids[chosen])
        pixels = belief.pixels if match_id == belief.match else no_pixels()
        return replace(belief, match=match_id, score=score, verified=True, pixels=pixels)

    def _nearest_textured(self, location: int, own: int | None) -> int | None:
        """The belief's own location if it is within the tolerance, else the nearest one with enough features."""
        steps = sorted(range(-self.config.tolerance, self.config.tolerance + 1), key=abs)
        near = [location + step for step in steps if 0 <= location + step < len(self._route)]
        return next((k for k in sorted(near, key=lambda k: k != own) if self._is_textured(k)), None)

    def _interpolate(self, before: Belief, belief: Belief, after: Belief) -> int | None:
        """Location between the matches of two accepted beliefs; None if these lie too far apart for one revisit."""
        start, query, end = (self._route.find_location(one.query) for one in (before, belief, after))
        first, last = self._location(before.match), self._location(after.match)
        if first is None or last is None:
            return None
        if abs(last - first) > self.config.max_speed_ratio * (end - start) + self.config.tolerance:
            return None
        return first + round((query - start) / (end - start) * (last - first))

    def _location(self, image_id: int | None) -> int | None:
        return None if image_id is None else self._route.find_location(image_id)

    def _is_textured(self, location: int) -> bool:
        return len(self._route.images[location]) >= self.config.min_features

    def state(self) -> dict[str, Any]:
        """The latest accepted belief and those after it, for a checkpoint."""
        before = None if self._before is None else dict(vars(self._before))
        return {"accepted": before, "waiting": [dict(vars(belief)) for belief in self._gap]}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._before = None if state["accepted"] is None else Belief(**state["accepted"])
        self._gap = [Belief(**belief) for belief in state["waiting"]]
