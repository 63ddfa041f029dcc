"""Naive baseline: the earlier images whose global descriptors have the largest cosine with that of the query (eq. 4.3).

The descriptor may be a histogram of oriented gradients or any network (`make_global_descriptor`).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from place_recognition.image_processing.global_descriptors import GlobalDescriptor
from place_recognition.map.descriptor_database import DescriptorDatabase
from place_recognition.proposals import ObservedImage, Proposals, propose_best
from place_recognition.recognizer import MAX_STAGE_CANDIDATES, MatrixSink, NullMatrixSink


@dataclass(frozen=True)
class GlobalDescriptorConfig:
    """Settings of the paradigm.

    Attributes:
        max_candidates: number of images that are proposed.
        min_separation: smallest number of images between any two of them.
    """

    max_candidates: int = MAX_STAGE_CANDIDATES
    min_separation: int = 4


class GlobalDescriptorMatching:
    """Proposes images by one descriptor per image (a Proposer); the score is its cosine."""

    def __init__(
        self, descriptor: GlobalDescriptor, config: GlobalDescriptorConfig | None = None, rows: MatrixSink | None = None
    ) -> None:
        self.config = config or GlobalDescriptorConfig()
        self._descriptor = descriptor
        self._map = DescriptorDatabase()
        self._rows = NullMatrixSink() if rows is None else rows

    def observe(self, image: ObservedImage) -> list[Proposals]:
        """Propose the most similar images, and add this one to the map."""
        vector = self._descriptor.describe(image.pixels)
        similarities = self._map.similarities(vector, image.last_matchable + 1)
        self._rows.add(image.location, np.arange(len(similarities)), similarities)
        self._map.add(vector)
        return [propose_best(image, similarities, self.config.max_candidates, self.config.min_separation)]

    def finish(self) -> list[Proposals]:
        """Return nothing: each image is answered at once."""
        return []

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {"descriptors": self._map.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another proposer of this configuration."""
        self._map.restore(state["descriptors"])
