"""Local features: the type, the extractor's contract, and a cache of those of the latest image."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

# Unit descriptors are stored with one byte a number, as multiples of 1 / DESCRIPTOR_STEPS: 0.02 of distance.
DESCRIPTOR_STEPS = 127


@dataclass(frozen=True)
class LocalFeatures:
    """Key points of one image with their descriptors, strongest first.

    Attributes:
        pixels: (N, 2) float32 positions, x right and y down, pixel centres at integers.
        scales: (N,) float32 sizes as the sigma of a Gaussian, pixels.
        responses: (N,) float32 strengths of the detector's response.
        descriptors: (N, D) float32 descriptors of unit length.
    """

    pixels: NDArray[np.float32]
    scales: NDArray[np.float32]
    responses: NDArray[np.float32]
    descriptors: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.pixels)


class FeatureExtractor(Protocol):
    """Detects and describes local features.

    Attributes:
        kind: name of the descriptor, for example "surf-upright-64"; descriptors of two kinds cannot be compared.
    """

    @property
    def kind(self) -> str:
        """Name of the descriptor, with every setting that makes descriptors incomparable."""
        ...

    def extract(self, image: NDArray[np.uint8], mask: NDArray[np.uint8] | None = None) -> LocalFeatures:
        """Extract the features of a grey image (H, W) uint8; an image without structure has none, and is no error.

        A mask (H, W) leaves out the pixels where it is 0, before the strongest features are chosen.
        """
        ...


class FeatureCache:
    """Cache of the features of the latest image, which several stages of the chain need.

    Stages that need features for longer keep them themselves.
    """

    def __init__(self, extractor: FeatureExtractor) -> None:
        self._extractor = extractor
        self._latest: tuple[int, LocalFeatures] | None = None

    @property
    def kind(self) -> str:
        """Name of the descriptor, for example "surf-upright-64"."""
        return self._extractor.kind

    @property
    def extractor(self) -> FeatureExtractor:
        """The extractor; it keeps nothing of an image, so that another thread may use it ahead."""
        return self._extractor

    def put(self, image_id: int, features: LocalFeatures) -> None:
        """Store the features of the image with this id, which were extracted elsewhere."""
        self._latest = (image_id, features)

    def get(self, image_id: int, image: NDArray[np.uint8]) -> LocalFeatures:
        """Return the features of the image (H, W) uint8 with this id; extract them where they are not stored."""
        if self._latest is None or self._latest[0] != image_id:
            self._latest = (image_id, self._extractor.extract(image))
        return self._latest[1]


def is_unmasked(pixels: NDArray[np.generic], mask: NDArray[np.uint8] | None) -> NDArray[np.bool_]:
    """Whether each of the pixels (N, 2), x right and y down, is one where the mask (H, W) is not 0."""
    if mask is None:
        return np.ones(len(pixels), bool)
    column, row = np.rint(pixels).astype(np.intp).T
    height, width = mask.shape
    return np.asarray(mask[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)] != 0)


def check_gray(image: NDArray[np.uint8]) -> None:
    """Raise ValueError unless an image is (H, W) uint8."""
    if image.ndim != 2 or image.dtype != np.uint8:
        raise ValueError(f"expected a grey image (H, W) uint8, got {image.shape} {image.dtype}")
