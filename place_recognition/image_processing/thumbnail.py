"""Global descriptor: a thumbnail whose patches are normalised to one brightness and contrast.

Milford, Wyeth, 'SeqSLAM: Visual Route-Based Navigation for Sunny Summer Days and Stormy Winter Nights', ICRA 2012,
section III-A.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import check_gray

MIDDLE = 128  # gray level of a pixel as bright as its patch
DEVIATION = 42  # gray levels of one standard deviation: three fit into a byte on either side


@dataclass(frozen=True)
class ThumbnailConfig:
    """Size of the thumbnail and its patches.

    Attributes:
        width: width of the thumbnail, pixels, a multiple of patch.
        height: height of the thumbnail, pixels, a multiple of patch.
        patch: side of the square patches that are normalised, pixels.
        min_contrast: minimum standard deviation by which a patch is divided, gray levels: it keeps the noise of a wall
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
    """Make the thumbnail (height, width) uint8 of a gray image (H, W) uint8; that of an even one is all MIDDLE."""
    check_gray(image)
    small = cv2.resize(image, (config.width, config.height), interpolation=cv2.INTER_AREA).astype(np.float32)
    side = config.patch
    patches = small.reshape(config.height // side, side, config.width // side, side)
    centred = patches - patches.mean(axis=(1, 3), keepdims=True)
    contrast = np.sqrt((centred * centred).mean(axis=(1, 3), keepdims=True))
    normalised = MIDDLE + DEVIATION * centred / np.maximum(contrast, config.min_contrast)
    return np.clip(np.round(normalised), 0, 255).astype(np.uint8).reshape(small.shape)


def mean_absolute_difference(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> float:
    """Compute equation 4.1 of the chapter for two thumbnails of one size, gray levels."""
    if first.shape != second.shape:
        raise ValueError(f"expected images of one size, got {first.shape} and {second.shape}")
    return float(np.abs(first.astype(np.int16) - second).mean())


class Thumbnail:
    """Describes an image by the pixels of its thumbnail (a GlobalDescriptor)."""

    def __init__(self, config: ThumbnailConfig | None = None) -> None:
        self.config = config or ThumbnailConfig()

    @property
    def kind(self) -> str:
        """Name with all sizes: thumbnails of two sizes cannot be compared."""
        return f"thumbnail-{self.config.width}x{self.config.height}-{self.config.patch}"

    def describe(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Describe a gray image by the deviations (width height,) from each patch's mean; zeros for an even one."""
        return (make_thumbnail(image, self.config).astype(np.float32) - MIDDLE).ravel()
