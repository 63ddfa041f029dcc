"""SURF features: blobs found by the determinant of the Hessian, described by Haar wavelets.

Bay, Ess, Tuytelaars, Van Gool, 'Speeded-Up Robust Features', CVIU 110(3) 2008; why it is implemented here:
docs/decisions/own_surf.md. Descriptors are upright by default, since the camera of a car does not roll. The compiled
parts release the interpreter's lock, so that a thread can describe images ahead.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import (
    LocalFeatures,
    SpreadConfig,
    check_gray,
    is_unmasked,
    select_strongest,
)
from place_recognition.image_processing.surf_descriptor_kernels import cell_weights, describe_oriented, describe_upright
from place_recognition.image_processing.surf_detector_kernels import deinterleave, find_blobs

SIGMA_PER_SIZE = 1.2 / 9  # a box filter of side 9 approximates a Gaussian of sigma 1.2 (section 3.2 of the paper)
_UPPER_SHARE = 0.65  # of the rows of octave 0, which one thread searches while another has all the rest
LAYERS = 4  # filter sizes of each octave, evenly spaced; peaks are sought in the two inner ones

Ints = NDArray[np.int32]
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class SurfConfig:
    """Number, size and strength of the blobs.

    Attributes:
        max_features: maximum number of features of an image.
        octaves: number of doublings of scale; two reach sigmas from 1.6 to 6 pixels, three to 12.
        hessian_threshold: minimum determinant of the Hessian, (grey levels / pixel^2)^2 over the filter's area.
        spread: distribution of the features over the image.
        oriented: whether each blob is described in its own direction, for cameras that roll. A level camera then has an
            eighth fewer matches, at twice the time.
    """

    max_features: int = 500
    octaves: int = 2
    hessian_threshold: float = 10.0
    spread: SpreadConfig = field(default_factory=SpreadConfig)
    oriented: bool = False


class Surf:
    """Extracts SURF features (a FeatureExtractor)."""

    def __init__(self, config: SurfConfig | None = None) -> None:
        self.config = config or SurfConfig()
        self._describe = describe_oriented if self.config.oriented else describe_upright
        self._weights = cell_weights()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="surf")

    @property
    def kind(self) -> str:
        """Name of the descriptor; upright and oriented ones cannot be compared."""
        return "surf-64" if self.config.oriented else "surf-upright-64"

    def extract(self, image: NDArray[np.uint8], mask: NDArray[np.uint8] | None = None) -> LocalFeatures:
        """Extract the features of a grey image (H, W) uint8, strongest first; a blank or tiny one has none.

        A mask (H, W) leaves out the pixels where it is 0.
        """
        check_gray(image)
        integral = cv2.integral(image)
        blobs = self._find_blobs(integral, mask)
        descriptors = self._describe_blobs(integral, blobs[:, :3])
        keep = descriptors.any(axis=1)  # perfectly even surroundings have nothing to describe
        blobs = blobs[keep]
        return LocalFeatures(blobs[:, :2].copy(), blobs[:, 2].copy(), blobs[:, 3].copy(), descriptors[keep])

    def _find_blobs(self, integral: Ints, mask: NDArray[np.uint8] | None) -> Floats:
        """Find the strongest unmasked blobs, strongest first: (N, 4) x, y and scale in pixels, determinant."""
        height, width = integral.shape[0] - 1, integral.shape[1] - 1
        # Octave 0 takes most of the time: a second thread has the lower part of it, and the other octaves.
        middle = int(_UPPER_SHARE * height)
        other = self._pool.submit(self._find_in_rest, integral, middle)
        found = np.concatenate([_find_in_rows(integral, 0, middle, self.config.hessian_threshold), other.result()])
        found = found[is_unmasked(found[:, :2], mask)]
        strongest = select_strongest(
            found[:, :2], found[:, 3], (height, width), self.config.max_features, self.config.spread
        )
        return found[strongest]

    def _find_in_rest(self, integral: Ints, middle: int) -> Floats:
        """Find the blobs of octave 0 from row `middle` on, and those of the other octaves (N, 4)."""
        threshold = self.config.hessian_threshold
        lower = _find_in_rows(integral, middle, integral.shape[0] - 1, threshold)
        octaves = [_find_in_octave(integral, octave, threshold) for octave in range(1, self.config.octaves)]
        return np.concatenate([lower, *octaves])

    def _describe_blobs(self, integral: Ints, blobs: Floats) -> Floats:
        """Describe blobs (N, 3), one half in a second thread."""
        half = len(blobs) // 2
        other = self._pool.submit(self._describe, integral, blobs[half:], self._weights)
        return np.concatenate([self._describe(integral, blobs[:half], self._weights), other.result()])


def _find_in_rows(integral: Ints, first: int, end: int, threshold: float) -> Floats:
    """Find the blobs of octave 0 in some rows (N, 4); rows beside them belong to the filters."""
    beside = int(layer_sizes(0)[-1]) // 2 + 2
    begin = max(first - beside, 0)
    found = _find_in_octave(integral[begin : end + beside + 1], 0, threshold)
    found[:, 1] += begin
    return found[(found[:, 1] >= first - 0.5) & (found[:, 1] < end - 0.5)]


def _find_in_octave(integral: Ints, octave: int, threshold: float) -> Floats:
    """Find all blobs of one octave (N, 4): x, y, scale, determinant."""
    # Larger filters change slowly from pixel to pixel: each octave samples every second pixel of the one before.
    sizes, step = layer_sizes(octave), 2**octave
    found = find_blobs(deinterleave(integral, step), sizes, threshold)
    found[:, :2] *= step
    found[:, 2] = SIGMA_PER_SIZE * (sizes[0] + found[:, 2] * (sizes[1] - sizes[0]))
    return found


def layer_sizes(octave: int) -> Ints:
    """Return the sides of an octave's box filters, pixels: 9, 15, 21, 27 of octave 0; 15, 27, 39, 51 of octave 1."""
    # A filter grows by an even number of pixels for each of its three lobes, so that it keeps a central pixel: by 6 in
    # octave 0, and by twice as much in each further one (Figure 4 of the paper).
    step = 6 * 2**octave
    return (step + 3 + step * np.arange(LAYERS)).astype(np.int32)
