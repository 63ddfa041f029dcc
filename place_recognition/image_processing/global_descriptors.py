"""Descriptors of a whole image, and the one place where their names become classes."""

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
        kind: names the descriptor and what changes its meaning: vectors of different kinds are not to be compared.
    """

    @property
    def kind(self) -> str:
        """Name of the descriptor and of what changes its meaning."""
        ...

    def describe(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Vector (D,) of a grey image (H, W) uint8 of any size; zeros where there is nothing to see."""
        ...


GLOBAL_DESCRIPTORS: dict[str, Callable[[], GlobalDescriptor]] = {
    "hog": Hog,
    "thumbnail": Thumbnail,
    "colour-histogram": ColorHistogram,
}


def make_global_descriptor(name: str) -> GlobalDescriptor:
    """The descriptor of this name; `onnx:FILE` is a learned one.

    Raises:
        ValueError: no such name, or a file that holds no usable network; in one line, with what was expected.
    """
    if name.startswith(ONNX):
        return OnnxDescriptor(Path(name.removeprefix(ONNX)))
    if name not in GLOBAL_DESCRIPTORS:
        raise ValueError(
            f"unknown global descriptor '{name}': expected one of {', '.join(GLOBAL_DESCRIPTORS)} or onnx:FILE"
        )
    return GLOBAL_DESCRIPTORS[name]()
