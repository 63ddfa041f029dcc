"""Global descriptors: the contract of a descriptor of a whole image, and a registry by name."""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.colour_histogram import ColorHistogram
from place_recognition.image_processing.hog import Hog
from place_recognition.image_processing.onnx_descriptor import OnnxDescriptor
from place_recognition.image_processing.thumbnail import Thumbnail

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
