"""Local features: learned ones from an ONNX file of the user's, such as SuperPoint, DISK, ALIKED or XFeat.

The network finds and describes key points by itself. Its outputs are told apart by their names: `keypoints` (N, 2) or
(1, N, 2), x right and y down; `descriptors` (N, D), (1, N, D) or (1, D, N); and `scores` (N,) or (1, N). Key points are
pixels of the input, or run from -1 to 1 where the file's metadata say `keypoints = normalized`.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import (
    LocalFeatures,
    SpreadConfig,
    check_gray,
    is_unmasked,
    select_spread,
)
from place_recognition.image_processing.onnx_network import NetworkInput, OnnxConfig, OnnxNetwork, is_even

Floats = NDArray[np.float32]

OUTPUTS = ("keypoints", "descriptors", "scores")
MULTIPLE, UNITS, MAX_SIDE = "multiple", "keypoints", "max_side"  # keys of the metadata
_NORMALIZED = "normalized"
_DEFAULT_MAX_SIDE = 1024  # pixels of the longer side of the input
_SCALE_PX = 4.0  # sigma for which a feature of one scale counts, as the patches of these networks are wide
_MIN_SIDE_PX = 32  # smaller images have no features

# Where neither the file nor the settings say anything: values from 0 to 1, as these networks were trained.
_DEFAULTS = NetworkInput(3, 0, 0, (0.0, 0.0, 0.0), (1.0, 1.0, 1.0))


@dataclass(frozen=True)
class OnnxFeaturesConfig:
    """Number of the features, and the input of the network.

    Attributes:
        max_features: maximum number of features of an image.
        input: what the file leaves open.
        spread: distribution of the features over the image.
    """

    max_features: int = 500
    input: OnnxConfig = field(default_factory=OnnxConfig)
    spread: SpreadConfig = field(default_factory=SpreadConfig)


class OnnxFeatures:
    """Extracts the features of a network (a FeatureExtractor)."""

    def __init__(self, path: Path, config: OnnxFeaturesConfig | None = None) -> None:
        """Open the file and try the network on a picture.

        Raises:
            ValueError: the file is no network that can be used (`OnnxNetwork`), or its outputs are not the three above.
        """
        self.config = config or OnnxFeaturesConfig()
        self._network = OnnxNetwork(path, self.config.input, _DEFAULTS)
        if missing := [name for name in OUTPUTS if name not in self._network.outputs]:
            raise ValueError(
                f"{path}: expected a network with the outputs {', '.join(OUTPUTS)}, found "
                f"{', '.join(self._network.outputs)}, without {', '.join(missing)}: export the model with these names"
            )
        self._multiple = int((self._network.numbers(MULTIPLE, (1,)) or (1,))[0])
        self._max_side = int((self._network.numbers(MAX_SIDE, (1,)) or (_DEFAULT_MAX_SIDE,))[0])
        if self._multiple < 1 or self._max_side < _MIN_SIDE_PX:
            raise ValueError(f"{path}: expected sides of pixels as metadata, found {MULTIPLE} {self._multiple}, "
                             f"{MAX_SIDE} {self._max_side}: export the model again")  # fmt: skip
        # reports a network that cannot run now, not midway; noise has features, and their length is that of all
        picture = np.random.default_rng(0).integers(0, 256, (96, 128), np.uint8)
        self._length = self._run(picture)[1].shape[1]

    @property
    def kind(self) -> str:
        """Name of the file with the first digits of its hash."""
        return self._network.kind

    def extract(self, image: NDArray[np.uint8], mask: NDArray[np.uint8] | None = None) -> LocalFeatures:
        """Extract the features of a grey image (H, W) uint8, strongest first; an even or tiny one has none.

        A mask (H, W) leaves out the pixels where it is 0.

        Raises:
            ValueError: the network fails, or answers with anything but finite numbers.
        """
        check_gray(image)
        if min(image.shape) < _MIN_SIDE_PX or is_even(image):
            return LocalFeatures(*(np.empty(shape, np.float32) for shape in ((0, 2), 0, 0, (0, self._length))))
        pixels, descriptors, scores = self._run(image)
        lengths = np.linalg.norm(descriptors, axis=1)
        inside = ((pixels > -0.5) & (pixels < np.array(image.shape[::-1]) - 0.5)).all(axis=1)
        kept = np.flatnonzero(inside & (lengths > 0) & is_unmasked(pixels, mask))
        kept = kept[np.argsort(-scores[kept], kind="stable")]
        found = LocalFeatures(
            pixels[kept],
            np.full(len(kept), _SCALE_PX, np.float32),
            scores[kept],
            descriptors[kept] / lengths[kept, None],
        )
        return select_spread(found, image.shape, self.config.max_features, self.config.spread)

    def _run(self, image: NDArray[np.uint8]) -> tuple[Floats, Floats, Floats]:
        """Return key points (N, 2) in the image, descriptors (N, D) and scores (N,) of the network."""
        size = self._size(image.shape)
        answers = self._network.run(self._network.input.prepare(image, size))
        by_name = dict(zip(self._network.outputs, answers, strict=True))
        points, descriptors, scores = (_drop_batch(by_name[name], 1 if name == "scores" else 2) for name in OUTPUTS)
        if descriptors.ndim == 2 and len(descriptors) != len(points) and descriptors.shape[1] == len(points):
            descriptors = descriptors.T
        shapes = ", ".join(f"{name} {by_name[name].shape}" for name in OUTPUTS)
        fits = points.ndim == descriptors.ndim == 2 and points.shape == (len(descriptors), 2)
        if not fits or scores.shape != (len(points),):
            raise ValueError(
                f"{self._network.path}: expected keypoints (N, 2), descriptors (N, D) and scores (N,), found {shapes}: "
                "export the model with these outputs"
            )
        if not all(np.isfinite(values).all() for values in (points, descriptors, scores)):
            raise ValueError(
                f"{self._network.path}: expected finite numbers as outputs, found some that are not: "
                "export the model again, or check its normalisation"
            )
        if self._network.metadata.get(UNITS) == _NORMALIZED:
            points = np.asarray((points + 1) / 2 * (np.array(size[::-1], np.float32) - 1), np.float32)
        # pixel centres are at integers, so that the middle of a pixel of another size is elsewhere
        factor = np.array(image.shape[::-1], np.float32) / np.array(size[::-1], np.float32)
        return np.asarray((points + 0.5) * factor - 0.5, np.float32), descriptors, scores

    def _size(self, shape: tuple[int, ...]) -> tuple[int, int]:
        """Height and width of the input: those of the network, else those of the image, made to fit."""
        network = self._network.input
        scale = min(1.0, self._max_side / max(shape))
        height, width = (max(round(side * scale / self._multiple), 1) * self._multiple for side in shape)
        return network.height or height, network.width or width


def _drop_batch(values: NDArray[Any], dimensions: int) -> Floats:
    """Return values as float32, without a leading dimension of one image."""
    values = np.asarray(values)
    return np.asarray(values[0] if values.ndim == dimensions + 1 and len(values) == 1 else values, np.float32)
