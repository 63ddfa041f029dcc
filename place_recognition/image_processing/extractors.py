"""Extractors of local features by name: SURF, and by OpenCV ORB, SIFT and FAST with BRIEF.

* ORB: corners at several scales, described by 256 comparisons of brightness. Rublee, Rabaud, Konolige, Bradski, 'ORB:
  An Efficient Alternative to SIFT or SURF', ICCV 2011.
* SIFT: blobs of the difference of Gaussians, described by histograms of gradients. Lowe, 'Distinctive Image Features
  from Scale-Invariant Keypoints', IJCV 60(2) 2004.
* FAST: pixels that differ from an arc of the circle around them. Rosten, Drummond, 'Machine Learning for High-Speed
  Corner Detection', ECCV 2006. By OpenCV.
* BRIEF: 256 comparisons of brightness at fixed places around a corner, upright and at one scale. Calonder, Lepetit,
  Strecha, Fua, 'BRIEF: Binary Robust Independent Elementary Features', ECCV 2010. OpenCV's own is in a module that its
  packages do not contain. FAST corners with BRIEF are the features of the published presets of both sequence paradigms.
"""

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import NormalDist

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import (
    FeatureExtractor,
    LocalFeatures,
    SpreadConfig,
    check_gray,
    select_spread,
)
from place_recognition.image_processing.onnx_features import OnnxFeatures, OnnxFeaturesConfig
from place_recognition.image_processing.onnx_network import ONNX
from place_recognition.image_processing.surf import Surf, SurfConfig

Floats = NDArray[np.float32]
Integers = NDArray[np.int64]
Bytes = NDArray[np.uint8]

ORB_BITS = 256
ORB_PATCH_PX = 31  # side of the described square in the first level; smaller images have no features
# Described features for each wanted one, from which evenly spread ones are selected.
ORB_CANDIDATES = 3
SIFT_CANDIDATES = 2

BRIEF_BITS = 256
BRIEF_PATCH_PX = 31  # side of the square of all comparisons
BRIEF_SMOOTHING_PX = 9  # side of the Gaussian's window; a single pixel is too noisy to compare
BRIEF_SMOOTHING_SIGMA_PX = 2.0


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


def unpack_bits(packed: NDArray[np.uint8]) -> Floats:
    """Convert bits (N, 32) to descriptors (N, 256) float32 of +-1/16."""
    return (np.unpackbits(packed, axis=1).astype(np.float32) * 2 - 1) / np.float32(16)


def _enlarge(features: LocalFeatures, small: tuple[int, ...], shape: tuple[int, ...]) -> LocalFeatures:
    """Scale the features of a reduced image (h, w) to the image (H, W) that it was made from."""
    factors = np.array([shape[1] / small[1], shape[0] / small[0]], np.float32)
    # pixel centres are at integers: the first pixel of the small image spans several, whose middle is not 0
    half = np.float32(0.5)
    return replace(features, pixels=(features.pixels + half) * factors - half, scales=features.scales * factors.mean())


@dataclass(frozen=True)
class BriefConfig:
    """Number and contrast of the corners.

    Attributes:
        max_features: maximum number of features of an image.
        min_contrast: minimum contrast of a corner to the circle around it, grey levels.
    """

    max_features: int = 300
    min_contrast: int = 10


