"""Networks in ONNX files: opening one, what its file says about its input, and images made ready for it.

A network takes one image at a time, (1, C, H, W) float32 with one or three channels. Sizes that the file leaves open,
and the normalisation, come from the settings, else from the file's metadata, else from the defaults of the user of the
network; docs/learned_descriptors.md names the keys.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Floats = NDArray[np.float32]

ONNX = "onnx:"  # first letters of the name of a learned descriptor or learned features, before the path of the file
LEARNED_KIND = "onnx-"  # first letters of the kind of their descriptors
# Keys of the metadata of a file: numbers, those of several channels apart by spaces or commas.
HEIGHT, WIDTH, MEAN, DEVIATION, CROP = "height", "width", "mean", "std", "crop"


@dataclass(frozen=True)
class OnnxConfig:
    """Input of a network, where the file says nothing of it or something wrong.

    Attributes:
        height: height of the input, pixels; 0 as the file says.
        width: width of the input, pixels; 0 as the file says.
        mean: mean of the channels red, green, blue on a scale of 0 to 1; empty as the file says.
        deviation: standard deviation of the same channels; empty as the file says.
    """

    height: int = 0
    width: int = 0
    mean: tuple[float, ...] = ()
    deviation: tuple[float, ...] = ()


@dataclass(frozen=True)
class NetworkInput:
    """What a network expects of an image.

    Attributes:
        channels: 1 or 3.
        height: pixels; 0 where any will do.
        width: pixels; 0 where any will do.
        mean: (channels,) that is subtracted, on a scale of 0 to 1.
        deviation: (channels,) by which is divided.
        crops: whether an image of another aspect loses its borders, instead of being stretched.
    """

    channels: int
    height: int
    width: int
    mean: tuple[float, ...]
    deviation: tuple[float, ...]
    crops: bool = False

    def prepare(self, image: Image, size: tuple[int, int] | None = None) -> Floats:
        """Return the input (1, C, H, W) for a grey image (H, W) or one in colour (H, W, 3), red first, uint8.

        Args:
            image: the image.
            size: height and width of the input; those of the network if None.
        """
        height, width = size or (self.height, self.width)
        image = _crop(image, height / width) if self.crops else image
        shrinks = image.shape[0] >= height and image.shape[1] >= width
        image = convert_channels(image, self.channels)
        small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
        scaled = small.reshape(height, width, self.channels).astype(np.float32) / np.float32(255)
        scaled = (scaled - np.array(self.mean, np.float32)) / np.array(self.deviation, np.float32)
        return np.ascontiguousarray(scaled.transpose(2, 0, 1)[None])


class OnnxNetwork:
    """A network of an ONNX file, run by onnxruntime on one thread, which gives the same bits each time.

    Attributes:
        path: the file.
        input: what the network expects; height and width 0 where the file leaves them open and nothing else is said.
        outputs: names of the outputs.
        metadata: texts that the file holds beside the network, by their keys.
    """

    def __init__(self, path: Path, config: OnnxConfig, defaults: NetworkInput) -> None:
        """Open a file.

        Args:
            path: the file.
            config: the user's settings, which go before those of the file.
            defaults: size where nothing is said, and the normalisation of three channels.

        Raises:
            ValueError: the file is no network of one float32 input (1, C, H, W) with one or three channels, its
                metadata are no numbers, or onnxruntime is not installed.
        """
        self.path = path
        self._session = _open(path)
        self.outputs = tuple(output.name for output in self._session.get_outputs())
        self.metadata: Mapping[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)
        self.input = self._read_input(config, defaults)
        self.kind = f"{LEARNED_KIND}{path.stem}-{hashlib.sha256(path.read_bytes()).hexdigest()[:8]}"

    def run(self, prepared: Floats) -> list[NDArray[Any]]:
        """Return the outputs for an input (1, C, H, W), in the order of their names.

        Raises:
            ValueError: the network fails.
        """
        try:
            answers: list[NDArray[Any]] = self._session.run(None, {self._session.get_inputs()[0].name: prepared})
        except Exception as error:  # the library has no base class for its errors
            raise ValueError(f"{self.path}: expected a network that runs, got: {_first_line(error)}") from error
        return answers

    def numbers(self, key: str, allowed: tuple[int, ...]) -> tuple[float, ...]:
        """Return the numbers of a key of the metadata; empty where the file does not have it.

        Raises:
            ValueError: the text holds anything but finite numbers, or not as many as allowed.
        """
        text = self.metadata.get(key, "")
        try:
            values = tuple(float(word) for word in text.replace(",", " ").split())
        except ValueError:
            values = (np.nan,)
        if text and (len(values) not in allowed or not np.isfinite(values).all()):
            wanted = " or ".join(str(count) for count in allowed)
            raise ValueError(
                f"{self.path}: expected {wanted} numbers as metadata '{key}', found '{text}': export the model again"
            )
        return values

    def _read_input(self, config: OnnxConfig, defaults: NetworkInput) -> NetworkInput:
        channels, height, width = self._shape()
        said = {key: int((self.numbers(key, (1,)) or (0,))[0]) for key in (HEIGHT, WIDTH, CROP)}
        mean = config.mean or self.numbers(MEAN, (1, 3)) or defaults.mean
        deviation = config.deviation or self.numbers(DEVIATION, (1, 3)) or defaults.deviation
        if not all(0 < value < np.inf for value in deviation):
            raise ValueError(f"{self.path}: expected standard deviations above 0, found {deviation}: export it again")
        return NetworkInput(
            channels,
            height or config.height or said[HEIGHT] or defaults.height,
            width or config.width or said[WIDTH] or defaults.width,
            _of_channels(mean, channels),
            _of_channels(deviation, channels),
            bool(said[CROP]),
        )

    def _shape(self) -> tuple[int, int, int]:
        """Return channels, height and width of the input; 0 for an open size, 3 for an open number of channels."""
        inputs = self._session.get_inputs()
        found = ", ".join(f"{i.type} {i.shape}" for i in inputs)
        shape = inputs[0].shape if len(inputs) == 1 and inputs[0].type == "tensor(float)" else []
        sides = [side if isinstance(side, int) else preset for side, preset in zip(shape, (1, 3, 0, 0), strict=False)]
        if len(shape) != 4 or sides[0] != 1 or sides[1] not in (1, 3) or min(sides[2:]) < 0:
            raise ValueError(
                f"{self.path}: expected a network with one input (1, 1 or 3, height, width) of float32, found {found}: "
                "export the model for single images, channels first"
            )
        return sides[1], sides[2], sides[3]


def convert_channels(image: Image, channels: int) -> Image:
    """Return an image (H, W) or (H, W, 3) as one of 1 or 3 channels: colour becomes grey, grey three times the same."""
    if channels == 1:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8) if image.ndim == 3 else image
    return image if image.ndim == 3 else np.repeat(image[:, :, None], 3, axis=2)


def check_image(image: Image) -> None:
    """Raise ValueError unless an image is (H, W) or (H, W, 3) uint8 and not empty."""
    if image.dtype != np.uint8 or image.size == 0 or not (image.ndim == 2 or image.shape[2:] == (3,)):
        raise ValueError(f"expected an image (H, W) or (H, W, 3) uint8, got {image.shape} {image.dtype}")


def is_even(image: Image) -> bool:
    """Return whether all pixels of an image (H, W) or (H, W, 3) are the same."""
    first = image[:1, :1]
    # a few of them first: they tell nearly all images at once, where all of them take 2 ms
    return bool((image[::16, ::16] == first).all()) and bool((image == first).all())


def _crop(image: Image, aspect: float) -> Image:
    """The middle of an image of the aspect height / width."""
    height, width = image.shape[:2]
    new_height, new_width = min(height, round(width * aspect)), min(width, round(height / aspect))
    top, left = (height - max(new_height, 1)) // 2, (width - max(new_width, 1)) // 2
    return image[top : top + max(new_height, 1), left : left + max(new_width, 1)]


def _of_channels(values: tuple[float, ...], channels: int) -> tuple[float, ...]:
    """Values of as many channels: one stands for three, and a network of one takes the mean of three."""
    if len(values) == channels:
        return values
    return values * 3 if channels == 3 else (float(np.mean(values)),)


def _open(path: Path) -> Any:
    if not path.is_file():
        raise ValueError(f"{path}: expected an ONNX file, found none: check the path after 'onnx:'")
    try:
        import onnxruntime
    except ImportError as error:
        raise ValueError(
            f"{path}: expected onnxruntime to be installed, found none: pip install 'revisit-slam[onnx]'"
        ) from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # the library has no base class for its errors
        reason = _first_line(error)
        raise ValueError(f"{path}: expected an ONNX network, found: {reason}: export the model again") from error


def _first_line(error: Exception) -> str:
    return str(error).strip().split("\n")[0]
