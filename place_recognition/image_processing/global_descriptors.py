"""Global descriptors: the contract of a descriptor of a whole image, three of them, and a registry of all by name.

* `Hog`: histograms of oriented gradients of cells, normalised over blocks of cells (Figure 4.3). Dalal, Triggs,
  'Histograms of Oriented Gradients for Human Detection', CVPR 2005: gradients by [-1, 0, 1], unsigned orientations,
  blocks of 2 x 2 cells that overlap by one, L2-Hys normalisation.
* `Thumbnail`: a reduced image whose patches are normalised to one brightness and contrast. Milford, Wyeth, 'SeqSLAM:
  Visual Route-Based Navigation for Sunny Summer Days and Stormy Winter Nights', ICRA 2012, section III-A.
* `ColorHistogram`: the joint colour histogram of an image, or the histogram of a grey one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import check_gray
from place_recognition.image_processing.onnx_descriptor import OnnxDescriptor
from place_recognition.image_processing.onnx_network import ONNX, OnnxConfig
from place_recognition.image_processing.small_cnn import SmallCnn

Floats = NDArray[np.float32]

HOG_CLIP = 0.2  # maximum share of one gradient in its block (L2-Hys, section 6.4)
HOG_BLOCK = 2  # cells along each side of a block
MIDDLE = 128  # grey level of a pixel as bright as its patch, in a thumbnail
DEVIATION = 42  # grey levels of one standard deviation in a thumbnail: three fit into a byte on either side


class GlobalDescriptor(Protocol):
    """Describes a whole image by one vector.

    Attributes:
        kind: name of the descriptor with its settings; vectors of two kinds cannot be compared.
        takes_color: whether it sees colour, and is to be given it where the recording has it.
    """

    @property
    def kind(self) -> str:
        """Name of the descriptor, with every setting that makes vectors incomparable."""
        ...

    @property
    def takes_color(self) -> bool:
        """Whether `describe` takes an image (H, W, 3), red first, as well."""
        ...

    def describe(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Describe a grey image (H, W) uint8 of any size by a vector (D,); zeros for an image without structure."""
        ...


@dataclass(frozen=True)
class HogConfig:
    """Size of the reduced image, its cells and their histograms.

    Attributes:
        width: width of the reduced image, pixels, a multiple of cell.
        height: height of the reduced image, pixels, a multiple of cell.
        cell: side of a cell, pixels. On two simulated towns R@P100 was 0.41 with 8, 0.41 and 0.43 with 16 and 0.37 with
            32, but with 8 first passes stay further below revisits.
        orientations: number of bins over 180 degrees.
        noise_contrast: length of the vector of a block that is only noise, grey levels.
    """

    width: int = 128
    height: int = 64
    cell: int = 8
    orientations: int = 9
    noise_contrast: float = 16.0

    def __post_init__(self) -> None:
        """Check that cells fill the picture and that there is a block of them."""
        if self.width % self.cell or self.height % self.cell or min(self.width, self.height) < HOG_BLOCK * self.cell:
            raise ValueError(
                f"expected an image of whole cells, two or more each way, got {self.width} x {self.height} "
                f"in cells of {self.cell}"
            )


class Hog:
    """Describes an image by the directions of its edges (a GlobalDescriptor): 3,780 numbers by default."""

    takes_color = False

    def __init__(self, config: HogConfig | None = None) -> None:
        self.config = config or HogConfig()

    @property
    def kind(self) -> str:
        """Name with all sizes: vectors of two sizes cannot be compared."""
        return f"hog-{self.config.width}x{self.config.height}-{self.config.cell}-{self.config.orientations}"

    def describe(self, image: NDArray[np.uint8]) -> Floats:
        """Describe a grey image (H, W) uint8 by its blocks of 2 x 2 cells, one after another; zeros for an even one."""
        check_gray(image)
        small = cv2.resize(image, (self.config.width, self.config.height), interpolation=cv2.INTER_AREA)
        cells = cell_histograms(small.astype(np.float32), self.config.cell, self.config.orientations)
        return normalize_blocks(cells, self.config.noise_contrast).ravel()


