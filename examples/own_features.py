"""Add local features of your own: a class with `kind` and `extract`, and nothing to inherit from.

    python examples/own_features.py [--out runs/examples]

Recognises places of a simulated street with small patches around corners, and prints R@P100 beside that of SURF.
"""

import cv2
import numpy as np
from street import arguments, street

from place_recognition.evaluation.precision_recall import precision_recall
from place_recognition.image_processing.local_features import FeatureCache, LocalFeatures, check_gray
from place_recognition.image_processing.surf import Surf
from place_recognition.paradigms.registry import make_recognizer
from slam.datasets.formats.registry import open_dataset
from slam.simulation import loop_truth

PATCH_PX, CELLS = 32, 8  # side of the square that a descriptor shows, in pixels and in cells


class Patches:
    """Small pictures of the surroundings of corners as local features (a FeatureExtractor)."""

    kind = "patch-64"  # descriptors of two kinds cannot be compared

    def __init__(self, max_features=300):
        """Keep the `max_features` strongest corners of an image."""
        self._max_features = max_features

    def extract(self, image, mask=None):
        """Features of an image (H, W) uint8, strongest first, with descriptors of unit length; none where mask is 0."""
        check_gray(image)
        smooth = cv2.GaussianBlur(image, (0, 0), 1.5)
        found, quality = cv2.goodFeaturesToTrackWithQuality(smooth, self._max_features, 0.001, 6, mask)
        pixels = np.zeros((0, 2), np.float32) if found is None else found.reshape(-1, 2)
        responses = np.zeros(0, np.float32) if found is None else quality.ravel().astype(np.float32)
        descriptors = np.array([self._describe(smooth, pixel) for pixel in pixels], np.float32).reshape(-1, CELLS**2)
        return LocalFeatures(pixels, np.full(len(pixels), PATCH_PX / 4, np.float32), responses, descriptors)

    def _describe(self, image, pixel):
        patch = cv2.getRectSubPix(image, (PATCH_PX, PATCH_PX), tuple(map(float, pixel)))
        cells = cv2.resize(patch, (CELLS, CELLS), interpolation=cv2.INTER_AREA).astype(np.float32).ravel()
        cells -= cells.mean()  # brightness and contrast of the image do not matter
        return cells / max(np.linalg.norm(cells), 1e-6)


given = arguments(__doc__).parse_args()
dataset = open_dataset(street(given))
truth = loop_truth(dataset.ground_truth).astype(bool)
for extractor in (Patches(), Surf()):
    recognizer = make_recognizer("hierarchical-places", FeatureCache(extractor))
    beliefs = [b for frame in dataset for b in recognizer.observe(frame.index, frame.left, float("nan"))]
    curve = precision_recall(beliefs + recognizer.finish(), truth)
    print(f"{extractor.kind}: R@P100 {curve.recall_at_full_precision:.3f}")
