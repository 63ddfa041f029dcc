"""All paradigms by name, and the configuration from which any of them is built."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from place_recognition.image_processing.extractors import make_extractor
from place_recognition.image_processing.features import FeatureCache, FeatureExtractor
from place_recognition.image_processing.global_descriptors import make_global_descriptor
from place_recognition.image_processing.surf import Surf, SurfConfig
from place_recognition.map.vocabulary import Vocabulary, default_vocabulary, load_vocabulary
from place_recognition.paradigms.dynamic_sequences import DynamicSequences, DynamicSequencesConfig
from place_recognition.paradigms.global_descriptor import GlobalDescriptorConfig, GlobalDescriptorMatching
from place_recognition.paradigms.hierarchical_places import HierarchicalPlaces, HierarchicalPlacesConfig
from place_recognition.paradigms.pixel_sequences import PixelSequences, PixelSequencesConfig
from place_recognition.paradigms.sequence_histograms import SequenceHistograms, SequenceHistogramsConfig
from place_recognition.paradigms.tracked_words import TrackedWords, TrackedWordsConfig
from place_recognition.recognizer import PlaceRecognizer, RowSink


@dataclass(frozen=True)
class ParadigmsConfig:
    """Settings of every paradigm; only those of the chosen one matter.

    Attributes:
        features: local features, by name in EXTRACTORS; a vocabulary serves only those it was made of.
        surf: how the default ones are found; of the others, how many.
        vocabulary: path of a vocabulary file for the paradigms that need one; empty for the general one.
        descriptor: of `global-descriptor`: "hog" or another of GLOBAL_DESCRIPTORS, or "onnx:FILE" for a learned one.
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


Builder = Callable[[FeatureCache, ParadigmsConfig, RowSink | None], PlaceRecognizer]


def _sequence_histograms(features: FeatureCache, config: ParadigmsConfig, rows: RowSink | None) -> PlaceRecognizer:
    return SequenceHistograms(features, _vocabulary(config, features.kind), config.sequence_histograms, rows)


def _dynamic_sequences(features: FeatureCache, config: ParadigmsConfig, rows: RowSink | None) -> PlaceRecognizer:
    return DynamicSequences(features, _vocabulary(config, features.kind), config.dynamic_sequences, rows)


def _hierarchical_places(features: FeatureCache, config: ParadigmsConfig, rows: RowSink | None) -> PlaceRecognizer:
    return HierarchicalPlaces(features, config.hierarchical_places, rows)


def _tracked_words(features: FeatureCache, config: ParadigmsConfig, rows: RowSink | None) -> PlaceRecognizer:
    return TrackedWords(features, config.tracked_words, rows)


def _pixel_sequences(features: FeatureCache, config: ParadigmsConfig, rows: RowSink | None) -> PlaceRecognizer:
    return PixelSequences(config.pixel_sequences, rows)


def _global_descriptor(features: FeatureCache, config: ParadigmsConfig, rows: RowSink | None) -> PlaceRecognizer:
    descriptor = make_global_descriptor(config.descriptor)
    descriptor.describe(np.zeros((48, 64), np.uint8))  # a network that does not run is refused here, not midway
    return GlobalDescriptorMatching(descriptor, config.global_descriptor, rows)


PARADIGMS: dict[str, Builder] = {
    "sequence-histograms": _sequence_histograms,
    "dynamic-sequences": _dynamic_sequences,
    "hierarchical-places": _hierarchical_places,
    "tracked-words": _tracked_words,
    "pixel-sequences": _pixel_sequences,
    "global-descriptor": _global_descriptor,
}


def local_features(config: ParadigmsConfig) -> FeatureExtractor:
    """The extractor of the local features that were chosen.

    Raises:
        ValueError: an unknown name; the message lists the known ones.
    """
    if config.features == "surf":
        return Surf(config.surf)
    return make_extractor(config.features, config.surf.max_features)


def build(
    name: str, features: FeatureCache, config: ParadigmsConfig | None = None, rows: RowSink | None = None
) -> PlaceRecognizer:
    """A recogniser that has seen nothing.

    Args:
        name: a key of PARADIGMS.
        features: shared with the rest of the chain; paradigms of whole images do without.
        config: settings.
        rows: takes the rows of its matrix.

    Raises:
        ValueError: an unknown name, or a vocabulary or descriptor file that cannot serve; the message says which.
    """
    if name not in PARADIGMS:
        raise ValueError(f"unknown paradigm '{name}': expected one of {', '.join(PARADIGMS)}")
    return PARADIGMS[name](features, config or ParadigmsConfig(), rows)


def excluding(config: ParadigmsConfig, images: int) -> ParadigmsConfig:
    """The same settings, but no paradigm may match images nearer than so many to the latest one.

    A paradigm's own guard stays.
    """
    return _replaced(config, images)


def _replaced(settings: Any, images: int) -> Any:
    """Settings in which everything that knows of an exclusion has this one, wherever it stands."""
    if not dataclasses.is_dataclass(settings) or isinstance(settings, type):
        return settings
    inner = {item.name: getattr(settings, item.name) for item in dataclasses.fields(settings)}
    changed = {
        name: images if name == "exclusion_frames" else _replaced(value, images) for name, value in inner.items()
    }
    return replace(settings, **changed)


def _vocabulary(config: ParadigmsConfig, kind: str) -> Vocabulary:
    """The vocabulary that was chosen, of the kind that the features are.

    Raises:
        ValueError: it is missing, damaged or of another kind; the message names the file.
    """
    if not config.vocabulary:
        return default_vocabulary().require(kind)
    vocabulary = load_vocabulary(Path(config.vocabulary))
    try:
        return vocabulary.require(kind)
    except ValueError as error:
        raise ValueError(f"{config.vocabulary}: {error}") from error
