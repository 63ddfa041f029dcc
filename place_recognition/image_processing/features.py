"""Local features: where they are and what they look like."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class LocalFeatures:
    """Key points of one image with their descriptors, strongest first.

    Attributes:
        pixels: (N, 2) float32, x right and y down, pixel centres at integers.
        scales: (N,) float32, size of the feature as a Gaussian sigma, pixels.
        responses: (N,) float32, the detector's strength.
        descriptors: (N, D) float32 of unit length.
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
        kind: names the descriptor, for example "surf-upright-64": words of one kind mean nothing to another.
    """

    @property
    def kind(self) -> str:
        """Name of the descriptor and of what changes its meaning."""
        ...

    def extract(self, image: NDArray[np.uint8]) -> LocalFeatures:
        """Features of a grey image (H, W) uint8; none, without an error, where there is nothing to see."""
        ...


class FeatureCache:
    """Features computed once an image, however many stages of the chain ask for them.

    Holds the latest images only: stages that need features for longer keep what they need.
    """

    def __init__(self, extractor: FeatureExtractor) -> None:
        self._extractor = extractor
        self._latest: tuple[int, LocalFeatures] | None = None

    @property
    def kind(self) -> str:
        """What the descriptors are, for example "surf-upright-64"."""
        return self._extractor.kind

    @property
    def extractor(self) -> FeatureExtractor:
        """What describes the images; it keeps nothing of them, so that another thread may use it ahead."""
        return self._extractor

    def put(self, image_id: int, features: LocalFeatures) -> None:
        """Take over what the extractor said of the image of this id, asked by somebody else."""
        self._latest = (image_id, features)

    def get(self, image_id: int, image: NDArray[np.uint8]) -> LocalFeatures:
        """Features of image (H, W) uint8, which is known by image_id."""
        if self._latest is None or self._latest[0] != image_id:
            self._latest = (image_id, self._extractor.extract(image))
        return self._latest[1]


def check_gray(image: NDArray[np.uint8]) -> None:
    """Raise ValueError unless image is (H, W) uint8."""
    if image.ndim != 2 or image.dtype != np.uint8:
        raise ValueError(f"expected a grey image (H, W) uint8, got {image.shape} {image.dtype}")