class Brief:
    """Extracts FAST corners with BRIEF descriptors (a FeatureExtractor).

    The strongest corners, wherever they are, as the papers take them. Bits become numbers of +-1/16, a vector of unit
    length.
    """

    kind = "brief-256"

    def __init__(self, config: BriefConfig | None = None) -> None:
        self.config = config or BriefConfig()
        # With one level and FAST's score, OpenCV's ORB is FAST that sorts its corners before they become objects.
        self._fast = cv2.ORB.create(
            self.config.max_features,
            nlevels=1,
            edgeThreshold=BRIEF_PATCH_PX // 2 + 1,
            patchSize=BRIEF_PATCH_PX,
            scoreType=cv2.ORB_FAST_SCORE,
            fastThreshold=self.config.min_contrast,
        )

    def extract(self, image: NDArray[np.uint8], mask: NDArray[np.uint8] | None = None) -> LocalFeatures:
        """Extract the features of a grey image (H, W) uint8, strongest first; a blank or tiny one has none.

        A mask (H, W) leaves out the pixels where it is 0.
        """
        check_gray(image)
        points = self._fast.detect(image, mask) if min(image.shape) > BRIEF_PATCH_PX + 1 else ()
        responses = np.array([point.response for point in points], np.float32)
        kept = np.argsort(-responses, kind="stable")[: self.config.max_features]
        pixels = np.array([points[k].pt for k in kept], np.float32).reshape(-1, 2)
        # The comparisons have a sigma of a fifth of the patch, as wide as those of ORB at its first level.
        scales = np.full(len(kept), BRIEF_PATCH_PX / 6, np.float32)
        return LocalFeatures(pixels, scales, responses[kept], unpack_bits(_describe(image, pixels.astype(np.int64))))


def _describe(image: Bytes, pixels: Integers) -> Bytes:
    """Pack the comparisons (N, 32) around pixels (N, 2) half a patch from the edge: 1 where the first is darker."""
    smooth = cv2.GaussianBlur(image, (BRIEF_SMOOTHING_PX, BRIEF_SMOOTHING_PX), BRIEF_SMOOTHING_SIGMA_PX)
    steps = np.array([1, image.shape[1]])  # to the next pixel to the right and below, in the flat image
    centers, pattern = pixels @ steps, BRIEF_PATTERN @ steps
    first, second = (smooth.ravel()[centers[:, None] + pattern[:, k]] for k in range(2))
    return np.packbits(first < second, axis=1)


def _make_pattern() -> Integers:
    """Draw the comparisons (256, 2, 2) of two places x, y each, normally distributed (the paper's G II)."""
    # Python promises the sequence of random() for ever, numpy that of no distribution; words must not change with it.
    uniform, normal = random.Random(0), NormalDist(sigma=BRIEF_PATCH_PX / 5)
    drawn = np.round([normal.inv_cdf(uniform.random()) for _ in range(4 * BRIEF_BITS)])
    return np.clip(drawn, -(BRIEF_PATCH_PX // 2), BRIEF_PATCH_PX // 2).astype(np.int64).reshape(BRIEF_BITS, 2, 2)


BRIEF_PATTERN = _make_pattern()

EXTRACTORS: dict[str, Callable[[int], FeatureExtractor]] = {
    "surf": lambda features: Surf(SurfConfig(features)),
    "surf-oriented": lambda features: Surf(SurfConfig(features, oriented=True)),
    "sift": lambda features: Sift(SiftConfig(features)),
    "orb": lambda features: Orb(OrbConfig(features)),
    "brief": lambda features: Brief(BriefConfig(features)),
}


def is_extractor(name: str) -> bool:
    """Whether there are local features of a name; the file of learned ones need not exist."""
    return name in EXTRACTORS or name.startswith(ONNX)


def make_extractor(name: str, features: int = 500) -> FeatureExtractor:
    """Make the extractor of a name.

    Args:
        name: a key of EXTRACTORS, or `onnx:FILE` for a network of the user's.
        features: maximum number of features of an image.

    Raises:
        ValueError: the name is unknown; the message lists the known ones. Or the file holds no usable network.
    """
    if name.startswith(ONNX):
        return OnnxFeatures(Path(name.removeprefix(ONNX)), OnnxFeaturesConfig(features))
    if name not in EXTRACTORS:
        raise ValueError(f"unknown local features '{name}': expected one of {', '.join(EXTRACTORS)} or onnx:FILE")
    return EXTRACTORS[name](features)
