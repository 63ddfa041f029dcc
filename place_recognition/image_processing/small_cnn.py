"""Global descriptor: the learned one that ships, the first stages of a small network that was trained on ImageNet.

Activations of the middle of a network survive another time of day, where those of its end know only what is seen
(Sunderhauf, Shirazi, Dayoub, Upcroft, Milford, 'On the performance of ConvNet features for place recognition', IROS
2015). Here they are of EfficientNet-Lite0, of cells of the image, in the directions in which photographs vary most
(`benchmarks/small_cnn.py`, which makes the file). OpenCV runs it, so that nothing else has to be installed. Reasons and
figures: docs/decisions/small_cnn.md.
"""

from importlib.resources import files
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.onnx_network import NetworkInput, check_image, is_even

Floats = NDArray[np.float32]

FILE = "small_cnn.onnx"
HEIGHT, WIDTH = 192, 256  # pixels of the input

# Columns of the network's map that are averaged: a camera that walks on the other side sees all a little further left.
_AVERAGED_COLUMNS = 2

_INPUT = NetworkInput(3, HEIGHT, WIDTH, (127 / 255,) * 3, (128 / 255,) * 3)


class SmallCnn:
    """Describes an image by the shipped network (a GlobalDescriptor): 2,304 numbers, of unit length."""

    takes_color = True

    def __init__(self) -> None:
        contents = files("place_recognition.image_processing").joinpath(FILE).read_bytes()
        self._network: Any = cv2.dnn.readNetFromONNX(np.frombuffer(contents, np.uint8))

    @property
    def kind(self) -> str:
        """Name with the number of the shipped network: vectors of two networks cannot be compared."""
        return "small-cnn-1"

    def describe(self, image: NDArray[np.uint8]) -> Floats:
        """Describe an image (H, W) or (H, W, 3) uint8 by its cells, one after another; zeros for an even one."""
        check_image(image)
        self._network.setInput(prepare(image))
        vector = pool_cells(self._network.forward()[0])
        return np.zeros_like(vector) if is_even(image) else vector


def prepare(image: NDArray[np.uint8]) -> Floats:
    """Return the network's input (1, 3, HEIGHT, WIDTH) for an image (H, W) or (H, W, 3), red first."""
    return _INPUT.prepare(image)


def pool_cells(activations: Floats) -> Floats:
    """Join a map (C, rows, columns) into a vector of unit length; each place of the map counts alike."""
    lengths = np.sqrt((activations * activations).sum(axis=0))
    unit = activations / np.maximum(lengths, np.float32(1e-12))
    channels, rows, columns = unit.shape
    cells = unit.reshape(channels, rows, columns // _AVERAGED_COLUMNS, _AVERAGED_COLUMNS).mean(axis=3)
    vector: Floats = cells.ravel()
    return vector / np.float32(max(float(np.linalg.norm(vector)), 1e-12))
