"""Images in one another's light."""

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


def match_brightness(model: Image, image: Image) -> Image:
    """An image with the mean and the contrast of another, (H, W) uint8."""
    (mean, deviation), (mean_model, deviation_model) = (cv2.meanStdDev(each) for each in (image, model))
    gain = float(deviation_model[0, 0] / max(deviation[0, 0], 1.0))
    return np.asarray(cv2.convertScaleAbs(image, alpha=gain, beta=float(mean_model[0, 0] - gain * mean[0, 0])))
