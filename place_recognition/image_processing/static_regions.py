"""Static regions of the images of a moving camera: the bonnet, burnt-in text, a logo, dirt, black bars.

What stays at the same pixels while the camera moves belongs to no place. Small blocks of the image are compared with
the same blocks of earlier images: the change of their brightness gradient, relative to the gradient itself, is about 1
where anything has moved by more than its own width and near 0 where nothing has. Images count only while the camera
moves, so a standing camera teaches nothing. Decision record: docs/decisions/static_regions.md.
"""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.image_processing.local_features import FeatureExtractor, LocalFeatures

Image = NDArray[np.uint8]
Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

_WORKING_WIDTH_PX = 620  # images are reduced to about this width: halved noise, and a quarter of the time
_BLOCK_PX = 4  # side of a block in the reduced image
# Squared gradients of the two images of a pair, summed over one pixel, below which a block has nothing to compare:
# differences of four or five grey levels from pixel to pixel.
_MIN_ENERGY = 80.0
# Noise changes without motion. It is as strong in the mixed second difference, in which most texture is weak: the value
# of the smoothest tenth of the blocks, times this factor, is four times what noise adds to the gradients.
_NOISE_QUANTILE, _NOISE_FACTOR = 0.1, 8.0
# The camera moves if this share of the blocks has changed in most cells of the image: traffic before a standing camera
# changes some cells, a bonnet leaves some as they are, and what trembles changes too little.
_CHANGED = 0.7  # relative change of a block that has moved by its own structure
_CELL_ROWS, _CELL_COLUMNS = 4, 8
_MIN_CELL_BLOCKS = 8  # with texture, for a cell to count
_MIN_CHANGED_RATIO, _MIN_CELL_RATIO = 0.3, 0.55
# What is the very same picture needs fewer comparisons: an opaque bonnet is known before it fills the map.
_MIN_EQUAL_PAIRS, _MAX_EQUAL_CHANGE = 4, 0.03
_REFERENCE_PAIRS = 16  # that an earlier image is compared with later ones


@dataclass(frozen=True)
class StaticRegionConfig:
    """When a part of the image counts as static.

    Attributes:
        enabled: whether static regions are looked for.
        max_change_ratio: maximum mean change of a block's gradient, relative to the gradient, of a static block: 0 for
            the same picture, 1 for an unrelated one.
        min_pairs: number of pairs of images, with motion between them, after which a block may count as static.
        memory_pairs: number of pairs over which the change is averaged; what is no longer static is found again in
            about half as many.
        margin_px: features are left out up to this distance from a static block, pixels of an image 620 pixels wide.
    """

    enabled: bool = True
    max_change_ratio: float = 0.25
    min_pairs: int = 10
    memory_pairs: int = 20
    margin_px: int = 8


