"""Global descriptor: a learned one from an ONNX file of the user's."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.onnx_network import NetworkInput, OnnxConfig, OnnxNetwork, check_image

# Where neither the file nor the settings say anything: size and normalisation of ImageNet, by which most are trained.
_DEFAULTS = NetworkInput(3, 224, 224, (0.485, 0.456, 0.406), (0.229, 0.224, 0.225))


class OnnxDescriptor:
    """Describes an image by a network's output, flattened and of unit length (a GlobalDescriptor).

    Raises:
        ValueError: the file is no network that can be used (`OnnxNetwork`), or it has several outputs.
    """

    def __init__(self, path: Path, config: OnnxConfig | None = None) -> None:
        self._network = OnnxNetwork(path, config or OnnxConfig(), _DEFAULTS)
        if len(self._network.outputs) != 1:
            found = ", ".join(self._network.outputs)
            raise ValueError(
                f"{path}: expected a network with one output, the descriptor, found {found}: "
                "export the model with that output alone"
            )

    @property
    def kind(self) -> str:
        """Name of the file with the first digits of its hash."""
        return self._network.kind

    @property
    def takes_color(self) -> bool:
        """Whether the network has three channels."""
        return self._network.input.channels == 3

    def describe(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Describe an image (H, W) or (H, W, 3) uint8 by a vector (D,) of unit length, or by zeros if the network does.

        Raises:
            ValueError: the network fails, or its output holds anything but finite numbers.
        """
        check_image(image)
        answer = self._network.run(self._network.input.prepare(image))[0]
        vector = np.asarray(answer, np.float32).ravel()
        if len(vector) == 0 or not np.isfinite(vector).all():
            raise ValueError(
                f"{self._network.path}: expected finite numbers as the first output, got shape {answer.shape}: "
                "export the model again, or check its normalisation"
            )
        length = float(np.linalg.norm(vector))
        return vector / np.float32(length) if length > 0 else vector
