"""The local features by name: the one place where names become extractors."""

from collections.abc import Callable

from place_recognition.image_processing.features import FeatureExtractor
from place_recognition.image_processing.orb import Orb, OrbConfig
from place_recognition.image_processing.sift import Sift, SiftConfig
from place_recognition.image_processing.surf import Surf, SurfConfig

EXTRACTORS: dict[str, Callable[[int], FeatureExtractor]] = {
    "surf": lambda features: Surf(SurfConfig(features)),
    "surf-oriented": lambda features: Surf(SurfConfig(features, oriented=True)),
    "sift": lambda features: Sift(SiftConfig(features)),
    "orb": lambda features: Orb(OrbConfig(features)),
}


def make_extractor(name: str, features: int = 500) -> FeatureExtractor:
    """The extractor of this name, for at most so many features an image.

    Raises:
        ValueError: there is none; the message lists those that there are.
    """
    if name not in EXTRACTORS:
        raise ValueError(f"unknown local features '{name}': expected one of {', '.join(EXTRACTORS)}")
    return EXTRACTORS[name](features)
