"""Registry of the paradigms: makes a recogniser of any of them by its name, by default or as published."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from place_recognition.belief.decisions import GeometricDecision, SmoothedDecision
from place_recognition.belief.likelihood_ratios import LEARNED_SCORE, LEARNED_WEIGHTS, OWN_SCORES
from place_recognition.belief.place_filter import PlaceFilterConfig
from place_recognition.image_processing.extractors import make_extractor
from place_recognition.image_processing.global_descriptors import is_learned, make_global_descriptor
from place_recognition.image_processing.local_features import FeatureCache, FeatureExtractor
from place_recognition.image_processing.onnx_network import LEARNED_KIND, OnnxConfig
from place_recognition.image_processing.surf import Surf, SurfConfig
from place_recognition.map.image_history import ImageHistory
from place_recognition.paradigms import published
from place_recognition.paradigms.hierarchical_places import HierarchicalPlaces, HierarchicalPlacesConfig
from place_recognition.paradigms.seq_slam import SeqSlam, SeqSlamConfig
from place_recognition.paradigms.sequences import (
    DynamicSequencesConfig,
    SequenceHistogramsConfig,
    make_dynamic_sequences,
    make_sequence_histograms,
)
from place_recognition.paradigms.tracked_words import TrackedWords, TrackedWordsConfig
from place_recognition.paradigms.whole_images import (
    GlobalDescriptorConfig,
    GlobalDescriptorMatching,
    PixelSequences,
    PixelSequencesConfig,
    cosines,
    distinctness,
)
from place_recognition.recognizer import MatrixSink, Proposer, RandomImages
from place_recognition.staged_recognizer import Decision, RowsById, StagedRecognizer
from place_recognition.verification.candidate_verification import MINIMAL_SAMPLE, CandidateVerificationConfig
from place_recognition.verification.present_view import FixedPast, FixedWindow, PresentView, PresentViewConfig
from place_recognition.vocabulary.vocabulary import (
    Vocabulary,
    default_vocabulary,
    load_vocabulary,
    published_vocabulary,
)


@dataclass(frozen=True)
class ParadigmsConfig:
    """Settings of all paradigms; of the last seven only those of the chosen one matter.

    Attributes:
        features: name of the local features, a key of EXTRACTORS. A vocabulary works only with the features from which
            it was trained.
        surf: settings of the default features; for other features only their number counts.
        vocabulary: path of a vocabulary file for the paradigms of sequences; empty for the general vocabulary.
        descriptor: descriptor of `global-descriptor`: a key of GLOBAL_DESCRIPTORS, such as "hog" or "small-cnn", or
            "onnx:FILE" for a network of one's own.
        onnx: input of such a network, where its file says nothing of it.
        seed: seed of every random generator.
        preset: "default", or "published" for the methods as the papers state them (`with_preset`).
        temporal: whether the images around an image have a say in its answer; False for images without order.
        reference: whether a reference recording comes first (`StagedRecognizer.end_reference`).
        view: which of the latest images belong to the present.
        verification: how candidates are verified geometrically.
        place_filter: how the candidates of successive images become a probability.
        sequence_histograms: settings of `sequence-histograms`.
        dynamic_sequences: settings of `dynamic-sequences`.
        hierarchical_places: settings of `hierarchical-places`.
        tracked_words: settings of `tracked-words`.
        pixel_sequences: settings of `pixel-sequences`.
        global_descriptor: settings of `global-descriptor`.
        seq_slam: settings of `seq-slam`.
    """

    features: str = "surf"
    surf: SurfConfig = field(default_factory=SurfConfig)
    vocabulary: str = ""
    descriptor: str = "hog"
    onnx: OnnxConfig = field(default_factory=OnnxConfig)
    seed: int = 0
    preset: str = "default"
    temporal: bool = True
    reference: bool = False
    view: PresentViewConfig = field(default_factory=PresentViewConfig)
    verification: CandidateVerificationConfig = field(default_factory=CandidateVerificationConfig)
    place_filter: PlaceFilterConfig = field(default_factory=PlaceFilterConfig)
    sequence_histograms: SequenceHistogramsConfig = field(default_factory=SequenceHistogramsConfig)
    dynamic_sequences: DynamicSequencesConfig = field(default_factory=DynamicSequencesConfig)
    hierarchical_places: HierarchicalPlacesConfig = field(default_factory=HierarchicalPlacesConfig)
    tracked_words: TrackedWordsConfig = field(default_factory=TrackedWordsConfig)
    pixel_sequences: PixelSequencesConfig = field(default_factory=PixelSequencesConfig)
    global_descriptor: GlobalDescriptorConfig = field(default_factory=GlobalDescriptorConfig)
    seq_slam: SeqSlamConfig = field(default_factory=SeqSlamConfig)


PRESETS = ("default", "published")
PUBLISHED_VOCABULARY = "published"  # name of the vocabulary that ships for the published presets

Builder = Callable[[ImageHistory, str, ParadigmsConfig, MatrixSink], Proposer]


def _sequence_histograms(history: ImageHistory, kind: str, config: ParadigmsConfig, rows: MatrixSink) -> Proposer:
    return make_sequence_histograms(kind, _load_vocabulary(config, kind), config.sequence_histograms, rows)


def _dynamic_sequences(history: ImageHistory, kind: str, config: ParadigmsConfig, rows: MatrixSink) -> Proposer:
    return make_dynamic_sequences(kind, _load_vocabulary(config, kind), config.dynamic_sequences, rows)


def _hierarchical_places(history: ImageHistory, kind: str, config: ParadigmsConfig, rows: MatrixSink) -> Proposer:
    return HierarchicalPlaces(history, replace(config.hierarchical_places, seed=config.seed), rows)


def _tracked_words(history: ImageHistory, kind: str, config: ParadigmsConfig, rows: MatrixSink) -> Proposer:
    return TrackedWords(config.tracked_words, rows)


def _pixel_sequences(history: ImageHistory, kind: str, config: ParadigmsConfig, rows: MatrixSink) -> Proposer:
    return PixelSequences(config.pixel_sequences, rows)


def _global_descriptor(history: ImageHistory, kind: str, config: ParadigmsConfig, rows: MatrixSink) -> Proposer:
    descriptor = make_global_descriptor(config.descriptor, config.onnx)
    descriptor.describe(np.zeros((48, 64), np.uint8))  # reports a network that cannot run now, not midway
    score = distinctness if is_learned(config.descriptor) else cosines
    return GlobalDescriptorMatching(descriptor, config.global_descriptor, rows, score)


def _seq_slam(history: ImageHistory, kind: str, config: ParadigmsConfig, rows: MatrixSink) -> Proposer:
    return SeqSlam(config.seq_slam, rows)


# The names are those of the option --paradigm. A new paradigm joins by its line here, and so do the tests of all.
PARADIGMS: dict[str, Builder] = {
    "sequence-histograms": _sequence_histograms,
    "dynamic-sequences": _dynamic_sequences,
    "hierarchical-places": _hierarchical_places,
    "tracked-words": _tracked_words,
    "pixel-sequences": _pixel_sequences,
    "global-descriptor": _global_descriptor,
    "seq-slam": _seq_slam,
}


def make_feature_extractor(config: ParadigmsConfig) -> FeatureExtractor:
    """Make the extractor of the chosen local features.

    Raises:
        ValueError: the name is unknown; the message lists the known ones.
    """
    if config.features == "surf":
        return Surf(config.surf)
    return make_extractor(config.features, config.surf.max_features)


def with_preset(name: str, config: ParadigmsConfig) -> ParadigmsConfig:
    """Return the settings with those of the published method of a name in place, where its preset asks for it.

    Settings that are not the defaults stay: features, vocabulary and descriptor may be chosen.

    Raises:
        ValueError: the preset is unknown; the message lists the known ones.
    """
    if config.preset not in PRESETS:
        raise ValueError(f"unknown preset '{config.preset}': expected one of {', '.join(PRESETS)}")
    if config.preset == "default":
        return config
    if name in ("sequence-histograms", "dynamic-sequences") and config.features == "surf" and not config.vocabulary:
        config = replace(config, features="brief", vocabulary=PUBLISHED_VOCABULARY)
    return replace(
        config,
        sequence_histograms=published.sequence_histograms(),
        dynamic_sequences=published.dynamic_sequences(),
        hierarchical_places=published.hierarchical_places(),
        tracked_words=published.tracked_words(),
        pixel_sequences=published.pixel_sequences(),
        global_descriptor=GlobalDescriptorConfig(max_candidates=1),
        seq_slam=SeqSlamConfig(max_candidates=1),
    )


def exclusion_s(name: str, config: ParadigmsConfig) -> float:
    """Return the age below which the preset of a paradigm matches no image, seconds; 0 where it has no such rule."""
    return published.DECISIONS[name].min_exclusion_s if config.preset == "published" else 0.0


def make_recognizer(
    name: str, features: FeatureCache, config: ParadigmsConfig | None = None, rows: MatrixSink | None = None
) -> StagedRecognizer:
    """Make a recogniser that has seen nothing.

    Args:
        name: a key of PARADIGMS.
        features: local features, shared with other users of the same images.
        config: settings; the defaults if None.
        rows: receives the rows of the similarity matrix.

    Raises:
        ValueError: the name is unknown, or the vocabulary or descriptor file cannot be used; the message names it.
    """
    if name not in PARADIGMS:
        raise ValueError(f"unknown paradigm '{name}': expected one of {', '.join(PARADIGMS)}")
    config = with_preset(name, config or ParadigmsConfig())
    history = ImageHistory()
    proposer = PARADIGMS[name](history, features.kind, config, RowsById(history, rows))
    return _stages(name, features, history, proposer, config)


def make_control(features: FeatureCache, config: ParadigmsConfig | None = None) -> StagedRecognizer:
    """Make the control of every paradigm: a recogniser that proposes random earlier images to the same stages."""
    config = config or ParadigmsConfig()
    return _stages("random-images", features, ImageHistory(), RandomImages(config.seed), config)


def _stages(
    name: str, features: FeatureCache, history: ImageHistory, proposer: Proposer, config: ParadigmsConfig
) -> StagedRecognizer:
    verification = replace(config.verification, epipolar=replace(config.verification.epipolar, seed=config.seed))
    if features.kind.startswith(LEARNED_KIND):
        verification = replace(verification, max_ratio=verification.max_learned_ratio)
    if config.preset == "published":
        epipolar = replace(verification.epipolar, min_inliers=MINIMAL_SAMPLE + 1)  # the decision has its own number
        exact = replace(verification, max_candidates=1, refine_radius=0, epipolar=epipolar)
        thresholds = published.DECISIONS.get(name, published.CONTROL)
        if not config.temporal:
            thresholds = replace(thresholds, min_consistent_frames=1)
        window = FixedPast(-1) if config.reference else FixedWindow(history, config.view.exclusion_frames)
        return StagedRecognizer(
            features, history, window, proposer, published.PublishedDecision(history, thresholds), exact
        )
    decision: Decision = GeometricDecision(history, verification)
    is_network = name == "global-descriptor" and is_learned(config.descriptor)
    if config.temporal and is_network:
        decision = SmoothedDecision(history, LEARNED_SCORE, config.place_filter, verification, LEARNED_WEIGHTS)
    elif config.temporal:
        decision = SmoothedDecision(history, OWN_SCORES[name], config.place_filter, verification)
    # A reference is only mapped, unless its own revisits tell which of its images show one place.
    learns_places = config.temporal and name != "random-images"
    view = FixedPast(-1) if config.reference and not learns_places else PresentView(history, config.view)
    return StagedRecognizer(features, history, view, proposer, decision, verification)


def with_exclusion(config: ParadigmsConfig, images: int) -> ParadigmsConfig:
    """Return the settings with an exclusion window: images nearer than `images` to the query are never matched.

    It adds to what the present view excludes.
    """
    return replace(config, view=replace(config.view, exclusion_frames=images))


def _load_vocabulary(config: ParadigmsConfig, kind: str) -> Vocabulary:
    """The chosen vocabulary, checked against the kind of the features.

    Raises:
        ValueError: the file is missing, damaged or of another kind; the message names it.
    """
    if not config.vocabulary:
        return default_vocabulary().require(kind)
    if config.vocabulary == PUBLISHED_VOCABULARY:
        return published_vocabulary().require(kind)
    vocabulary = load_vocabulary(Path(config.vocabulary))
    try:
        return vocabulary.require(kind)
    except ValueError as error:
        raise ValueError(f"{config.vocabulary}: {error}") from error
