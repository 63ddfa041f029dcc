"""Local features by OpenCV: ORB and SIFT.

* ORB: corners at several scales, described by 256 comparisons of brightness. Rublee, Rabaud, Konolige, Bradski, 'ORB:
  An Efficient Alternative to SIFT or SURF', ICCV 2011.
* SIFT: blobs of the difference of Gaussians, described by histograms of gradients. Lowe, 'Distinctive Image Features
  from Scale-Invariant Keypoints', IJCV 60(2) 2004.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import LocalFeatures, SpreadConfig, check_gray, select_strongest

Floats = NDArray[np.float32]

ORB_BITS = 256
ORB_PATCH_PX = 31  # side of the described square in the first level; smaller images have no features
# Described features for each wanted one, from which evenly spread ones are selected.
ORB_CANDIDATES = 3
SIFT_CANDIDATES = 2


@dataclass(frozen=True)
class OrbConfig:
    """Number and contrast of the corners.

    Attributes:
        max_features: maximum number of features of an image.
        min_contrast: minimum contrast of a corner to the circle around it, grey levels.
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
            ORB_CANDIDATES * self.config.max_features,
            nlevels=self.config.levels,
            fastThreshold=self.config.min_contrast,
            patchSize=ORB_PATCH_PX,
        )

    def extract(self, image: NDArray[np.uint8], mask: NDArray[np.uint8] | None = None) -> LocalFeatures:
        """Extract the features of a grey image (H, W) uint8, strongest first; a blank or tiny one has none.

        A mask (H, W) leaves out the pixels where it is 0.
        """
        check_gray(image)
        points, described = self._orb.detectAndCompute(image, mask) if min(image.shape) > ORB_PATCH_PX else ((), None)
        descriptors = unpack_bits(np.empty((0, ORB_BITS // 8), np.uint8) if described is None else described)
        # the circle of comparisons ends at about three sigmas of the smoothing that a blob of its size would need
        found = convert_keypoints(points, descriptors, sigmas_per_size=1 / 6)
        return select_spread(found, image.shape, self.config.max_features, self.config.spread)


@dataclass(frozen=True)
class SiftConfig:
    """Number and contrast of the blobs, and the size of the image.

    Attributes:
        max_features: maximum number of features of an image.
        min_contrast: minimum difference of Gaussians, as OpenCV scales it.
        shrink_factor: factor by which the image is reduced first. Two takes a third of the time, and leaves as many
            correct matches of 1241 x 376 images, since the smallest blobs change most.
        spread: distribution of the features over the image.
    """

    max_features: int = 500
    min_contrast: float = 0.02
    shrink_factor: float = 2.0
    spread: SpreadConfig = field(default_factory=SpreadConfig)


class Sift:
    """Extracts SIFT features (a FeatureExtractor)."""

    kind = "sift-128"

    def __init__(self, config: SiftConfig | None = None) -> None:
        self.config = config or SiftConfig()
        # without the precise upscale all features lie a quarter of a pixel off
        self._sift = cv2.SIFT.create(
            SIFT_CANDIDATES * self.config.max_features,
            contrastThreshold=self.config.min_contrast,
            enable_precise_upscale=True,
        )

    def extract(self, image: NDArray[np.uint8], mask: NDArray[np.uint8] | None = None) -> LocalFeatures:
        """Extract the features of a grey image (H, W) uint8, strongest first; a blank or tiny one has none.

        A mask (H, W) leaves out the pixels where it is 0.
        """
        check_gray(image)
        size = [max(round(side / self.config.shrink_factor), 1) for side in image.shape[::-1]]
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        small_mask = None if mask is None else cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST)
        points, described = self._sift.detectAndCompute(small, small_mask)
        if len(points) == 0:
            described = np.empty((0, 128), np.float32)
        lengths = np.linalg.norm(described, axis=1, keepdims=True)
        found = convert_keypoints(points, described / np.maximum(lengths, 1e-12), sigmas_per_size=0.5)
        return select_spread(
            _enlarge(found, small.shape, image.shape), image.shape, self.config.max_features, self.config.spread
        )


def convert_keypoints(points: Sequence[cv2.KeyPoint], descriptors: Floats, sigmas_per_size: float) -> LocalFeatures:
    """Convert key points with their descriptors.

    Args:
        points: N key points.
        descriptors: (N, D) descriptors of unit length.
        sigmas_per_size: factor from the size of a key point to the sigma of a Gaussian.
    """
    pixels = np.array([point.pt for point in points], np.float32).reshape(-1, 2)
    sizes = np.array([point.size for point in points], np.float32)
    responses = np.array([point.response for point in points], np.float32)
    return LocalFeatures(pixels, np.float32(sigmas_per_size) * sizes, responses, descriptors)


def select_spread(features: LocalFeatures, shape: tuple[int, ...], count: int, config: SpreadConfig) -> LocalFeatures:
    """Keep at most `count` of the strongest features of an image (H, W), evenly spread, strongest first."""
    kept = select_strongest(features.pixels, features.responses, (shape[0], shape[1]), count, config)
    return LocalFeatures(
        features.pixels[kept], features.scales[kept], features.responses[kept], features.descriptors[kept]
    )


def unpack_bits(packed: NDArray[np.uint8]) -> Floats:
    """Convert bits (N, 32) to descriptors (N, 256) float32 of +-1/16."""
    return (np.unpackbits(packed, axis=1).astype(np.float32) * 2 - 1) / np.float32(16)


def _enlarge(features: LocalFeatures, small: tuple[int, ...], shape: tuple[int, ...]) -> LocalFeatures:
    """Scale the features of a reduced image (h, w) to the image (H, W) that it was made from."""
    factors = np.array([shape[1] / small[1], shape[0] / small[0]], np.float32)
    # pixel centres are at integers: the first pixel of the small image spans several, whose middle is not 0
    half = np.float32(0.5)
    return replace(features, pixels=(features.pixels + half) * factors - half, scales=features.scales * factors.mean())