class StaticRegionDetector:
    """Finds static regions online: each image is compared with earlier ones only.

    Arrays of the state are replaced and never changed, so that a state stays what it was while images are read ahead.
    """

    def __init__(self, config: StaticRegionConfig | None = None) -> None:
        self.config = config or StaticRegionConfig()
        self._size: tuple[int, int] | None = None  # (width, height) of the reduced images
        self._latest: Image | None = None  # the last image that counted
        self._reference: Image | None = None  # an earlier one, for slow motion
        self._reference_pairs = 0
        self._change: Floats = np.zeros((0, 0), np.float32)
        self._pairs: Floats = np.zeros((0, 0), np.float32)
        self._static: Mask = np.zeros((0, 0), bool)

    @property
    def static_blocks(self) -> Mask:
        """(rows, columns) of the blocks that are static; the same object as long as nothing changes."""
        return self._static

    def observe(self, image: Image) -> None:
        """Compare the next image (H, W) uint8 with earlier ones; its size may differ from theirs."""
        reduced = self._reduce(image)
        if self._latest is None or self._reference is None:
            self._latest = self._reference = reduced
            self._change = np.full(_block_shape(reduced), 1.0, np.float32)
            self._pairs = np.zeros(self._change.shape, np.float32)
            self._static = np.zeros(self._change.shape, bool)
            return
        change, compared = _compare(self._latest, reduced, self._static)
        if not compared.any():
            return
        if self._reference is not self._latest:  # what trembles may have come back to where it was
            change, also_compared = _compare(self._reference, reduced, self._static)
            compared &= also_compared
        self._learn(change, compared)
        self._latest = reduced
        self._reference_pairs += 1
        if self._reference_pairs == _REFERENCE_PAIRS:
            self._reference, self._reference_pairs = reduced, 0

    def mask(self, shape: tuple[int, ...]) -> Image | None:
        """Return a mask (H, W) uint8 for images of a shape, 0 where features are left out, else 255.

        None where nothing is static.
        """
        if not self._static.any():
            return None
        # Gaps between static blocks, as of letters whose edges do not fill them or of digits that change, are closed.
        margin = round(self.config.margin_px / _BLOCK_PX)
        radius = margin + 1
        grown = cv2.dilate(np.pad(self._static.astype(np.uint8), 2 * radius), _disc(margin + radius))
        left_out = cv2.erode(grown, _disc(radius))[2 * radius : -2 * radius, 2 * radius : -2 * radius]
        assert self._size is not None
        height, width = shape[:2]
        # Blocks at the right and the lower edge may reach beyond the image.
        size = [
            math.ceil(_BLOCK_PX * n * side / reduced)
            for n, side, reduced in zip(left_out.shape[::-1], (width, height), self._size, strict=True)
        ]
        usable = np.asarray(255 * (1 - left_out), np.uint8)
        return np.asarray(cv2.resize(usable, size, interpolation=cv2.INTER_NEAREST)[:height, :width])

    def state(self) -> dict[str, Any]:
        """Everything that changes from image to image, for a checkpoint."""
        return {
            "latest": self._latest,
            "reference": self._reference,
            "reference_pairs": self._reference_pairs,
            "change": self._change,
            "pairs": self._pairs,
            "static": self._static,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue, bit for bit, from the state of another detector of this configuration."""
        self._latest, self._reference = state["latest"], state["reference"]
        self._size = None if self._latest is None else self._latest.shape[::-1]
        self._reference_pairs = state["reference_pairs"]
        self._change, self._pairs, self._static = state["change"], state["pairs"], state["static"]

    def _reduce(self, image: Image) -> Image:
        """Reduce an image (H, W) by a whole factor; later images of any size to the size of the first."""
        if self._size is None:
            factor = max(round(image.shape[1] / _WORKING_WIDTH_PX), 1)
            self._size = (max(image.shape[1] // factor, 1), max(image.shape[0] // factor, 1))
        # An odd row or column is cut off: reduced by a whole factor, an image takes a tenth of the time.
        factor = max(image.shape[1] // self._size[0], 1)
        if (image.shape[1] // factor, image.shape[0] // factor) == self._size:
            image = image[: factor * self._size[1], : factor * self._size[0]]
        return np.asarray(cv2.resize(image, self._size, interpolation=cv2.INTER_AREA))

    def _learn(self, change: Floats, compared: Mask) -> None:
        """Update the mean change (rows, columns) of the blocks that were compared."""
        self._pairs = self._pairs + compared
        weight = 1 / np.clip(self._pairs, 1, self.config.memory_pairs)
        self._change = np.where(compared, self._change + weight * (change - self._change), self._change)
        is_equal = (self._pairs >= _MIN_EQUAL_PAIRS) & (self._change < _MAX_EQUAL_CHANGE)
        is_known = (self._pairs >= self.config.min_pairs) | is_equal
        limit = np.where(self._static, 1.5, 1.0) * self.config.max_change_ratio  # no change to and fro at the limit
        static = is_known & (self._change < limit)
        if not np.array_equal(static, self._static):
            self._static = static


def _disc(radius: int) -> Image:
    """Structuring element (2 radius + 1, 2 radius + 1) of a disc."""
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)), np.uint8)


def _block_shape(image: Image) -> tuple[int, int]:
    return -(-image.shape[0] // _BLOCK_PX), -(-image.shape[1] // _BLOCK_PX)


def _compare(first: Image, second: Image, static: Mask) -> tuple[Floats, Mask]:
    """Compare the blocks (rows, columns) of two images.

    Returns:
        Change of each block's gradient, relative to the gradient, and which blocks say whether they are static: those
        with texture that the motion between the images would have changed. None do if the camera has not moved.
    """
    change, energy_x, energy_y, roughness = _gradient_change(first, second, _block_shape(first))
    energy = energy_x + energy_y
    noise = roughness[::2, ::2]
    noise = noise[noise > 0]  # overexposed parts have none
    floor = _MIN_ENERGY * _BLOCK_PX**2
    if len(noise):
        position = int(_NOISE_QUANTILE * len(noise))
        floor = max(floor, _NOISE_FACTOR * float(np.partition(noise, position)[position]))
    change /= np.maximum(energy, 1.0)
    compared = np.zeros(static.shape, bool)
    # An upright edge shows sideways motion only and a level one only motion up and down: each kind must have moved
    # elsewhere in the image to say anything here.
    is_upright = energy_x >= energy_y
    for kind in (is_upright, ~is_upright):
        textured = (energy > floor) & kind
        if _have_moved(change > _CHANGED, textured & ~static):
            compared |= textured
    return change, compared


def _have_moved(changed: Mask, has_texture: Mask) -> bool:
    """Whether blocks (rows, columns) have changed in most cells of the image that have texture."""
    rows, columns = changed.shape
    if rows < _CELL_ROWS or columns < _CELL_COLUMNS:
        return False
    known, moved = _count_in_cells(has_texture), _count_in_cells(has_texture & changed)
    asked = known >= _MIN_CELL_BLOCKS
    moving = asked & (moved >= _MIN_CHANGED_RATIO * known)
    return bool(asked.any() and moving.sum() >= _MIN_CELL_RATIO * asked.sum())


@njit(cache=True, nogil=True)
def _count_in_cells(blocks: Mask) -> NDArray[np.int64]:
    """Count the blocks (rows, columns) that are set in each cell of the image."""
    rows, columns = blocks.shape
    counts = np.zeros((_CELL_ROWS, _CELL_COLUMNS), np.int64)
    for i in range(_CELL_ROWS):
        for j in range(_CELL_COLUMNS):
            count = 0
            for row in range(i * rows // _CELL_ROWS, (i + 1) * rows // _CELL_ROWS):
                for column in range(j * columns // _CELL_COLUMNS, (j + 1) * columns // _CELL_COLUMNS):
                    count += blocks[row, column]
            counts[i, j] = count
    return counts


@njit(cache=True, nogil=True)
def _gradient_change(first: Image, second: Image, shape: tuple[int, int]) -> tuple[Floats, Floats, Floats, Floats]:
    """Sum squares over the blocks of two images.

    Returns:
        Of the difference of their gradients, of both gradients along x and along y, and of the second image's mixed
        second difference.
    """
    height, width = first.shape
    change, energy_x, energy_y = np.zeros(shape, np.float32), np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    roughness = np.zeros(shape, np.float32)
    row_change, row_x, row_y = np.zeros(width, np.int32), np.zeros(width, np.int32), np.zeros(width, np.int32)
    row_rough = np.zeros(width, np.int32)
    for y in range(height - 1):
        for x in range(width - 1):
            right_1 = np.int32(first[y, x + 1]) - np.int32(first[y, x])
            right_2 = np.int32(second[y, x + 1]) - np.int32(second[y, x])
            down_1 = np.int32(first[y + 1, x]) - np.int32(first[y, x])
            down_2 = np.int32(second[y + 1, x]) - np.int32(second[y, x])
            row_change[x] += (right_1 - right_2) ** 2 + (down_1 - down_2) ** 2
            row_x[x] += right_1**2 + right_2**2
            row_y[x] += down_1**2 + down_2**2
            row_rough[x] += (np.int32(second[y + 1, x + 1]) - np.int32(second[y, x + 1]) - down_2) ** 2
        if y % _BLOCK_PX == _BLOCK_PX - 1 or y == height - 2:
            block = y // _BLOCK_PX
            for x in range(width - 1):
                change[block, x // _BLOCK_PX] += row_change[x]
                energy_x[block, x // _BLOCK_PX] += row_x[x]
                energy_y[block, x // _BLOCK_PX] += row_y[x]
                roughness[block, x // _BLOCK_PX] += row_rough[x]
            row_change[:], row_x[:], row_y[:], row_rough[:] = 0, 0, 0, 0
    return change, energy_x, energy_y, roughness


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
        self._config = config or StaticRegionConfig()
        self._detector = StaticRegionDetector(self._config) if self._config.enabled else None
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

    def end_reference(self) -> None:
        """Begin another recording: what was static in the one before says nothing about it."""
        if self._detector is not None:
            self._detector = StaticRegionDetector(self._config)
        self._latest = None

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
