"""The two paradigms of sequences: a segmentation and a matrix filter for one `SequenceProposer` each.

* sequence-histograms (section 4.4.1): sequences of a fixed distance and a hand-made filter. Bampis, Amanatiadis,
  Gasteratos, 'Encoding the Description of Image Sequences: A Two-Layered Pipeline for Loop Closure Detection', IROS
  2016.
* dynamic-sequences (section 4.4.2): sequences that end where the view changes and a learnt filter. Bampis, Amanatiadis,
  Gasteratos, 'Fast Loop-Closure Detection Using Visual-Word-Vectors From Image Sequences', IJRR 37(1) 2018.

How both deviate from the papers: `place_recognition.paradigms.sequence_proposer`.
"""

from dataclasses import dataclass, field

from place_recognition.belief.matrix_filter import DIAGONAL, LEARNED, FilterConfig
from place_recognition.map.sequence_map import (
    FixedDistanceConfig,
    FixedDistanceSegmentation,
    WordVariance,
    WordVarianceConfig,
)
from place_recognition.paradigms.sequence_proposer import SequenceMatchingConfig, SequenceProposer
from place_recognition.recognizer import MatrixSink
from place_recognition.vocabulary.vocabulary import Vocabulary


@dataclass(frozen=True)
class SequenceHistogramsConfig:
    """Settings of the paradigm of sequences of a fixed distance.

    Attributes:
        sequences: length of a sequence.
        filter: kernel of equation 4.8 and the threshold of its response.
        matching: how sequences, and then images, are matched.
    """

    sequences: FixedDistanceConfig = field(default_factory=FixedDistanceConfig)
    filter: FilterConfig = field(default_factory=lambda: FilterConfig(DIAGONAL, 0.32))
    matching: SequenceMatchingConfig = field(default_factory=SequenceMatchingConfig)


@dataclass(frozen=True)
class DynamicSequencesConfig:
    """Settings of the paradigm of sequences that end where the view changes.

    Attributes:
        sequences: when a sequence ends.
        filter: kernel of equation 4.12 and the threshold of its response. The paper's threshold is 3.5; damped term
            frequencies (`SequenceMatchingConfig.tf_power`) make all responses smaller, and in simulated blocks those of
            other places stayed below 2.2.
        matching: how sequences, and then images, are matched.
    """

    sequences: WordVarianceConfig = field(default_factory=WordVarianceConfig)
    filter: FilterConfig = field(default_factory=lambda: FilterConfig(LEARNED, 2.2))
    matching: SequenceMatchingConfig = field(default_factory=SequenceMatchingConfig)


def make_sequence_histograms(
    kind: str,
    vocabulary: Vocabulary,
    config: SequenceHistogramsConfig | None = None,
    rows: MatrixSink | None = None,
) -> SequenceProposer:
    """Make a proposer of sequences of a fixed distance that has seen nothing."""
    config = config or SequenceHistogramsConfig()
    segmentation = FixedDistanceSegmentation(config.sequences)
    return SequenceProposer(kind, vocabulary, segmentation, config.matching, config.filter, rows)


def make_dynamic_sequences(
    kind: str,
    vocabulary: Vocabulary,
    config: DynamicSequencesConfig | None = None,
    rows: MatrixSink | None = None,
) -> SequenceProposer:
    """Make a proposer of sequences that end where the view changes; it has seen nothing."""
    config = config or DynamicSequencesConfig()
    segmentation = WordVariance(len(vocabulary), config.sequences)
    return SequenceProposer(kind, vocabulary, segmentation, config.matching, config.filter, rows)
