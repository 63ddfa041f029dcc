"""SURF: blobs found by the determinant of the Hessian, described by Haar wavelets.

Bay, Ess, Tuytelaars, Van Gool, 'Speeded-Up Robust Features', CVIU 110(3) 2008. Written here because the once patented
module is not in OpenCV's wheels, and every threshold of the bag of tracked words presupposes these 64 numbers.
Upright: a car's camera does not roll, and what need not be estimated cannot be estimated wrongly.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing import surf_kernels as kernels
from place_recognition.image_processing.features import LocalFeatures

SIGMA_PER_SIZE = 1.2 / 9  # a box filter of side 9 stands for a Gaussian of sigma 1.2
DESCRIPTOR_SIZE = kernels.CELLS * kernels.CELLS * 4

Ints = NDArray[np.int32]
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class SurfConfig:
    """How many blobs, of which sizes.

    Attributes:
        features: at most so many an image.
        octaves: doublings of scale; two reach sigmas from 1.6 to 6, three to 12 pixels.
        threshold: least determinant of the Hessian, (grey levels / pixel^2)^2 over the filter's area.
        bucket: side of the squares among which features are spread, pixels.
        crowding: a square may hold so many times its even share before the others have had theirs.
    """

    features: int = 500
    octaves: int = 2
    threshold: float = 10.0
    bucket: int = 80
    crowding: float = 4.0


class Surf:
    """Extracts upright SURF features (a FeatureExtractor)."""

    kind = "surf-upright-64"

    def __init__(self, config: SurfConfig | None = None) -> None:
        self.config = config or SurfConfig()
        self._weights = kernels.cell_weights()

    def extract(self, image: NDArray[np.uint8]) -> LocalFeatures:
        """Features of a grey image (H, W) uint8, strongest first; none of a blank or tiny one."""
        check_grey(image)
        sizes = [s for s in layer_sizes(self.config.octaves) if s + 2 < min(image.shape)]
        integral = cv2.integral(image)
        layers = np.empty((len(sizes), *image.shape), np.float32)
        for size, layer in zip(sizes, layers, strict=True):
            kernels.hessian_determinants(integral, size, layer)
        peaks = self._strongest(self._find_peaks(layers, sizes), layers)
        return self._describe(integral, layers, sizes, peaks)

    def _find_peaks(self, layers: Floats, sizes: list[int]) -> Ints:
        """Peaks of all scales (N, 5): indices of the layers below, at and above, row and column."""
        found = [np.empty((0, 5), np.int32)]
        for triple in _triples(self.config.octaves):
            if triple[-1] in sizes:
                levels = np.array([sizes.index(size) for size in triple], np.int32)
                pixels = kernels.find_peaks(*(layers[i] for i in levels), self.config.threshold)
                found.append(np.hstack([np.broadcast_to(levels, (len(pixels), 3)), pixels]))
        return np.concatenate(found)

    def _strongest(self, peaks: Ints, layers: Floats) -> Ints:
        """The strongest peaks, strongest first; no square is crowded before the others have had their share."""
        count, bucket = self.config.features, self.config.bucket
        peaks = peaks[np.argsort(-_responses(peaks, layers), kind="stable")]
        if len(peaks) <= count:
            return peaks
        squares = np.prod(np.ceil(np.array(layers.shape[1:]) / bucket))
        crowded = _rank_in_square(peaks[:, 3:] // bucket, layers.shape[2]) >= self.config.crowding * count / squares
        return peaks[np.sort(np.argsort(crowded, kind="stable")[:count])]

    def _describe(self, integral: Ints, layers: Floats, sizes: list[int], peaks: Ints) -> LocalFeatures:
        offsets = _refine(kernels.gather_cubes(layers, peaks))
        sides = np.array(sizes or [0])[peaks[:, :3]]
        scales = SIGMA_PER_SIZE * (sides[:, 1] + offsets[:, 2] * (sides[:, 2] - sides[:, 1]))
        pixels = (peaks[:, :2:-1] + offsets[:, :2]).astype(np.float32)
        # a step further than one means that the parabola does not describe this peak
        near = (np.abs(offsets) <= 1).all(axis=1)
        descriptors = kernels.describe_upright(integral, pixels, scales.astype(np.float32), self._weights)
        keep = near & descriptors.any(axis=1)
        responses = _responses(peaks, layers)
        return LocalFeatures(pixels[keep], scales[keep].astype(np.float32), responses[keep], descriptors[keep])


def check_grey(image: NDArray[np.uint8]) -> None:
    """Raise ValueError unless image is (H, W) uint8."""
    if image.ndim != 2 or image.dtype != np.uint8:
        raise ValueError(f"expected a grey image (H, W) uint8, got {image.shape} {image.dtype}")


def layer_sizes(octaves: int) -> list[int]:
    """Sides of all box filters of the first octaves, increasing, pixels: 9, 15, 21, 27, then 39, 51, ..."""
    return sorted({size for triple in _triples(octaves) for size in triple})


def _triples(octaves: int) -> list[tuple[int, int, int]]:
    """Filter sizes below, at and above each searched scale: two scales an octave, evenly spaced sizes in it."""
    triples = []
    for octave in range(octaves):
        step = 6 * 2**octave
        first = step + 3
        triples += [(first + i * step, first + (i + 1) * step, first + (i + 2) * step) for i in range(2)]
    return triples


def _responses(peaks: Ints, layers: Floats) -> Floats:
    return layers[peaks[:, 1], peaks[:, 3], peaks[:, 4]]


def _refine(cubes: Floats) -> NDArray[np.float64]:
    """Offsets (N, 3) in x, y and layer to the top of the parabola in each cube (N, 3, 3, 3); 0 where it is flat."""
    cubes = cubes.transpose(0, 3, 2, 1).astype(np.float64)  # peak, x, y, layer
    centre = cubes[:, 1, 1, 1]
    gradient, curvature = np.empty((len(cubes), 3)), np.empty((len(cubes), 3, 3))
    for a in range(3):
        line = np.moveaxis(cubes, a + 1, 1)
        gradient[:, a] = (line[:, 2, 1, 1] - line[:, 0, 1, 1]) / 2
        curvature[:, a, a] = line[:, 2, 1, 1] - 2 * centre + line[:, 0, 1, 1]
        for b in range(a + 1, 3):
            plane = np.moveaxis(cubes, (a + 1, b + 1), (1, 2))
            mixed = plane[:, 2, 2, 1] - plane[:, 2, 0, 1] - plane[:, 0, 2, 1] + plane[:, 0, 0, 1]
            curvature[:, a, b] = curvature[:, b, a] = mixed / 4
    flat = np.abs(np.linalg.det(curvature)) < 1e-9
    curvature[flat], gradient[flat] = np.eye(3), 0
    return np.asarray(-np.linalg.solve(curvature, gradient[..., None])[..., 0], np.float64)


def _rank_in_square(squares: Ints, width: int) -> NDArray[np.intp]:
    """How many of the squares (N, 2), row and column below width, are the same as this one and come before it."""
    cell = squares[:, 0] * width + squares[:, 1]
    order = np.argsort(cell, kind="stable")
    rank = np.empty(len(cell), np.intp)
    rank[order] = np.arange(len(cell)) - np.searchsorted(cell[order], cell[order])
    return rank
