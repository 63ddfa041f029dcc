"""SURF: blobs found by the determinant of the Hessian, described by Haar wavelets.

Bay, Ess, Tuytelaars, Van Gool, 'Speeded-Up Robust Features', CVIU 110(3) 2008. Written here because the once patented
module is not in OpenCV's wheels, and every threshold of the bag of tracked words presupposes these 64 numbers.
Upright by default: a car's camera does not roll, and what need not be estimated cannot be estimated wrongly.
The compiled parts let go of the interpreter: images are described by a thread that reads ahead.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.features import LocalFeatures
from place_recognition.image_processing.features import check_gray as check_gray
from place_recognition.image_processing.spread import SpreadConfig, select_strongest
from place_recognition.image_processing.surf_blobs import find_blobs
from place_recognition.image_processing.surf_descriptors import cell_weights, describe_upright
from place_recognition.image_processing.surf_hessian import deinterleave
from place_recognition.image_processing.surf_orientation import describe_oriented

SIGMA_PER_SIZE = 1.2 / 9  # a box filter of side 9 stands for a Gaussian of sigma 1.2
LAYERS = 4  # filter sizes in each octave, evenly spaced: two are searched, two only compared with

Ints = NDArray[np.int32]
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class SurfConfig:
    """How many blobs, of which sizes.

    Attributes:
        features: at most so many an image.
        octaves: doublings of scale; two reach sigmas from 1.6 to 6, three to 12 pixels.
        threshold: least determinant of the Hessian, (grey levels / pixel^2)^2 over the filter's area.
        spread: how they are spread over the image.
        oriented: describe each blob in its own direction, for cameras that roll, instead of upright; a level camera
            then has an eighth less matches, and twice the work.
    """

    features: int = 500
    octaves: int = 2
    threshold: float = 10.0
    spread: SpreadConfig = field(default_factory=SpreadConfig)
    oriented: bool = False


class Surf:
    """Extracts SURF features (a FeatureExtractor)."""

    def __init__(self, config: SurfConfig | None = None) -> None:
        self.config = config or SurfConfig()
        self._describe = describe_oriented if self.config.oriented else describe_upright
        self._weights = cell_weights()

    @property
    def kind(self) -> str:
        """Upright and oriented descriptors mean nothing to each other."""
        return "surf-64" if self.config.oriented else "surf-upright-64"

    def extract(self, image: NDArray[np.uint8]) -> LocalFeatures:
        """Features of a grey image (H, W) uint8, strongest first; none of a blank or tiny one."""
        check_gray(image)
        integral = cv2.integral(image)
        blobs = self._find_blobs(integral)
        descriptors = self._describe(integral, blobs[:, :3], self._weights)
        keep = descriptors.any(axis=1)  # perfectly even surroundings have nothing to describe
        blobs = blobs[keep]
        return LocalFeatures(blobs[:, :2].copy(), blobs[:, 2].copy(), blobs[:, 3].copy(), descriptors[keep])

    def _find_blobs(self, integral: Ints) -> Floats:
        """The strongest blobs, strongest first: (N, 4) x, y and scale in pixels, determinant."""
        shape = (integral.shape[0] - 1, integral.shape[1] - 1)
        found = np.concatenate([self._search(integral, octave) for octave in range(self.config.octaves)])
        return found[select_strongest(found[:, :2], found[:, 3], shape, self.config.features, self.config.spread)]

    def _search(self, integral: Ints, octave: int) -> Floats:
        """All blobs of one octave (N, 4): x, y, scale, determinant."""
        sizes, step = layer_sizes(octave), 2**octave
        found = find_blobs(deinterleave(integral, step), sizes, self.config.threshold)
        found[:, :2] *= step
        found[:, 2] = SIGMA_PER_SIZE * (sizes[0] + found[:, 2] * (sizes[1] - sizes[0]))
        return found


def layer_sizes(octave: int) -> Ints:
    """Sides of the box filters of an octave, pixels: 9, 15, 21, 27 of octave 0; 15, 27, 39, 51 of octave 1."""
    step = 6 * 2**octave
    return (step + 3 + step * np.arange(LAYERS)).astype(np.int32)
