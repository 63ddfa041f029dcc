"""All paradigms by name, and the configuration from which any of them is built."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from place_recognition.image_processing.features import SharedFeatures
from place_recognition.image_processing.surf import SurfConfig
from place_recognition.paradigms.tracked_words import TrackedWords, TrackedWordsConfig
from place_recognition.recognizer import PlaceRecognizer, RowSink


@dataclass(frozen=True)
class ParadigmsConfig:
    """Settings of every paradigm; only those of the chosen one matter.

    Attributes:
        features: how local features are found.
        vocabulary: path of a vocabulary file for the paradigms that need one; empty for the general one.
        descriptor: of `global-descriptor`: "hog", or "onnx:FILE" for a learned one.
    """

    features: SurfConfig = field(default_factory=SurfConfig)
    vocabulary: str = ""
    descriptor: str = "hog"
    tracked_words: TrackedWordsConfig = field(default_factory=TrackedWordsConfig)


Builder = Callable[[SharedFeatures, ParadigmsConfig, RowSink | None], PlaceRecognizer]

PARADIGMS: dict[str, Builder] = {
    "tracked-words": lambda features, config, rows: TrackedWords(features, config.tracked_words, rows),
}


def build(
    name: str, features: SharedFeatures, config: ParadigmsConfig | None = None, rows: RowSink | None = None
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
    changed = {}
    for item in dataclasses.fields(config):
        settings = getattr(config, item.name)
        if hasattr(settings, "route"):
            changed[item.name] = replace(settings, route=replace(settings.route, exclusion=images))
    return replace(config, **changed)
