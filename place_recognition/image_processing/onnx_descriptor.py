"""Global descriptor: a learned one from an ONNX file of the user's, since no weights can be shipped."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import check_gray


@dataclass(frozen=True)
class OnnxConfig:
    """Input of the network, as far as the file leaves it open.

    Attributes:
        height: height of the input, pixels.
        width: width of the input, pixels.
        mean: mean of the channels red, green, blue on a scale of 0 to 1, that of ImageNet by which most networks were
            trained; a network of one channel takes the mean of the three.
        deviation: standard deviation of the same channels.
    """

    height: int = 224
    width: int = 224
    mean: tuple[float, float, float] = (0.485, 0.456, 0.406)
    deviation: tuple[float, float, float] = (0.229, 0.224, 0.225)


class OnnxDescriptor:
    """Describes an image by a network's output, flattened and of unit length (a GlobalDescriptor).

    Raises:
        ValueError: the file is no network of one float32 input (1, C, H, W) with one or three channels, or onnxruntime
            is not installed.
    """

    def __init__(self, path: Path, config: OnnxConfig | None = None) -> None:
        self.config = config or OnnxConfig()
        self._path = path
        self._session = _open(path)
        self._input = self._session.get_inputs()[0].name
        self._shape = _input_shape(self._session, path, self.config)
        self.kind = f"onnx-{path.stem}-{hashlib.sha256(path.read_bytes()).hexdigest()[:8]}"

    def describe(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Describe a grey image (H, W) uint8 by a vector (D,) of unit length, or by zeros if the network does.

        Raises:
            ValueError: the network fails, or its first output holds anything but finite numbers.
        """
        check_gray(image)
        try:
            answer = self._session.run(None, {self._input: self._prepare(image)})[0]
        except Exception as error:  # the library has no base class for its errors
            raise ValueError(f"{self._path}: expected a network that runs, got: {_first_line(error)}") from error
        vector = np.asarray(answer, np.float32).ravel()
        if len(vector) == 0 or not np.isfinite(vector).all():
            raise ValueError(f"{self._path}: expected finite numbers as the first output, got shape {answer.shape}")
        length = float(np.linalg.norm(vector))
        return vector / np.float32(length) if length > 0 else vector

    def _prepare(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        channels, height, width = self._shape
        shrinks = image.shape[0] >= height and image.shape[1] >= width
        small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
        mean, deviation = np.array(self.config.mean), np.array(self.config.deviation)
        if channels == 1:
            mean, deviation = mean.mean(keepdims=True), deviation.mean(keepdims=True)
        scaled = (small / 255.0 - mean[:, None, None]) / deviation[:, None, None]
        return np.ascontiguousarray(scaled[None], np.float32)


def _open(path: Path) -> Any:
    """Load the network of a file, to run on one thread, which gives the same bits each time."""
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


def _input_shape(session: Any, path: Path, config: OnnxConfig) -> tuple[int, int, int]:
    """Return channels, height and width of the input; open sizes as configured, an open number of channels is 3."""
    inputs = session.get_inputs()
    found = ", ".join(f"{i.type} {i.shape}" for i in inputs)
    shape = inputs[0].shape if len(inputs) == 1 and inputs[0].type == "tensor(float)" else []
    batch, channels, height, width = (
        (
            side if isinstance(side, int) else preset
            for side, preset in zip(shape, (1, 3, config.height, config.width), strict=True)
        )
        if len(shape) == 4
        else (0, 0, 0, 0)
    )
    if batch != 1 or channels not in (1, 3) or min(height, width) < 1:
        raise ValueError(
            f"{path}: expected a network with one input (1, 1 or 3, height, width) of float32, found {found}: "
            "export the model for single images, channels first"
        )
    return channels, height, width


def _first_line(error: Exception) -> str:
    return str(error).strip().split("\n")[0]
