"""Between two sure revisits of one stretch of way lies a third: an image that proves nothing itself is spoken for.

A blank wall, a passing lorry or the blur of a bump leaves an image without matches, while those before and after it
are sure. Temporal consistency in both directions of time, so such an image is answered a little late.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

from place_recognition.map.route import ImageHistory
from place_recognition.recognizer import Belief, no_pixels


@dataclass(frozen=True)
class BridgeConfig:
    """What may be bridged.

    Attributes:
        longest: images in a row that may be unsure between two sure ones; an answer is late by so many at most.
        speed: images that the match may move for each image of the query, forwards or backwards.
        slack: images that it may be off besides.
        least_features: an image with fewer shows no place at all, neither as a query nor as a match.
    """

    longest: int = 2
    speed: float = 3.0
    slack: int = 2
    least_features: int = 9


class Bridge:
    """Takes the beliefs of a paradigm, in order, and passes them on, in order, the spoken-for ones with a match.

    They are never accepted: no geometry measures them. But their match is right as surely as those around it.
    """

    def __init__(self, route: ImageHistory, config: BridgeConfig | None = None) -> None:
        self.config = config or BridgeConfig()
        self._route = route
        self._before: Belief | None = None
        self._unsure: list[Belief] = []

    def add(self, beliefs: Iterable[Belief]) -> list[Belief]:
        """Take beliefs; those that are settled now."""
        return [settled for belief in beliefs for settled in self._take(belief)]

    def finish(self) -> list[Belief]:
        """The beliefs that no sure one has followed."""
        unsure, self._unsure, self._before = self._unsure, [], None
        return unsure

    def _take(self, belief: Belief) -> list[Belief]:
        if belief.accepted:
            spoken_for = [self._between(one, belief) for one in self._unsure]
            self._before, self._unsure = belief, []
            return [*spoken_for, belief]
        if self._before is not None and len(self._unsure) < self.config.longest:
            self._unsure.append(belief)
            return []
        return [*self.finish(), belief]

    def _between(self, belief: Belief, after: Belief) -> Belief:
        """The belief with the match that the sure ones before and after it leave; itself if they do not agree."""
        before = self._before
        assert before is not None  # else the belief had been passed on
        match = self._left_between(before, belief, after)
        if match is None:
            return belief
        chosen = self._nearest_that_shows(match, self._location(belief.match))
        if chosen is None or not self._shows(self._route.find_location(belief.query)):
            return belief
        score, match_id = min(before.score, after.score), int(self._route.ids[chosen])
        pixels = belief.pixels if match_id == belief.match else no_pixels()
        return replace(belief, match=match_id, score=score, verified=True, pixels=pixels)

    def _nearest_that_shows(self, match: int, own: int | None) -> int | None:
        """The belief's own location if it is near enough, else the nearest one near enough that shows something."""
        steps = sorted(range(-self.config.slack, self.config.slack + 1), key=abs)
        near = [match + step for step in steps if 0 <= match + step < len(self._route)]
        return next((k for k in sorted(near, key=lambda k: k != own) if self._shows(k)), None)

    def _left_between(self, before: Belief, belief: Belief, after: Belief) -> int | None:
        """Location between the matches of two sure beliefs, if these are of one stretch of way."""
        start, query, end = (self._route.find_location(one.query) for one in (before, belief, after))
        first, last = self._location(before.match), self._location(after.match)
        if first is None or last is None or abs(last - first) > self.config.speed * (end - start) + self.config.slack:
            return None
        return first + round((query - start) / (end - start) * (last - first))

    def _location(self, image_id: int | None) -> int | None:
        return None if image_id is None else self._route.find_location(image_id)

    def _shows(self, location: int) -> bool:
        return len(self._route.images[location]) >= self.config.least_features

    def state(self) -> dict[str, Any]:
        """The latest accepted belief and those after it, for a checkpoint."""
        before = None if self._before is None else dict(vars(self._before))
        return {"accepted": before, "waiting": [dict(vars(belief)) for belief in self._unsure]}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._before = None if state["accepted"] is None else Belief(**state["accepted"])
        self._unsure = [Belief(**belief) for belief in state["waiting"]]
