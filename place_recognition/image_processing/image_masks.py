"""Masks of images: where features may lie, by what the user leaves out and by what was found to be static."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import FeatureExtractor, LocalFeatures
from place_recognition.image_processing.static_regions import StaticRegionConfig, StaticRegionDetector

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class ImageMask:
    """Where the features of one image may lie.

    Attributes:
        pixels: (H, W) uint8, 0 where they may not; None if they may lie anywhere.
        static_ratio: share of the image that is left out because it is static.
        state: state of `ImageMasks` after this image.
    """

    pixels: Image | None
    static_ratio: float
    state: dict[str, Any]


class ImageMasks:
    """Makes the mask of each image of a recording, in order.

    Masks may be made ahead of the images' use, in another thread: `state` is that of the last image that was confirmed.
    """

    def __init__(self, config: StaticRegionConfig | None = None, fixed: Image | None = None) -> None:
        """Make masks for a recording.

        Args:
            config: how static regions are found; the defaults if None.
            fixed: (H, W) uint8 of the images' size, 0 where features are left out in all of them; None for nowhere.
        """
        config = config or StaticRegionConfig()
        self._detector = StaticRegionDetector(config) if config.enabled else None
        self._fixed = fixed
        self._images, self._sum_static = 0, 0.0
        # The latest mask and its static share, and the static blocks and the shape of the image that they are for.
        self._latest: tuple[Image | None, float, object, tuple[int, ...]] | None = None
        self._confirmed = self._state()

    @property
    def mean_static_ratio(self) -> float:
        """Mean share of the confirmed images that was left out because it is static."""
        return float(self._confirmed["sum_static"]) / max(int(self._confirmed["images"]), 1)

    def observe(self, image: Image) -> ImageMask:
        """Return the mask of the next image (H, W) uint8."""
        pixels, static_ratio = self._fixed, 0.0
        if self._detector is not None:
            self._detector.observe(image)
            pixels, static_ratio = self._combine(image.shape)
        self._images += 1
        self._sum_static += static_ratio
        return ImageMask(pixels, static_ratio, self._state())

    def confirm(self, mask: ImageMask) -> None:
        """Note that the image of a mask has been processed; a run that is resumed continues after it."""
        self._confirmed = mask.state

    def state(self) -> dict[str, Any]:
        """State after the last confirmed image, for a checkpoint."""
        return self._confirmed

    def restore(self, state: dict[str, Any]) -> None:
        """Continue, bit for bit, from the state of other masks of this configuration."""
        self._images, self._sum_static = state["images"], state["sum_static"]
        if self._detector is not None:
            self._detector.restore(state["detector"])
        self._latest, self._confirmed = None, state

    def _combine(self, shape: tuple[int, ...]) -> tuple[Image | None, float]:
        """Return the mask for images of a shape, and its static share; static regions seldom change."""
        assert self._detector is not None
        blocks = self._detector.static_blocks
        if self._latest is None or self._latest[2] is not blocks or self._latest[3] != shape:
            found = self._detector.mask(shape)
            ratio = 0.0 if found is None else 1.0 - cv2.countNonZero(found) / found.size
            self._latest = intersect(found, self._fixed), ratio, blocks, shape
        return self._latest[:2]

    def _state(self) -> dict[str, Any]:
        detector = None if self._detector is None else self._detector.state()
        return {"images": self._images, "sum_static": self._sum_static, "detector": detector}


class MaskedExtractor:
    """Extracts features of the images of one recording, in order, where their masks allow it (a FeatureExtractor)."""

    def __init__(self, inner: FeatureExtractor, masks: ImageMasks) -> None:
        self._inner, self._masks = inner, masks

    @property
    def kind(self) -> str:
        """Name of the descriptor."""
        return self._inner.kind

    def extract(self, image: Image, mask: Image | None = None) -> LocalFeatures:
        """Extract the features of the next image (H, W) uint8; a mask (H, W) leaves out more pixels, where it is 0."""
        found = self._masks.observe(image)
        self._masks.confirm(found)
        return self._inner.extract(image, intersect(found.pixels, mask))


def intersect(first: Image | None, second: Image | None) -> Image | None:
    """Return the mask (H, W) that leaves out what either of two masks leaves out; None leaves out nothing."""
    if first is None or second is None:
        return second if first is None else first
    return np.asarray(np.where(first == 0, 0, second), np.uint8)
