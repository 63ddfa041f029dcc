"""SIFT features by OpenCV: blobs of the difference of Gaussians, described by histograms of gradients.

Lowe, 'Distinctive Image Features from Scale-Invariant Keypoints', IJCV 60(2) 2004.
"""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.features import LocalFeatures, check_gray
from place_recognition.image_processing.opencv_features import convert_keypoints, select_spread
from place_recognition.image_processing.spread import SpreadConfig

CANDIDATES = 2  # described features for each wanted one, from which evenly spread ones are selected


@dataclass(frozen=True)
class SiftConfig:
    """Number and contrast of the blobs, and the size of the image.

    Attributes:
        max_features: maximum number of features of an image.
        min_contrast: minimum difference of Gaussians, as OpenCV scales it.
        shrink: factor by which the image is reduced first. Two takes a third of the time, and leaves as many correct
            matches of 1241 x 376 images, since the smallest blobs change most.
        spread: distribution of the features over the image.
    """

    max_features: int = 500
    min_contrast: float = 0.02
    shrink: float = 2.0
    spread: SpreadConfig = field(default_factory=SpreadConfig)


class Sift:
    """Extracts SIFT features (a FeatureExtractor)."""

    kind = "sift-128"

    def __init__(self, config: SiftConfig | None = None) -> None:
        self.config = config or SiftConfig()
        # without the precise upscale all features lie a quarter of a pixel off
        self._sift = cv2.SIFT.create(
            CANDIDATES * self.config.max_features,
            contrastThreshold=self.config.min_contrast,
            enable_precise_upscale=True,
        )

    def extract(self, image: NDArray[np.uint8]) -> LocalFeatures:
        """Extract the features of a gray image (H, W) uint8, strongest first; a blank or tiny one has none."""
        check_gray(image)
        size = [max(round(side / self.config.shrink), 1) for side in image.shape[::-1]]
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        points, described = self._sift.detectAndCompute(small, None)
        if len(points) == 0:
            described = np.empty((0, 128), np.float32)
        lengths = np.linalg.norm(described, axis=1, keepdims=True)
        found = convert_keypoints(points, described / np.maximum(lengths, 1e-12), sigmas_per_size=0.5)
        return select_spread(
            _enlarged(found, small.shape, image.shape), image.shape, self.config.max_features, self.config.spread
        )


def _enlarged(features: LocalFeatures, small: tuple[int, ...], shape: tuple[int, ...]) -> LocalFeatures:
    """Scale the features of a reduced image (h, w) to the image (H, W) that it was made from."""
    factors = np.array([shape[1] / small[1], shape[0] / small[0]], np.float32)
    # pixel centres are at integers: the first pixel of the small image spans several, whose middle is not 0
    half = np.float32(0.5)
    return replace(features, pixels=(features.pixels + half) * factors - half, scales=features.scales * factors.mean())
