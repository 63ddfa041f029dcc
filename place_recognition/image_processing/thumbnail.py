"""The whole image as a small picture, each of whose patches has the same brightness and contrast.

Milford, Wyeth, 'SeqSLAM: Visual Route-Based Navigation for Sunny Summer Days and Stormy Winter Nights', ICRA 2012,
section III-A.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.features import check_gray

MIDDLE = 128  # grey level of what is as bright as its patch
DEVIATION = 42  # grey levels of one standard deviation: three fit into a byte on either side


@dataclass(frozen=True)
class ThumbnailConfig:
    """Size of the small picture.

    Attributes:
        width: pixels, a multiple of patch.
        height: pixels, a multiple of patch.
        patch: side of the squares that are normalised, pixels.
        min_contrast: standard deviation at which a patch counts as structured, grey levels; the noise of a wall or
            of the sky is not blown up beyond this.
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
    """Small picture (height, width) uint8 of a grey image (H, W) uint8; an even one is all MIDDLE."""
    check_gray(image)
    small = cv2.resize(image, (config.width, config.height), interpolation=cv2.INTER_AREA).astype(np.float32)
    side = config.patch
    patches = small.reshape(config.height // side, side, config.width // side, side)
    centred = patches - patches.mean(axis=(1, 3), keepdims=True)
    contrast = np.sqrt((centred * centred).mean(axis=(1, 3), keepdims=True))
    normalised = MIDDLE + DEVIATION * centred / np.maximum(contrast, config.min_contrast)
    return np.clip(np.round(normalised), 0, 255).astype(np.uint8).reshape(small.shape)


def mean_absolute_difference(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> float:
    """The chapter's equation 4.1, of two thumbnails of one size: grey levels."""
    if first.shape != second.shape:
        raise ValueError(f"expected images of one size, got {first.shape} and {second.shape}")
    return float(np.abs(first.astype(np.int16) - second).mean())


class Thumbnail:
    """Describes an image by the pixels of its thumbnail (a GlobalDescriptor)."""

    def __init__(self, config: ThumbnailConfig | None = None) -> None:
        self.config = config or ThumbnailConfig()

    @property
    def kind(self) -> str:
        """Two sizes mean nothing to each other."""
        return f"thumbnail-{self.config.width}x{self.config.height}-{self.config.patch}"

    def describe(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Deviations (width height,) from each patch's mean, of a grey image; zeros of an even one."""
        return (make_thumbnail(image, self.config).astype(np.float32) - MIDDLE).ravel()
