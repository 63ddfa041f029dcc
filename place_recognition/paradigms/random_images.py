"""The control of every paradigm: random earlier images. A stage that is no better with a paradigm does not need it."""

from typing import Any

import numpy as np

from place_recognition.proposals import ObservedImage, Proposals
from place_recognition.recognizer import MAX_STAGE_CANDIDATES


class RandomImages:
    """Proposes random earlier images (a Proposer)."""

    def __init__(self, seed: int, max_candidates: int = MAX_STAGE_CANDIDATES) -> None:
        self._seed, self._max_candidates = seed, max_candidates

    def observe(self, image: ObservedImage) -> list[Proposals]:
        """Propose random locations of those that may be matched, all of the same score."""
        count = min(self._max_candidates, image.last_matchable + 1)
        # A generator of its own for each image: no state to keep.
        rng = np.random.default_rng((self._seed, image.location))
        locations = rng.choice(image.last_matchable + 1, count, replace=False) if count else np.empty(0, np.int64)
        return [Proposals(image.location, image.last_matchable, tuple(locations.tolist()), (0.0,) * count)]

    def finish(self) -> list[Proposals]:
        """Return nothing: each image is answered at once."""
        return []

    def state(self) -> dict[str, Any]:
        """Nothing."""
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        """Nothing."""
