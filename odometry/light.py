"""Match the brightness and contrast of two images."""

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


def match_brightness(reference: Image, image: Image) -> Image:
    """Change an image (H, W) uint8 to the mean and the contrast of a reference image."""
    (mean, deviation), (mean_reference, deviation_reference) = (cv2.meanStdDev(each) for each in (image, reference))
    gain = float(deviation_reference[0, 0] / max(deviation[0, 0], 1.0))
    return np.asarray(cv2.convertScaleAbs(image, alpha=gain, beta=float(mean_reference[0, 0] - gain * mean[0, 0])))
