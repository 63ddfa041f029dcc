"""Registry of the paradigms: makes any of them by its name."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from place_recognition.image_processing.global_descriptors import make_global_descriptor
from place_recognition.image_processing.local_features import FeatureCache, FeatureExtractor
from place_recognition.image_processing.registry import make_extractor
from place_recognition.image_processing.surf import Surf, SurfConfig
from place_recognition.paradigms.global_descriptor import GlobalDescriptorConfig, GlobalDescriptorMatching
from place_recognition.paradigms.hierarchical_places import HierarchicalPlaces, HierarchicalPlacesConfig
from place_recognition.paradigms.pixel_sequences import PixelSequences, PixelSequencesConfig
from place_recognition.paradigms.sequence_paradigms import (
    DynamicSequencesConfig,
    SequenceHistogramsConfig,
    make_dynamic_sequences,
    make_sequence_histograms,
)
from place_recognition.paradigms.sequence_recognizer import SequenceMatchingConfig
from place_recognition.paradigms.tracked_words import TrackedWords, TrackedWordsConfig
from place_recognition.recognizer import MatrixSink, PlaceRecognizer
from place_recognition.vocabulary.vocabulary import Vocabulary, default_vocabulary, load_vocabulary


@dataclass(frozen=True)
class ParadigmsConfig:
    """Settings of all paradigms; only those of the chosen one matter.

    Attributes:
        features: name of the local features, a key of EXTRACTORS. A vocabulary works only with the features from which
            it was trained.
        surf: settings of the default features; for other features only their number counts.
        vocabulary: path of a vocabulary file for the paradigms of sequences; empty for the general vocabulary.
        descriptor: descriptor of `global-descriptor`: a key of GLOBAL_DESCRIPTORS, such as "hog", or "onnx:FILE" for a
            learned one.
        sequence_histograms: settings of `sequence-histograms`.
        dynamic_sequences: settings of `dynamic-sequences`.
        hierarchical_places: settings of `hierarchical-places`.
        tracked_words: settings of `tracked-words`.
        pixel_sequences: settings of `pixel-sequences`.
        global_descriptor: settings of `global-descriptor`.
    """

    features: str = "surf"
    surf: SurfConfig = field(default_factory=SurfConfig)
    vocabulary: str = ""
    descriptor: str = "hog"
    sequence_histograms: SequenceHistogramsConfig = field(default_factory=SequenceHistogramsConfig)
    dynamic_sequences: DynamicSequencesConfig = field(default_factory=DynamicSequencesConfig)
    hierarchical_places: HierarchicalPlacesConfig = field(default_factory=HierarchicalPlacesConfig)
    tracked_words: TrackedWordsConfig = field(default_factory=TrackedWordsConfig)
    pixel_sequences: PixelSequencesConfig = field(default_factory=PixelSequencesConfig)
    global_descriptor: GlobalDescriptorConfig = field(default_factory=GlobalDescriptorConfig)


# Settings that hold those of the exclusion window, directly or one level below.
SequencesT = TypeVar("SequencesT", SequenceHistogramsConfig, DynamicSequencesConfig)
HistoryT = TypeVar("HistoryT", HierarchicalPlacesConfig, TrackedWordsConfig, SequenceMatchingConfig)
WindowT = TypeVar("WindowT", PixelSequencesConfig, GlobalDescriptorConfig)

Builder = Callable[[FeatureCache, ParadigmsConfig, MatrixSink | None], PlaceRecognizer]


def _sequence_histograms(features: FeatureCache, config: ParadigmsConfig, rows: MatrixSink | None) -> PlaceRecognizer:
    return make_sequence_histograms(features, _load_vocabulary(config, features.kind), config.sequence_histograms, rows)


def _dynamic_sequences(features: FeatureCache, config: ParadigmsConfig, rows: MatrixSink | None) -> PlaceRecognizer:
    return make_dynamic_sequences(features, _load_vocabulary(config, features.kind), config.dynamic_sequences, rows)


def _hierarchical_places(features: FeatureCache, config: ParadigmsConfig, rows: MatrixSink | None) -> PlaceRecognizer:
    return HierarchicalPlaces(features, config.hierarchical_places, rows)


def _tracked_words(features: FeatureCache, config: ParadigmsConfig, rows: MatrixSink | None) -> PlaceRecognizer:
    return TrackedWords(features, config.tracked_words, rows)


def _pixel_sequences(features: FeatureCache, config: ParadigmsConfig, rows: MatrixSink | None) -> PlaceRecognizer:
    return PixelSequences(config.pixel_sequences, rows)


def _global_descriptor(features: FeatureCache, config: ParadigmsConfig, rows: MatrixSink | None) -> PlaceRecognizer:
    descriptor = make_global_descriptor(config.descriptor)
    descriptor.describe(np.zeros((48, 64), np.uint8))  # reports a network that cannot run now, not midway
    return GlobalDescriptorMatching(descriptor, config.global_descriptor, rows)


# The names are those of the option --paradigm. A new paradigm joins by its line here, and so do the tests of all.
PARADIGMS: dict[str, Builder] = {
    "sequence-histograms": _sequence_histograms,
    "dynamic-sequences": _dynamic_sequences,
    "hierarchical-places": _hierarchical_places,
    "tracked-words": _tracked_words,
    "pixel-sequences": _pixel_sequences,
    "global-descriptor": _global_descriptor,
}


def make_feature_extractor(config: ParadigmsConfig) -> FeatureExtractor:
    """Make the extractor of the chosen local features.

    Raises:
        ValueError: the name is unknown; the message lists the known ones.
    """
    if config.features == "surf":
        return Surf(config.surf)
    return make_extractor(config.features, config.surf.max_features)


def make_recognizer(
    name: str, features: FeatureCache, config: ParadigmsConfig | None = None, rows: MatrixSink | None = None
) -> PlaceRecognizer:
    """Make a recogniser that has seen nothing.

    Args:
        name: a key of PARADIGMS.
        features: local features, shared with other users of the same images; paradigms of whole images ignore them.
        config: settings; the defaults if None.
        rows: receives the rows of the similarity matrix.

    Raises:
        ValueError: the name is unknown, or the vocabulary or descriptor file cannot be used; the message names it.
    """
    if name not in PARADIGMS:
        raise ValueError(f"unknown paradigm '{name}': expected one of {', '.join(PARADIGMS)}")
    return PARADIGMS[name](features, config or ParadigmsConfig(), rows)


def with_exclusion(config: ParadigmsConfig, images: int) -> ParadigmsConfig:
    """Return the settings with an exclusion window: images nearer than `images` to the query are never matched.

    It adds to each paradigm's own choice of what is too recent.
    """
    return replace(
        config,
        sequence_histograms=_exclude_from_matching(config.sequence_histograms, images),
        dynamic_sequences=_exclude_from_matching(config.dynamic_sequences, images),
        hierarchical_places=_exclude_from_history(config.hierarchical_places, images),
        tracked_words=_exclude_from_history(config.tracked_words, images),
        pixel_sequences=_exclude_from_window(config.pixel_sequences, images),
        global_descriptor=_exclude_from_window(config.global_descriptor, images),
    )


def with_seed(config: ParadigmsConfig, seed: int) -> ParadigmsConfig:
    """Return the settings with the seed of a run in every random generator."""
    return replace(config, hierarchical_places=replace(config.hierarchical_places, seed=seed))


def _exclude_from_matching(settings: SequencesT, images: int) -> SequencesT:
    return replace(settings, matching=_exclude_from_history(settings.matching, images))


def _exclude_from_history(settings: HistoryT, images: int) -> HistoryT:
    return replace(settings, history=replace(settings.history, exclusion_frames=images))


def _exclude_from_window(settings: WindowT, images: int) -> WindowT:
    return replace(settings, exclusion_window=replace(settings.exclusion_window, exclusion_frames=images))


def _load_vocabulary(config: ParadigmsConfig, kind: str) -> Vocabulary:
    """The chosen vocabulary, checked against the kind of the features.

    Raises:
        ValueError: the file is missing, damaged or of another kind; the message names it.
    """
    if not config.vocabulary:
        return default_vocabulary().require(kind)
    vocabulary = load_vocabulary(Path(config.vocabulary))
    try:
        return vocabulary.require(kind)
    except ValueError as error:
        raise ValueError(f"{config.vocabulary}: {error}") from error
