"""Registry of the extractors of local features by name."""

from collections.abc import Callable

from place_recognition.image_processing.fast_and_brief import Brief, BriefConfig
from place_recognition.image_processing.local_features import FeatureExtractor
from place_recognition.image_processing.orb_and_sift import Orb, OrbConfig, Sift, SiftConfig
from place_recognition.image_processing.surf import Surf, SurfConfig

EXTRACTORS: dict[str, Callable[[int], FeatureExtractor]] = {
    "surf": lambda features: Surf(SurfConfig(features)),
    "surf-oriented": lambda features: Surf(SurfConfig(features, oriented=True)),
    "sift": lambda features: Sift(SiftConfig(features)),
    "orb": lambda features: Orb(OrbConfig(features)),
    "brief": lambda features: Brief(BriefConfig(features)),
}


def make_extractor(name: str, features: int = 500) -> FeatureExtractor:
    """Make the extractor of a name.

    Args:
        name: a key of EXTRACTORS.
        features: maximum number of features of an image.

    Raises:
        ValueError: the name is unknown; the message lists the known ones.
    """
    if name not in EXTRACTORS:
        raise ValueError(f"unknown local features '{name}': expected one of {', '.join(EXTRACTORS)}")
    return EXTRACTORS[name](features)