def cell_histograms(image: Floats, cell: int, orientations: int) -> Floats:
    """Compute histograms (rows, columns, orientations) of the gradients in each cell of an image (H, W), by length.

    Bin k is centred at (k + 1/2) 180 / orientations degrees; a gradient is shared between the nearest two bins.
    """
    dx, dy = np.zeros_like(image), np.zeros_like(image)
    dx[:, 1:-1], dy[1:-1] = image[:, 2:] - image[:, :-2], image[2:] - image[:-2]
    length = np.hypot(dx, dy)
    place = (np.arctan2(dy, dx) % np.pi) * np.float32(orientations / np.pi) - np.float32(0.5)
    lower = np.floor(place)
    share, lower = place - lower, lower.astype(np.int64) % orientations
    rows, columns = image.shape[0] // cell, image.shape[1] // cell
    y, x = np.indices(image.shape)
    first_bin = (y // cell * columns + x // cell) * orientations
    count = rows * columns * orientations
    histograms = np.bincount((first_bin + lower).ravel(), (length * (1 - share)).ravel(), count)
    upper = (lower + 1) % orientations
    histograms += np.bincount((first_bin + upper).ravel(), (length * share).ravel(), count)
    return histograms.reshape(rows, columns, orientations).astype(np.float32)


def normalize_blocks(cells: Floats, noise_contrast: float) -> Floats:
    """Join cells (rows, columns, orientations) into blocks (rows - 1, columns - 1, 4 orientations) of unit length.

    noise_contrast: its square is added to the squared lengths, so that blocks of less gradient than this stay short.
    """
    blocks = np.concatenate([cells[:-1, :-1], cells[:-1, 1:], cells[1:, :-1], cells[1:, 1:]], axis=2)
    blocks = blocks / np.sqrt((blocks * blocks).sum(axis=2, keepdims=True) + np.float32(noise_contrast**2))
    blocks = np.minimum(blocks, np.float32(HOG_CLIP))
    length = np.sqrt((blocks * blocks).sum(axis=2, keepdims=True))
    return np.divide(blocks, length, out=np.zeros_like(blocks), where=length > HOG_CLIP)


@dataclass(frozen=True)
class ThumbnailConfig:
    """Size of the thumbnail and its patches.

    Attributes:
        width: width of the thumbnail, pixels, a multiple of patch.
        height: height of the thumbnail, pixels, a multiple of patch.
        patch: side of the square patches that are normalised, pixels.
        min_contrast: minimum standard deviation by which a patch is divided, grey levels: it keeps the noise of a wall
            or of the sky small.
    """

    width: int = 64
    height: int = 32
    patch: int = 8
    min_contrast: float = 2.0

    def __post_init__(self) -> None:
        """Check that patches fill the picture."""
        if min(self.width, self.height, self.patch) < 1 or self.width % self.patch or self.height % self.patch:
            raise ValueError(
                f"expected a thumbnail of whole patches, got {self.width} x {self.height} in patches of {self.patch}"
            )


def make_thumbnail(image: NDArray[np.uint8], config: ThumbnailConfig) -> NDArray[np.uint8]:
    """Make the thumbnail (height, width) uint8 of a grey image (H, W) uint8; that of an even one is all MIDDLE."""
    check_gray(image)
    small = cv2.resize(image, (config.width, config.height), interpolation=cv2.INTER_AREA).astype(np.float32)
    side = config.patch
    patches = small.reshape(config.height // side, side, config.width // side, side)
    centered = patches - patches.mean(axis=(1, 3), keepdims=True)
    contrast = np.sqrt((centered * centered).mean(axis=(1, 3), keepdims=True))
    normalized = MIDDLE + DEVIATION * centered / np.maximum(contrast, config.min_contrast)
    return np.clip(np.round(normalized), 0, 255).astype(np.uint8).reshape(small.shape)


def is_blank(thumbnail: NDArray[np.uint8]) -> bool:
    """Whether a thumbnail shows no structure at all."""
    return bool((thumbnail == MIDDLE).all())


def mean_absolute_difference(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> float:
    """Compute equation 4.1 of the chapter for two thumbnails of one size, grey levels."""
    if first.shape != second.shape:
        raise ValueError(f"expected images of one size, got {first.shape} and {second.shape}")
    return float(np.abs(first.astype(np.int16) - second).mean())


class Thumbnail:
    """Describes an image by the pixels of its thumbnail (a GlobalDescriptor)."""

    takes_color = False

    def __init__(self, config: ThumbnailConfig | None = None) -> None:
        self.config = config or ThumbnailConfig()

    @property
    def kind(self) -> str:
        """Name with all sizes: thumbnails of two sizes cannot be compared."""
        return f"thumbnail-{self.config.width}x{self.config.height}-{self.config.patch}"

    def describe(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Describe a grey image by the deviations (width height,) from each patch's mean; zeros for an even one."""
        return (make_thumbnail(image, self.config).astype(np.float32) - MIDDLE).ravel()


@dataclass(frozen=True)
class ColorHistogramConfig:
    """Resolution of the histogram.

    Attributes:
        bins: number of bins of each colour channel, up to 256.
        gray_bins: number of bins of a grey image, up to 256.
    """

    bins: int = 8
    gray_bins: int = 64


class ColorHistogram:
    """Describes an image by its colours, or a grey one by its intensities (a GlobalDescriptor)."""

    kind = "colour-histogram"
    takes_color = True

    def __init__(self, config: ColorHistogramConfig | None = None) -> None:
        self.config = config or ColorHistogramConfig()

    def describe(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Compute the share (bins,) of the pixels of each colour or intensity; they sum to 1.

        Args:
            image: (H, W) uint8 grey, or (H, W, 3) uint8.
        """
        if image.dtype != np.uint8 or image.size == 0 or not (image.ndim == 2 or image.shape[2:] == (3,)):
            raise ValueError(f"expected an image (H, W) or (H, W, 3) uint8, got {image.shape} {image.dtype}")
        if image.ndim == 2:
            colors, count = _bin(image, self.config.gray_bins), self.config.gray_bins
        else:
            first, second, third = (_bin(image[..., channel], self.config.bins) for channel in range(3))
            colors, count = (first * self.config.bins + second) * self.config.bins + third, self.config.bins**3
        return (np.bincount(colors.ravel(), minlength=count) / colors.size).astype(np.float32)


def _bin(channel: NDArray[np.uint8], bins: int) -> NDArray[np.int64]:
    return channel.astype(np.int64) * bins // 256


SMALL_CNN = "small-cnn"

GLOBAL_DESCRIPTORS: dict[str, Callable[[], GlobalDescriptor]] = {
    "hog": Hog,
    "thumbnail": Thumbnail,
    "colour-histogram": ColorHistogram,
    SMALL_CNN: SmallCnn,
}


def is_learned(name: str) -> bool:
    """Whether the descriptor of a name comes from a network."""
    return name == SMALL_CNN or name.startswith(ONNX)


def make_global_descriptor(name: str, onnx: OnnxConfig | None = None) -> GlobalDescriptor:
    """Make the descriptor of a name; `onnx:FILE` is a network of the user's, with what his settings say of its input.

    Raises:
        ValueError: the name is unknown, or the file holds no usable network.
    """
    if name.startswith(ONNX):
        return OnnxDescriptor(Path(name.removeprefix(ONNX)), onnx)
    if name not in GLOBAL_DESCRIPTORS:
        raise ValueError(
            f"unknown global descriptor '{name}': expected one of {', '.join(GLOBAL_DESCRIPTORS)} or onnx:FILE"
        )
    return GLOBAL_DESCRIPTORS[name]()
