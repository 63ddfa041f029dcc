"""The control of place recognition: a recogniser that proposes random past images and looks at none of them."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import FeatureCache
from place_recognition.paradigms.registry import ParadigmsConfig
from place_recognition.recognizer import MAX_STAGE_CANDIDATES, Belief, StageScores


class RandomImages:
    """Proposes random past images with random scores (a PlaceRecognizer)."""

    def __init__(self, features: FeatureCache, seed: int) -> None:
        self._features, self._rng = features, np.random.default_rng(seed)
        self._ids: list[int] = []

    def observe(self, image_id: int, image: NDArray[np.uint8], distance_travelled_m: float) -> list[Belief]:
        """Add an image and return the belief about it."""
        self._features.get(image_id, image)  # as every paradigm does
        count = min(MAX_STAGE_CANDIDATES, len(self._ids))
        chosen = self._rng.choice(len(self._ids), count, replace=False) if count else ()
        candidates = tuple(self._ids[index] for index in chosen)
        own, geometry = self._rng.random(2).tolist()
        self._ids.append(image_id)
        if not candidates:
            return [Belief(image_id, None, 0.0, accepted=False, answered_at=image_id)]
        stages = StageScores(candidates, own, candidates[0], geometry)
        return [Belief(image_id, candidates[0], own, False, stages=stages, answered_at=image_id)]

    def finish(self) -> list[Belief]:
        """Return nothing: every image was answered at once."""
        return []

    def state(self) -> dict[str, Any]:
        """Ids and generator."""
        return {"ids": list(self._ids), "generator": self._rng.bit_generator.state}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._ids, self._rng.bit_generator.state = list(state["ids"]), state["generator"]


def make_control(features: FeatureCache, config: ParadigmsConfig, seed: int) -> RandomImages:
    """Make the control for the features of a run."""
    return RandomImages(features, seed)
