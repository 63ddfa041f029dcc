"""Naive baseline: the earlier image whose global descriptor has the largest cosine with that of the query (eq. 4.3).

It uses neither geometry nor sequences: its false matches show what the chapter's paradigms save a robot from. The
descriptor may be a histogram of oriented gradients or any network (`make_global_descriptor`).
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.global_descriptors import GlobalDescriptor
from place_recognition.image_processing.local_features import check_gray
from place_recognition.map.descriptor_database import DescriptorDatabase
from place_recognition.map.exclusion_window import ExclusionWindow, ExclusionWindowConfig
from place_recognition.recognizer import Belief, MatrixSink, NullMatrixSink


@dataclass(frozen=True)
class GlobalDescriptorConfig:
    """Settings of the paradigm.

    Attributes:
        threshold: smallest cosine of an accepted match. It belongs to the descriptor, here HOG: unrelated images of
            simulated towns reached 0.88, those of random texture 0.92.
        exclusion_window: which images are too recent to be matched.
    """

    threshold: float = 0.93
    exclusion_window: ExclusionWindowConfig = field(default_factory=ExclusionWindowConfig)


class GlobalDescriptorMatching:
    """Recognises places by one descriptor per image (a PlaceRecognizer). Answers each image at once."""

    def __init__(
        self, descriptor: GlobalDescriptor, config: GlobalDescriptorConfig | None = None, rows: MatrixSink | None = None
    ) -> None:
        self.config = config or GlobalDescriptorConfig()
        self._descriptor = descriptor
        self._exclusion_window = ExclusionWindow(self.config.exclusion_window)
        self._map = DescriptorDatabase()
        self._rows = NullMatrixSink() if rows is None else rows

    def observe(self, image_id: int, image: NDArray[np.uint8], distance_travelled_m: float) -> list[Belief]:
        """Return the belief about this image and add it to the map.

        Args:
            image_id: greater than the one before.
            image: (H, W) uint8, grey, of any size.
            distance_travelled_m: length of the path so far, metres; NaN, or always the same, where it is not measured.
        """
        check_gray(image)
        vector = self._descriptor.describe(image)
        self._exclusion_window.add(image_id, image, distance_travelled_m)
        ids = self._exclusion_window.ids[: self._exclusion_window.count_matchable()]
        similarities = self._map.similarities(vector, len(ids))
        self._rows.add(image_id, ids, similarities)
        self._map.add(vector)
        return [self._make_belief(image_id, similarities)]

    def finish(self) -> list[Belief]:
        """Return nothing: each image is answered at once."""
        return []

    def _make_belief(self, image_id: int, similarities: NDArray[np.float64]) -> Belief:
        if not (similarities > 0).any():
            return Belief(image_id, None, 0.0, accepted=False)
        best = int(similarities.argmax())
        score = float(similarities[best])
        return Belief(image_id, int(self._exclusion_window.ids[best]), score, accepted=score >= self.config.threshold)

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {"history": self._exclusion_window.state(), "descriptors": self._map.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another recogniser of this configuration."""
        self._exclusion_window.restore(state["history"])
        self._map.restore(state["descriptors"])
