"""Matching of points between the images of a rectified pair.

Two steps: a search along the row for the smallest sum of absolute differences, on images at half size; then
Lucas and Kanade's tracker from there, at full size and in both axes, because the rows of real
rectifications are off by a pixel and more. The tracker has no preference for whole pixels, as a parabola
through the sums has: a bias in disparity would be a bias in the distance driven.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from odometry.klt_tracking import TrackingConfig, is_inside, lucas_kanade

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Half = NDArray[np.float32]

_RADIUS = 4  # of the window of the search, pixels at half size
_BEHIND = 1  # shifts below zero that are searched too, pixels at half size


@dataclass(frozen=True)
class StereoMatchingConfig:
    """Search for points of the left image in the right one.

    Attributes:
        max_disparity_px: largest disparity searched, pixels.
        max_row_offset_px: largest distance of a match from its row, pixels; rectification errors must fit.
        uniqueness_ratio: the best sum of differences is at most this share of the best one elsewhere on the row.
        window_px: side of the window of the refinement, pixels, odd.
        max_return_error_px: largest distance between where matching back ends and where it began, pixels.
        max_refinement_px: largest shift of the search's result by the refinement, pixels.
    """

    max_disparity_px: int = 128
    max_row_offset_px: float = 3.0
    uniqueness_ratio: float = 0.8
    window_px: int = 11
    max_return_error_px: float = 0.3
    max_refinement_px: float = 4.0


def match_disparity(left: Image, right: Image, pixels: Array, config: StereoMatchingConfig | None = None) -> Array:
    """Disparity (N,), u_left - u_right, of pixels (N, 2) of the left image; NaN where no match is reliable.

    The images are (H, W) uint8, rectified; all else is in pixels. Nothing is assumed about depth.
    """
    return pixels[:, 0] - match_right(left, right, pixels, config)[:, 0]


def match_right(
    left: Image,
    right: Image,
    pixels: Array,
    config: StereoMatchingConfig | None = None,
    halves: tuple[Half, Half] | None = None,
) -> Array:
    """Places (N, 2) in the right image of pixels (N, 2) of the left one; NaN where no match is reliable.

    Whoever matches twice in one pair makes the `halves` of its images but once, with `halve`.
    """
    config = config or StereoMatchingConfig()
    pixels = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    half, mirrored = halves or halve(left, right)
    reach = config.max_disparity_px // 2
    shifts = _search((pixels - 0.5) / 2.0, half, mirrored, reach, config.uniqueness_ratio)
    guess = pixels - 2.0 * np.stack([shifts, 0.0 * shifts], axis=1)
    places = np.full_like(pixels, np.nan)
    known = np.isfinite(guess[:, 0]) & is_inside(pixels, left)
    places[known] = refine_right((left, right), pixels[known], guess[known], config)
    return places


def refine_right(
    images: tuple[Image, Image], pixels: Array, guess: Array, config: StereoMatchingConfig | None = None
) -> Array:
    """Places (N, 2) in the right image, starting at a guess (N, 2); NaN where the match does not hold."""
    config = config or StereoMatchingConfig()
    left, right = images
    tracker = TrackingConfig(window_px=config.window_px, pyramid_levels=0)
    places, found = lucas_kanade((left, right), pixels, guess, tracker)
    back, returned = lucas_kanade((right, left), places, pixels, tracker)
    good = found & returned & is_inside(places, right)
    good &= np.linalg.norm(back - pixels, axis=1) < config.max_return_error_px
    good &= np.linalg.norm(places - guess, axis=1) < config.max_refinement_px
    good &= (np.abs(places[:, 1] - pixels[:, 1]) < config.max_row_offset_px) & (places[:, 0] < pixels[:, 0] + 2.0)
    return np.where(good[:, None], places, np.nan)


def halve(left: Image, right: Image) -> tuple[Half, Half]:
    """The images of a pair at half size, the right one mirrored: those in which `match_right` searches."""
    return _half(left), np.ascontiguousarray(_half(right)[:, ::-1])


def _half(image: Image) -> Half:
    """Average each two by two pixels."""
    height, width = image.shape
    half = cv2.resize(image, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    return half.astype(np.float32)


@njit(cache=True, nogil=True)
def _search(pixels: Array, left: Half, mirrored: Half, max_disparity: int, uniqueness: float) -> Array:
    """Shift (N,), left less right, of the best match of pixels (N, 2), whole pixels; NaN where not unique."""
    shifts = np.full(len(pixels), np.nan)
    sums = np.empty(max_disparity + _BEHIND, dtype=np.float32)
    edge = _RADIUS + _BEHIND
    for i in range(len(pixels)):
        u, v = round(pixels[i, 0]), round(pixels[i, 1])
        if edge <= v < left.shape[0] - edge and edge <= u < left.shape[1] - edge:
            reach = min(max_disparity, u - _RADIUS) + _BEHIND
            _differences(left, mirrored, u, v, sums[:reach])
            shifts[i] = _unique_minimum(sums[:reach], uniqueness)
    return shifts


@njit(cache=True)
def _differences(left: Half, mirrored: Half, u: int, v: int, sums: Half) -> None:
    """Sum the absolute differences of windows around (u, v) and (u - shift, v), shifts from -_BEHIND up.

    Single precision is exact for these sums. The right image is mirrored so that the innermost loop runs
    forward in memory, many shifts at once.
    """
    sums[:] = 0
    last = left.shape[1] - 1
    for y in range(v - _RADIUS, v + _RADIUS + 1):
        for x in range(u - _RADIUS, u + _RADIUS + 1):
            value, row = left[y, x], mirrored[y, last - x - _BEHIND :]
            for k in range(len(sums)):
                sums[k] += abs(value - row[k])


@njit(cache=True)
def _unique_minimum(sums: Half, uniqueness: float) -> float:
    """Shift with the smallest sum, NaN where another one, not beside it, does nearly as well."""
    best = np.argmin(sums)
    for k in range(len(sums)):
        if abs(k - best) > 2 and sums[best] > uniqueness * sums[k]:
            return np.nan
    return float(best - _BEHIND)
