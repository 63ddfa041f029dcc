"""Place recognition by word vectors of sequences cut where the view changes, and a learnt filter (section 4.4.2).

Bampis, Amanatiadis, Gasteratos, 'Fast Loop-Closure Detection Using Visual-Word-Vectors From Image Sequences',
IJRR 37(1) 2018. For what differs from the paper see `sequence_matching`.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.belief.matrix_filter import LEARNT, FilterConfig
from place_recognition.image_processing.features import FeatureCache
from place_recognition.map.sequences import WordVariance, WordVarianceConfig
from place_recognition.map.vocabulary import Vocabulary
from place_recognition.paradigms.sequence_matching import MatchingConfig, SequenceMatching, published_matching
from place_recognition.recognizer import Belief, RowSink


@dataclass(frozen=True)
class DynamicSequencesConfig:
    """The paradigm's own numbers, and those that it shares.

    Attributes:
        sequences: where a sequence ends.
        filter: eq. 4.12 and the threshold of its response, 3.5 in the paper. Damped counts (`MatchingConfig.power`)
            make all responses lower; in simulated blocks those of other places stayed below 2.2.
        matching: how sequences are matched, and then images.
    """

    sequences: WordVarianceConfig = field(default_factory=WordVarianceConfig)
    filter: FilterConfig = field(default_factory=lambda: FilterConfig(LEARNT, 2.2))
    matching: MatchingConfig = field(default_factory=MatchingConfig)

    @classmethod
    def published(cls) -> "DynamicSequencesConfig":
        """The paper's numbers: variance 0.75, which belongs to a vocabulary of a million words, and k' = 3.5."""
        sequences = WordVarianceConfig(min_variance=0.75, min_variance_ratio=0.0, min_images=1, max_images=1000)
        return cls(sequences, FilterConfig(LEARNT, 3.5), published_matching(3.5))


class DynamicSequences:
    """Recognises places by sequences of like views (a PlaceRecognizer); answers when the next sequence has ended."""

    def __init__(
        self,
        features: FeatureCache,
        vocabulary: Vocabulary,
        config: DynamicSequencesConfig | None = None,
        rows: RowSink | None = None,
    ) -> None:
        self.config = config or DynamicSequencesConfig()
        segmentation = WordVariance(len(vocabulary), self.config.sequences)
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
