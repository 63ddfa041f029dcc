"""Global descriptor: the joint colour histogram of an image, or the histogram of a gray one."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class ColorHistogramConfig:
    """Resolution of the histogram.

    Attributes:
        bins: number of bins of each colour channel, up to 256.
        gray_bins: number of bins of a gray image, up to 256.
    """

    bins: int = 8
    gray_bins: int = 64


class ColorHistogram:
    """Describes an image by its colours, or a grey one by its intensities (a GlobalDescriptor)."""

    kind = "colour-histogram"

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
            colours, count = _bin(image, self.config.gray_bins), self.config.gray_bins
        else:
            first, second, third = (_bin(image[..., channel], self.config.bins) for channel in range(3))
            colours, count = (first * self.config.bins + second) * self.config.bins + third, self.config.bins**3
        return (np.bincount(colours.ravel(), minlength=count) / colours.size).astype(np.float32)


def _bin(channel: NDArray[np.uint8], bins: int) -> NDArray[np.int64]:
    return channel.astype(np.int64) * bins // 256
