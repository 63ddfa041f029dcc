"""FAST corners with BRIEF descriptors, the features of the published presets of both sequence paradigms.

* FAST: pixels that differ from an arc of the circle around them. Rosten, Drummond, 'Machine Learning for High-Speed
  Corner Detection', ECCV 2006. By OpenCV.
* BRIEF: 256 comparisons of brightness at fixed places around a corner, upright and at one scale. Calonder, Lepetit,
  Strecha, Fua, 'BRIEF: Binary Robust Independent Elementary Features', ECCV 2010. OpenCV's own is in a module that its
  packages do not contain.
"""

import random
from dataclasses import dataclass
from statistics import NormalDist

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import LocalFeatures, check_gray
from place_recognition.image_processing.orb_and_sift import unpack_bits

Integers = NDArray[np.int64]
Bytes = NDArray[np.uint8]

BRIEF_BITS = 256
PATCH_PX = 31  # side of the square of all comparisons
SMOOTHING_PX = 9  # side of the Gaussian's window; a single pixel is too noisy to compare
SMOOTHING_SIGMA_PX = 2.0


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
            edgeThreshold=PATCH_PX // 2 + 1,
            patchSize=PATCH_PX,
            scoreType=cv2.ORB_FAST_SCORE,
            fastThreshold=self.config.min_contrast,
        )

    def extract(self, image: NDArray[np.uint8], mask: NDArray[np.uint8] | None = None) -> LocalFeatures:
        """Extract the features of a grey image (H, W) uint8, strongest first; a blank or tiny one has none.

        A mask (H, W) leaves out the pixels where it is 0.
        """
        check_gray(image)
        points = self._fast.detect(image, mask) if min(image.shape) > PATCH_PX + 1 else ()
        responses = np.array([point.response for point in points], np.float32)
        kept = np.argsort(-responses, kind="stable")[: self.config.max_features]
        pixels = np.array([points[k].pt for k in kept], np.float32).reshape(-1, 2)
        # The comparisons have a sigma of a fifth of the patch, as wide as those of ORB at its first level.
        scales = np.full(len(kept), PATCH_PX / 6, np.float32)
        return LocalFeatures(pixels, scales, responses[kept], unpack_bits(_describe(image, pixels.astype(np.int64))))


def _describe(image: Bytes, pixels: Integers) -> Bytes:
    """Pack the comparisons (N, 32) around pixels (N, 2) half a patch from the edge: 1 where the first is darker."""
    smooth = cv2.GaussianBlur(image, (SMOOTHING_PX, SMOOTHING_PX), SMOOTHING_SIGMA_PX)
    steps = np.array([1, image.shape[1]])  # to the next pixel to the right and below, in the flat image
    centers, pattern = pixels @ steps, PATTERN @ steps
    first, second = (smooth.ravel()[centers[:, None] + pattern[:, k]] for k in range(2))
    return np.packbits(first < second, axis=1)


def _make_pattern() -> Integers:
    """Draw the comparisons (256, 2, 2) of two places x, y each, normally distributed (the paper's G II)."""
    # Python promises the sequence of random() for ever, numpy that of no distribution; words must not change with it.
    uniform, normal = random.Random(0), NormalDist(sigma=PATCH_PX / 5)
    drawn = np.round([normal.inv_cdf(uniform.random()) for _ in range(4 * BRIEF_BITS)])
    return np.clip(drawn, -(PATCH_PX // 2), PATCH_PX // 2).astype(np.int64).reshape(BRIEF_BITS, 2, 2)


PATTERN = _make_pattern()
