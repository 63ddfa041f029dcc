"""Detection of corners, tracking them from image to image, and matching the brightness of two images.

Corners are the points that Lucas and Kanade's tracker can hold (Shi and Tomasi, Good Features to Track, CVPR
1994), spread evenly by a grid of buckets; they are followed with the pyramidal tracker (Bouguet, 2001) from a
predicted place, and a track is accepted if tracking it back ends where it began.
"""

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

# Between these gains and up to this difference of the means two images are as good as equally bright: the views of well
# exposed pairs differ by up to a gain of 1.05 and 9 grey levels (KITTI, a hand-held pair), and the trackers bear it.
_MIN_GAIN, _MAX_GAIN = 0.85, 1 / 0.85
_MAX_MEAN_DIFFERENCE = 12.0
_MAX_LEVEL_GAIN = 5.0  # an image that needs more, or less than its inverse, is covered or blank, and is left as it is

# Width up to which the pyramid's levels are those of the settings; each doubling has one more, for the same reach.
_USUAL_WIDTH_PX = 1280

# The weakest tenth of an image shows its noise: on a bare wall the strongest corners of noise reach five times it, and
# they follow whatever motion is predicted. Those of streets and furnished rooms are above twenty times.
_NOISE_QUANTILE, _NOISE_FACTOR, _NOISE_STEP = 0.1, 8.0, 4

_HALF = 2  # corners are detected in the image at half its size: a quarter of the time, and less noise


@dataclass(frozen=True)
class TrackingConfig:
    """Choice and tracking of corners.

    Attributes:
        max_corners: tracks to keep alive in the whole image.
        grid_columns, grid_rows: cells of the grid over which corners are spread.
        min_spacing_px: smallest distance of a new corner from any track, pixels.
        min_quality: smallest corner strength, as a share of the strongest in the image.
        window_px: side of the window that is compared, pixels, odd.
        pyramid_levels: levels of the pyramid above the image itself; each doubles the reach. Larger images than usual
            have more.
        max_return_error_px: largest distance between where tracking back ends and where it began, pixels.
        wide_blur_px: standard deviation by which a wider search blurs both images, pixels: one that motion has blurred
            then looks like a clear one; 0 for none.
    """

    max_corners: int = 450
    grid_columns: int = 16
    grid_rows: int = 6
    min_spacing_px: int = 10
    min_quality: float = 2e-3
    window_px: int = 9
    pyramid_levels: int = 3
    max_return_error_px: float = 0.5
    wide_blur_px: float = 0.0

    def widen(self) -> "TrackingConfig":
        """Return settings of about four times the reach, and time, for an unknown motion."""
        tolerance = 2.0 if self.wide_blur_px else 1.0
        return replace(
            self,
            window_px=2 * self.window_px - 1,
            pyramid_levels=self.pyramid_levels + 1,
            max_return_error_px=tolerance * self.max_return_error_px,
        )


