"""A naive baseline: the earlier image whose descriptor as a whole is most like this one's, by its cosine (eq. 4.3).

No geometry is asked and no sequence: what such a baseline takes for a revisit is what the chapter's paradigms save a
robot from. The descriptor may be a histogram of oriented gradients or any network (`make_global_descriptor`).
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.features import check_gray
from place_recognition.image_processing.global_descriptors import GlobalDescriptor
from place_recognition.map.dense import DenseMap
from place_recognition.map.present_view import ExclusionWindow, ExclusionWindowConfig
from place_recognition.recognizer import Belief, NoRows, RowSink


@dataclass(frozen=True)
class GlobalDescriptorConfig:
    """When two images are taken for one place.

    Attributes:
        threshold: least cosine of an accepted match. It belongs to the descriptor; this one to HOG, which in first
            passes through simulated towns reached 0.88, and in random texture 0.92.
        present: what counts as the present rather than the past.
    """

    threshold: float = 0.93
    present: ExclusionWindowConfig = field(default_factory=ExclusionWindowConfig)


class GlobalDescriptorMatching:
    """Recognises places by one descriptor an image (a PlaceRecognizer). Answers each image at once."""

    def __init__(
        self, descriptor: GlobalDescriptor, config: GlobalDescriptorConfig | None = None, rows: RowSink | None = None
    ) -> None:
        self.config = config or GlobalDescriptorConfig()
        self._descriptor = descriptor
        self._present = ExclusionWindow(self.config.present)
        self._map = DenseMap()
        self._rows = NoRows() if rows is None else rows

    def observe(self, image_id: int, image: NDArray[np.uint8], travelled: float) -> list[Belief]:
        """Answer for this image and add it to the map.

        Args:
            image_id: greater than the one before.
            image: (H, W) uint8, grey, of any size.
            travelled: way driven so far, metres; NaN, or always the same, where it is not measured.
        """
        check_gray(image)
        vector = self._descriptor.describe(image)
        self._present.add(image_id, image, travelled)
        ids = self._present.ids[: self._present.count_matchable()]
        similarities = self._map.similarities(vector, len(ids))
        self._rows.add(image_id, ids, similarities)
        self._map.add(vector)
        return [self._believe(image_id, similarities)]

    def finish(self) -> list[Belief]:
        """Nothing is left unanswered."""
        return []

    def _believe(self, image_id: int, similarities: NDArray[np.float64]) -> Belief:
        if not (similarities > 0).any():
            return Belief(image_id, None, 0.0, accepted=False)
        best = int(similarities.argmax())
        score = float(similarities[best])
        return Belief(image_id, int(self._present.ids[best]), score, accepted=score >= self.config.threshold)

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {"history": self._present.state(), "descriptors": self._map.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another recogniser of this configuration."""
        self._present.restore(state["history"])
        self._map.restore(state["descriptors"])
