"""Global descriptor: histograms of oriented gradients of cells, normalised over blocks of cells (Figure 4.3).

Dalal, Triggs, 'Histograms of Oriented Gradients for Human Detection', CVPR 2005: gradients by [-1, 0, 1], unsigned
orientations, blocks of 2 x 2 cells that overlap by one, L2-Hys normalisation.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import check_gray

CLIP = 0.2  # maximum share of one gradient in its block (L2-Hys, section 6.4)
BLOCK = 2  # cells along each side of a block

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class HogConfig:
    """Size of the reduced image, its cells and their histograms.

    Attributes:
        width: width of the reduced image, pixels, a multiple of cell.
        height: height of the reduced image, pixels, a multiple of cell.
        cell: side of a cell, pixels. On two simulated towns R@P100 was 0.41 with 8, 0.41 and 0.43 with 16 and 0.37 with
            32, but with 8 first passes stay further below revisits.
        orientations: number of bins over 180 degrees.
        noise: length of the vector of a block that is only noise, gray levels.
    """

    width: int = 128
    height: int = 64
    cell: int = 8
    orientations: int = 9
    noise: float = 16.0

    def __post_init__(self) -> None:
        """Check that cells fill the picture and that there is a block of them."""
        if self.width % self.cell or self.height % self.cell or min(self.width, self.height) < BLOCK * self.cell:
            raise ValueError(
                f"expected an image of whole cells, two or more each way, got {self.width} x {self.height} "
                f"in cells of {self.cell}"
            )


class Hog:
    """Describes an image by the directions of its edges (a GlobalDescriptor): 3,780 numbers by default."""

    def __init__(self, config: HogConfig | None = None) -> None:
        self.config = config or HogConfig()

    @property
    def kind(self) -> str:
        """Name with all sizes: vectors of two sizes cannot be compared."""
        return f"hog-{self.config.width}x{self.config.height}-{self.config.cell}-{self.config.orientations}"

    def describe(self, image: NDArray[np.uint8]) -> Floats:
        """Describe a gray image (H, W) uint8 by its blocks of 2 x 2 cells, one after another; zeros for an even one."""
        check_gray(image)
        small = cv2.resize(image, (self.config.width, self.config.height), interpolation=cv2.INTER_AREA)
        cells = cell_histograms(small.astype(np.float32), self.config.cell, self.config.orientations)
        return normalize_blocks(cells, self.config.noise).ravel()


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


def normalize_blocks(cells: Floats, noise: float) -> Floats:
    """Join cells (rows, columns, orientations) into blocks (rows - 1, columns - 1, 4 orientations) of unit length.

    noise: its square is added to the squared lengths, so that blocks of less gradient than this stay short.
    """
    blocks = np.concatenate([cells[:-1, :-1], cells[:-1, 1:], cells[1:, :-1], cells[1:, 1:]], axis=2)
    blocks = blocks / np.sqrt((blocks * blocks).sum(axis=2, keepdims=True) + np.float32(noise**2))
    blocks = np.minimum(blocks, np.float32(CLIP))
    length = np.sqrt((blocks * blocks).sum(axis=2, keepdims=True))
    return np.divide(blocks, length, out=np.zeros_like(blocks), where=length > CLIP)