def detect_corners(image: Image, tracked: Array, config: TrackingConfig, mask: Image | None = None) -> Array:
    """Find new corners (M, 2), pixels, where a grid cell holds too few of the tracked points (N, 2).

    None are found where the mask (H, W), if there is one, is 0.
    """
    strength = _corner_strength(image)
    noise = float(np.quantile(strength[::_NOISE_STEP, ::_NOISE_STEP], _NOISE_QUANTILE))
    if mask is not None:
        height, width = strength.shape
        strength[mask[: _HALF * height : _HALF, : _HALF * width : _HALF] == 0] = 0.0
    floor = max(config.min_quality * float(strength.max()), _NOISE_FACTOR * noise, float(np.finfo(np.float32).eps))
    _clear_around(strength, tracked, config.min_spacing_px)
    size = 2 * (config.min_spacing_px // (2 * _HALF)) + 1
    peaks = (strength == cv2.dilate(strength, np.ones((size, size), np.uint8))) & (strength > floor)
    row, column = np.nonzero(peaks)
    pixels = np.stack([column, row], axis=1).astype(np.float64) * _HALF + (_HALF - 1) / 2
    return pixels[_fill_cells(pixels, strength[row, column], tracked, image.shape, config)]


def track_points(images: tuple[Image, Image], pixels: Array, guess: Array, config: TrackingConfig) -> Array:
    """Follow pixels (N, 2) from the first image to the second, starting at a guess (N, 2).

    Returns pixels (N, 2) in the second image, NaN where the track was lost.
    """
    first, second = images
    levels = config.pyramid_levels + _more_levels(first.shape[1])
    ahead, found = lucas_kanade((first, second), pixels, guess, replace(config, pyramid_levels=levels))
    # Back over one level only: it starts where it ought to end, so it needs no reach, and a track on
    # the wrong thing does not come back to the point it left.
    back, returned = lucas_kanade((second, first), ahead, pixels, TrackingConfig(config.window_px, pyramid_levels=1))
    close = np.linalg.norm(back - pixels, axis=1) < config.max_return_error_px
    return np.where((found & returned & close & is_inside(ahead, second))[:, None], ahead, np.nan)


def lucas_kanade(
    images: tuple[Image, Image], pixels: Array, guess: Array, config: TrackingConfig
) -> tuple[Array, NDArray[np.bool_]]:
    """Pyramidal Lucas-Kanade: places (N, 2) of pixels (N, 2) in the second image, and which were found."""
    if len(pixels) == 0:
        return np.zeros((0, 2)), np.zeros(0, dtype=bool)
    moved, status, _ = cv2.calcOpticalFlowPyrLK(
        *images,
        pixels.astype(np.float32).reshape(-1, 1, 2),
        guess.astype(np.float32).reshape(-1, 1, 2),
        winSize=(config.window_px, config.window_px),
        maxLevel=config.pyramid_levels,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.01),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    moved = moved.reshape(-1, 2).astype(np.float64)
    return moved, (status.ravel() > 0) & np.isfinite(moved).all(axis=1)


def _more_levels(width_px: int) -> int:
    """Levels that an image of this width has beyond those of the settings."""
    return max(0, round(math.log2(width_px / _USUAL_WIDTH_PX)))


def is_inside(pixels: Array, image: Image, margin: float = 4.0) -> NDArray[np.bool_]:
    """Which of the pixels (N, 2) lie in the image, a margin in pixels away from its edge."""
    height, width = image.shape
    return np.all((pixels >= margin) & (pixels <= [width - 1 - margin, height - 1 - margin]), axis=1)


def is_unmasked(pixels: Array, mask: Image | None) -> NDArray[np.bool_]:
    """Which of the pixels (N, 2), NaN included, are not where the mask (H, W) is 0."""
    if mask is None:
        return np.ones(len(pixels), dtype=bool)
    height, width = mask.shape
    column, row = np.clip(np.rint(np.nan_to_num(pixels)), 0, [width - 1, height - 1]).astype(np.intp).T
    return np.asarray(mask[row, column] != 0)


def blur(image: Image, sigma_px: float) -> Image:
    """Blur an image (H, W) uint8 by a Gaussian of this standard deviation, pixels."""
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px))


def match_brightness(reference: Image, image: Image) -> Image:
    """Change an image (H, W) uint8 to the mean and the contrast of a reference image."""
    return _rescale(image, _measure_brightness(image), _measure_brightness(reference))


def level_pair(left: Image, right: Image) -> Image:
    """Return the right image (H, W) uint8 as bright as the left one; unchanged where they are as good as equal.

    The two cameras of a pair may have exposures of their own. The trackers and matchers compare grey levels.
    """
    wanted, measured = _measure_brightness(left), _measure_brightness(right)
    gain, difference = _compare_brightness(wanted, measured)
    is_blank = not 1 / _MAX_LEVEL_GAIN <= gain <= _MAX_LEVEL_GAIN
    return right if is_level(gain, difference) or is_blank else _rescale(right, measured, wanted)


