"""From the words of an image to its 1 x W vector (chapter, Figure 4.4)."""

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.features import LocalFeatures
from place_recognition.map.vocabulary import Vocabulary


def word_histogram(features: LocalFeatures, vocabulary: Vocabulary) -> NDArray[np.int64]:
    """How often each word (W,) is seen among the features of one image; all zero where there are none."""
    return np.bincount(vocabulary.assign(features.descriptors), minlength=len(vocabulary))
