"""ORB by OpenCV: corners at several scales, described by 256 comparisons of brightness along their direction.

Rublee, Rabaud, Konolige, Bradski, 'ORB: An Efficient Alternative to SIFT or SURF', ICCV 2011.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.features import LocalFeatures, check_gray
from place_recognition.image_processing.opencv_features import convert_keypoints, select_spread
from place_recognition.image_processing.spread import SpreadConfig

BITS = 256
PATCH = 31  # side of the described square in the first level, pixels; smaller images have no features
CANDIDATES = 3  # times the wanted features that are described, to choose evenly spread ones from

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class OrbConfig:
    """How many corners.

    Attributes:
        features: at most so many an image.
        contrast: of a corner to the circle around it, at least, grey levels.
        levels: sizes of the image, each 1.2 times smaller than the one before.
        spread: how they are spread over the image.
    """

    features: int = 500
    contrast: int = 10
    levels: int = 8
    spread: SpreadConfig = field(default_factory=SpreadConfig)


class Orb:
    """Extracts ORB features (a FeatureExtractor).

    Bits travel as numbers of +-1/16, a vector of unit length: two that differ in h of 256 bits are sqrt(h) / 8 apart.
    """

    kind = "orb-256"

    def __init__(self, config: OrbConfig | None = None) -> None:
        self.config = config or OrbConfig()
        self._orb = cv2.ORB.create(
            CANDIDATES * self.config.features,
            nlevels=self.config.levels,
            fastThreshold=self.config.contrast,
            patchSize=PATCH,
        )

    def extract(self, image: NDArray[np.uint8]) -> LocalFeatures:
        """Features of a grey image (H, W) uint8, strongest first; none of a blank or tiny one."""
        check_gray(image)
        points, described = self._orb.detectAndCompute(image, None) if min(image.shape) > PATCH else ((), None)
        descriptors = unpack_bits(np.empty((0, BITS // 8), np.uint8) if described is None else described)
        # the circle of comparisons ends at about three sigmas of the smoothing that a blob of its size would need
        found = convert_keypoints(points, descriptors, sigmas_per_size=1 / 6)
        return select_spread(found, image.shape, self.config.features, self.config.spread)


def unpack_bits(packed: NDArray[np.uint8]) -> Floats:
    """Descriptors (N, 256) float32 of +-1/16 from their bits (N, 32)."""
    return (np.unpackbits(packed, axis=1).astype(np.float32) * 2 - 1) / np.float32(16)
