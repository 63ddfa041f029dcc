"""Local features: the type, the extractor's contract, and a cache of those of the latest image."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numba import njit
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


Indices = NDArray[np.int64]


@dataclass(frozen=True)
class SpreadConfig:
    """Distribution of the features over an image.

    Attributes:
        bucket_px: side of the squares into which the image is divided.
        max_crowding_ratio: maximum number of features of a square, in multiples of its even share, before the other
            squares have had theirs.
    """

    bucket_px: int = 80
    max_crowding_ratio: float = 4.0


def select_strongest(
    pixels: NDArray[np.generic],
    responses: NDArray[np.float32],
    shape: tuple[int, int],
    count: int,
    config: SpreadConfig,
) -> Indices:
    """Select the strongest features, evenly spread.

    Features beyond the share of their square are taken only where those of all other squares are too few.

    Args:
        pixels: (N, 2) positions, x right and y down.
        responses: (N,) strengths.
        shape: (H, W) of the image.
        count: maximum number of features.
        config: size of the squares and their share.

    Returns:
        Indices of the features, strongest first; the first of equal ones.
    """
    order = np.argsort(-responses, kind="stable")
    if len(order) <= count:
        return order
    squares = (pixels[order] // config.bucket_px).astype(np.int64)
    rows, columns = (side // config.bucket_px + 1 for side in shape)
    rank = _rank_in_square(squares[:, 1] * columns + squares[:, 0], rows * columns)
    even_share = count / np.prod(np.ceil(np.array(shape) / config.bucket_px))
    crowded = rank >= config.max_crowding_ratio * even_share
    return order[np.sort(np.argsort(crowded, kind="stable")[:count])]


def select_spread(features: LocalFeatures, shape: tuple[int, ...], count: int, config: SpreadConfig) -> LocalFeatures:
    """Keep at most `count` of the strongest features of an image (H, W), evenly spread, strongest first."""
    kept = select_strongest(features.pixels, features.responses, (shape[0], shape[1]), count, config)
    return LocalFeatures(
        features.pixels[kept], features.scales[kept], features.responses[kept], features.descriptors[kept]
    )


@njit(cache=True, nogil=True)
def _rank_in_square(squares: Indices, count: int) -> Indices:
    """Count for each of squares (N,), numbers below count, the equal ones before it."""
    seen, rank = np.zeros(count, np.int64), np.empty(len(squares), np.int64)
    for k in range(len(squares)):
        rank[k] = seen[squares[k]]
        seen[squares[k]] += 1
    return rank
