"""Place recognition by word vectors of sequences of a fixed way, and a filter made by hand (section 4.4.1).

Bampis, Amanatiadis, Gasteratos, 'Encoding the Description of Image Sequences: A Two-Layered Pipeline for Loop Closure
Detection', IROS 2016. For what differs from the paper see `sequence_matching`.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.belief.matrix_filter import DIAGONAL, FilterConfig
from place_recognition.image_processing.features import FeatureCache
from place_recognition.map.sequences import FixedDistanceConfig, FixedDistanceSegmentation
from place_recognition.map.vocabulary import Vocabulary
from place_recognition.paradigms.sequence_matching import MatchingConfig, SequenceMatching, published_matching
from place_recognition.recognizer import Belief, RowSink


@dataclass(frozen=True)
class SequenceHistogramsConfig:
    """The paradigm's own numbers, and those that it shares.

    Attributes:
        sequences: how long a sequence is.
        filter: eq. 4.8 and the threshold of its response.
        matching: how sequences are matched, and then images.
    """

    sequences: FixedDistanceConfig = field(default_factory=FixedDistanceConfig)
    filter: FilterConfig = field(default_factory=lambda: FilterConfig(DIAGONAL, 0.32))
    matching: MatchingConfig = field(default_factory=MatchingConfig)

    @classmethod
    def published(cls) -> "SequenceHistogramsConfig":
        """The paper's numbers: 5 m (Table III), k = 0.32, 12 inliers."""
        return cls(FixedDistanceConfig(distance_m=5.0), FilterConfig(DIAGONAL, 0.32), published_matching(0.32))


class SequenceHistograms:
    """Recognises places by sequences of 5 m (a PlaceRecognizer); answers when the next sequence has ended."""

    def __init__(
        self,
        features: FeatureCache,
        vocabulary: Vocabulary,
        config: SequenceHistogramsConfig | None = None,
        rows: RowSink | None = None,
    ) -> None:
        self.config = config or SequenceHistogramsConfig()
        segmentation = FixedDistanceSegmentation(self.config.sequences)
        self._matching = SequenceMatching(features, vocabulary, segmentation, self.config.matching, self.config.filter)
        self._word_count = len(vocabulary)
        if rows is not None:
            self._matching.show_rows(rows)

    @property
    def word_count(self) -> int:
        """Words of the vocabulary."""
        return self._word_count

    def observe(self, image_id: int, image: NDArray[np.uint8], travelled: float) -> list[Belief]:
        """Add an image; if it begins a sequence, answer for the images of the last but one before it.

        Args:
            image_id: greater than the one before.
            image: (H, W) uint8, grey.
            travelled: way driven so far, metres; NaN, or always the same, where it is not measured.
        """
        return self._matching.observe(image_id, image, travelled)

    def finish(self) -> list[Belief]:
        """Answer for the images of the last two sequences."""
        return self._matching.finish()

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return self._matching.state()

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from the state of another recogniser of this configuration and vocabulary."""
        self._matching.restore(state)