def is_level(gain: float, difference: float) -> bool:
    """Whether two images with this `brightness_difference` are as good as equally bright."""
    return _MIN_GAIN <= gain <= _MAX_GAIN and abs(difference) <= _MAX_MEAN_DIFFERENCE


def brightness_difference(reference: Image, image: Image) -> tuple[float, float]:
    """Compare a reference image with an image (H, W) uint8: ratio of the contrasts, difference of the means."""
    return _compare_brightness(_measure_brightness(reference), _measure_brightness(image))


def _measure_brightness(image: Image) -> tuple[float, float]:
    """Mean and standard deviation of an image (H, W) uint8, grey levels."""
    mean, deviation = cv2.meanStdDev(image)
    return float(mean[0, 0]), float(deviation[0, 0])


def _compare_brightness(wanted: tuple[float, float], measured: tuple[float, float]) -> tuple[float, float]:
    """Ratio of the contrasts and difference of the means."""
    return wanted[1] / max(measured[1], 1.0), wanted[0] - measured[0]


def _rescale(image: Image, measured: tuple[float, float], wanted: tuple[float, float]) -> Image:
    """Change an image (H, W) uint8 from the measured mean and contrast to the wanted ones."""
    gain, _ = _compare_brightness(wanted, measured)
    return np.asarray(cv2.convertScaleAbs(image, alpha=gain, beta=wanted[0] - gain * measured[0]))


def _corner_strength(image: Image) -> NDArray[np.float32]:
    """Smaller eigenvalue of the gradient's structure tensor, on the image at half size."""
    height, width = image.shape
    half = cv2.resize(image, (width // _HALF, height // _HALF), interpolation=cv2.INTER_AREA)
    strength = cv2.cornerMinEigenVal(half, 5)
    border = 4
    strength[:border] = strength[-border:] = 0.0
    strength[:, :border] = strength[:, -border:] = 0.0
    return strength


def _clear_around(strength: NDArray[np.float32], tracked: Array, spacing_px: int) -> None:
    """Forbid new corners near the tracked points (N, 2), in place."""
    taken = np.zeros(strength.shape, np.uint8)
    height, width = strength.shape
    column, row = np.clip((tracked / _HALF).astype(np.int64), 0, [width - 1, height - 1]).T
    taken[row, column] = 1
    size = 2 * max(spacing_px // _HALF, 1) + 1
    strength[cv2.dilate(taken, np.ones((size, size), np.uint8)) > 0] = 0.0


def _fill_cells(
    pixels: Array,
    strength: NDArray[np.float32],
    tracked: Array,
    shape: tuple[int, ...],
    config: TrackingConfig,
) -> NDArray[np.intp]:
    """Choose the indices of the strongest candidates that still fit in their grid cells, in a fixed order."""
    cells = config.grid_columns * config.grid_rows
    capacity = -(-config.max_corners // cells) * 2  # sky and road leave cells empty: others may hold twice the share
    cell = _cell(pixels, shape, config)
    room = np.maximum(capacity - np.bincount(_cell(tracked, shape, config), minlength=cells), 0)
    order = np.lexsort((-strength, cell))
    first = np.searchsorted(cell[order], np.arange(cells))
    rank = np.arange(len(order)) - first[cell[order]]
    chosen = order[rank < room[cell[order]]]
    # The first of every cell come before the second of any: the budget cuts evenly.
    chosen = chosen[np.argsort(rank[rank < room[cell[order]]], kind="stable")]
    return chosen[: max(config.max_corners - len(tracked), 0)]


def _cell(pixels: Array, shape: tuple[int, ...], config: TrackingConfig) -> NDArray[np.int64]:
    """Index (N,) of the grid cell of each pixel (N, 2)."""
    height, width = shape
    column = np.clip(pixels[:, 0] * config.grid_columns / width, 0, config.grid_columns - 1).astype(np.int64)
    row = np.clip(pixels[:, 1] * config.grid_rows / height, 0, config.grid_rows - 1).astype(np.int64)
    return row * config.grid_columns + column
