"""Global descriptors: the contract of a descriptor of a whole image, and a registry by name.

Global descriptor: the joint colour histogram of an image, or the histogram of a gray one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.hog import Hog
from place_recognition.image_processing.onnx_descriptor import OnnxDescriptor
from place_recognition.image_processing.thumbnail import Thumbnail


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


ONNX = "onnx:"


class GlobalDescriptor(Protocol):
    """Describes a whole image by one vector.

    Attributes:
        kind: name of the descriptor with its settings; vectors of two kinds cannot be compared.
    """

    @property
    def kind(self) -> str:
        """Name of the descriptor, with every setting that makes vectors incomparable."""
        ...

    def describe(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Describe a gray image (H, W) uint8 of any size by a vector (D,); zeros for an image without structure."""
        ...


GLOBAL_DESCRIPTORS: dict[str, Callable[[], GlobalDescriptor]] = {
    "hog": Hog,
    "thumbnail": Thumbnail,
    "colour-histogram": ColorHistogram,
}


def make_global_descriptor(name: str) -> GlobalDescriptor:
    """Make the descriptor of a name; `onnx:FILE` is a learned one.

    Raises:
        ValueError: the name is unknown, or the file holds no usable network.
    """
    if name.startswith(ONNX):
        return OnnxDescriptor(Path(name.removeprefix(ONNX)))
    if name not in GLOBAL_DESCRIPTORS:
        raise ValueError(
            f"unknown global descriptor '{name}': expected one of {', '.join(GLOBAL_DESCRIPTORS)} or onnx:FILE"
        )
    return GLOBAL_DESCRIPTORS[name]()
