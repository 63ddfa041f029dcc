"""ORB features by OpenCV: corners at several scales, described by 256 comparisons of brightness.

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
CANDIDATES = 3  # described features for each wanted one, from which evenly spread ones are selected

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class OrbConfig:
    """Number and contrast of the corners.

    Attributes:
        max_features: maximum number of features of an image.
        min_contrast: minimum contrast of a corner to the circle around it, gray levels.
        levels: number of pyramid levels, each 1.2 times smaller than the one before.
        spread: distribution of the features over the image.
    """

    max_features: int = 500
    min_contrast: int = 10
    levels: int = 8
    spread: SpreadConfig = field(default_factory=SpreadConfig)


class Orb:
    """Extracts ORB features (a FeatureExtractor).

    Bits become numbers of +-1/16, a vector of unit length: two that differ in h of 256 bits are sqrt(h) / 8 apart.
    """

    kind = "orb-256"

    def __init__(self, config: OrbConfig | None = None) -> None:
        self.config = config or OrbConfig()
        self._orb = cv2.ORB.create(
            CANDIDATES * self.config.max_features,
            nlevels=self.config.levels,
            fastThreshold=self.config.min_contrast,
            patchSize=PATCH,
        )

    def extract(self, image: NDArray[np.uint8]) -> LocalFeatures:
        """Extract the features of a gray image (H, W) uint8, strongest first; a blank or tiny one has none."""
        check_gray(image)
        points, described = self._orb.detectAndCompute(image, None) if min(image.shape) > PATCH else ((), None)
        descriptors = unpack_bits(np.empty((0, BITS // 8), np.uint8) if described is None else described)
        # the circle of comparisons ends at about three sigmas of the smoothing that a blob of its size would need
        found = convert_keypoints(points, descriptors, sigmas_per_size=1 / 6)
        return select_spread(found, image.shape, self.config.max_features, self.config.spread)


def unpack_bits(packed: NDArray[np.uint8]) -> Floats:
    """Convert bits (N, 32) to descriptors (N, 256) float32 of +-1/16."""
    return (np.unpackbits(packed, axis=1).astype(np.float32) * 2 - 1) / np.float32(16)
