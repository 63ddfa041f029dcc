"""Checks of depth images: how much they cover, whether their scale can be, and whether they lie on the colour images.

Registration is judged by edges: where the depth jumps, the colour usually changes too. The mean strength of the image
edges under the depth edges is compared with that of depth edges which are moved by up to 24 pixels. Figures and
controls: docs/decisions/depth_images.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.datasets.depth_units import Depth, is_possible_median, median_depth
from slam.diagnostics.findings import Finding, Use, report_fault, report_ok, report_warning

Image = NDArray[np.uint8]
Scores = NDArray[np.float32]

_MIN_COVERAGE, _MIN_USABLE_COVERAGE = 0.2, 0.01  # share of the pixels; a depth camera covers 0.6 to 1

_MAX_WIDTH_PX = 640  # of the images in which edges are compared; larger ones are made smaller
_REACH_PX = 24  # largest displacement that is tried, along either axis
_EDGE_STEP = 0.06  # of depths two pixels apart, relative to the nearer one: floors and walls stay below
_STRONG_PERCENT = 90  # of the gradients of an image; stronger ones count alike
_MIN_EDGE_PIXELS = 200  # in an image, for it to be compared
_MIN_IMAGES = 4
# Gain in strength over that of edges elsewhere. Registered depth of five cameras: 0.32 to 1.1; depth of other images of
# a recording: 0.03 to 0.17, with another displacement in each half of the images.
_MIN_GAIN, _MAX_DISAGREEMENT_PX = 0.15, 6
# Gain without a displacement, of depth of other images: -0.03 to 0.05. It is 0.1 and more in every two seconds of TUM's
# freiburg1_rpy, where the camera shakes too much for a clear displacement in three of seven.
_MAX_GAIN_OF_OTHERS = 0.06
_MAX_DISPLACEMENT_PX = 5.5  # at 640 pixels: 3 to 4 are found in TUM's and RealSense's registered depth


@dataclass(frozen=True)
class DepthStatistics:
    """Measurements of a depth image.

    Attributes:
        coverage: share of the pixels with a measurement.
        median_m: median depth, metres; NaN without a measurement.
    """

    coverage: float
    median_m: float


def measure_depth(depth: Depth) -> DepthStatistics:
    """Measure a depth image (H, W), metres, NaN where there is no measurement."""
    return DepthStatistics(float(np.isfinite(depth).mean()), median_depth(depth))


def check_depth(depths: Sequence[DepthStatistics], pairs: Sequence[tuple[Image, Depth]]) -> list[Finding]:
    """Check depth images.

    Args:
        depths: measurements of all sampled depth images.
        pairs: some colour images and their depth images, (H, W) each.
    """
    return [_check_coverage(depths), _check_scale(depths), _check_registration(pairs)] if depths else []


def _check_coverage(depths: Sequence[DepthStatistics]) -> Finding:
    share = float(np.mean([depth.coverage for depth in depths]))
    text = f"{share:.0%} of the pixels have a depth"
    if share < _MIN_USABLE_COVERAGE:
        return report_fault("depth", f"{text}: use --mono", (Use.STEREO,), share=share)
    if share < _MIN_COVERAGE:
        advice = "few; go nearer, out of direct sunlight, or use --mono"
        return report_warning("depth", f"{text}: {advice}", share=share)
    return report_ok("depth", text, share=share)


def _check_scale(depths: Sequence[DepthStatistics]) -> Finding:
    medians = [depth.median_m for depth in depths if np.isfinite(depth.median_m)]
    if not medians:
        return report_ok("depth scale", "no depth to measure", metres=None)
    metres = float(np.median(medians))
    text = f"median depth {metres:.3g} m"
    if not is_possible_median(metres):
        return report_warning("depth scale", f"{text}: impossible; correct depth_scale in camera.toml", metres=metres)
    return report_ok("depth scale", text, metres=metres)


def _check_registration(pairs: Sequence[tuple[Image, Depth]]) -> Finding:
    """Check that depth edges lie on image edges."""
    topic, wide = "depth registration", max((image.shape[1] for image, _ in pairs), default=0)
    step = max(round(wide / _MAX_WIDTH_PX), 1)
    scores = [score for image, depth in pairs if (score := edge_strengths(image, depth, step)) is not None]
    if len(scores) < _MIN_IMAGES:
        return report_ok(topic, "too few depth edges to compare with those of the images", displacement_px=None)
    (x, y), gain = _find_displacement(scores)
    halves = np.array([_find_displacement(scores[begin::2])[0] for begin in (0, 1)])
    if gain < _MIN_GAIN or np.abs(halves[0] - halves[1]).max() > _MAX_DISAGREEMENT_PX:
        if _gain_in_place(scores) > _MAX_GAIN_OF_OTHERS:
            return report_ok(topic, "too few clear edges to measure where the depth lies", displacement_px=None)
        trouble = "depth edges are no edges of the images: is the depth registered to the colour, and taken with it?"
        return report_warning(topic, trouble, displacement_px=None, gain=gain)
    figures = {"displacement_px": [step * x, step * y], "gain": gain}
    words = f"{abs(step * x)} px {'right' if x >= 0 else 'left'} and {abs(step * y)} px {'down' if y >= 0 else 'up'}"
    if max(abs(x), abs(y)) == _REACH_PX:
        words = f"at least {words}"
    if np.hypot(x, y) > _MAX_DISPLACEMENT_PX:
        remedy = "record depth that is registered to the colour, or calibrate again"
        return report_warning(topic, f"the depth lies {words} of the colour; {remedy}", **figures)
    return report_ok(topic, f"depth edges lie on image edges ({words})", **figures)


def edge_strengths(image: Image, depth: Depth, step: int = 1) -> Scores | None:
    """Mean strength of image edges under the depth edges, for each displacement; None with too few depth edges.

    Args:
        image: (H, W) uint8.
        depth: (H, W), metres, NaN where there is none.
        step: factor by which both are made smaller.

    Returns:
        (49, 49) from 0 to 1; row and column are the displacement down and to the right that is taken back, plus 24.
    """
    small = depth[::step, ::step]
    size = small.shape[1], small.shape[0]
    if min(size) <= 3 * _REACH_PX:
        return None
    inner = slice(_REACH_PX, -_REACH_PX)
    edges = _depth_edges(small)[inner, inner].astype(np.float32)
    if edges.sum() < _MIN_EDGE_PIXELS:
        return None
    strength = _image_edges(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
    sums = cv2.matchTemplate(strength, edges, cv2.TM_CCORR)
    return np.asarray(sums[::-1, ::-1] / edges.sum(), np.float32)  # displaced depth is taken back


def _depth_edges(depth: Depth) -> NDArray[np.bool_]:
    """Pixels (H, W) at which depth jumps; a median filter removes single wrong values."""
    filtered = cv2.medianBlur(np.nan_to_num(depth), 5)
    filtered[filtered == 0] = np.nan
    edges = np.zeros(depth.shape, bool)
    for inner, before, after in (
        (edges[:, 1:-1], filtered[:, :-2], filtered[:, 2:]),
        (edges[1:-1], filtered[:-2], filtered[2:]),
    ):
        inner |= np.abs(before - after) > _EDGE_STEP * np.fmin(before, after)
    return edges


def _image_edges(image: Image) -> Scores:
    """Strength (H, W) of the edges of an image, from 0 to 1."""
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0).astype(np.float32)
    gradient = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    return np.minimum(gradient / (np.percentile(gradient, _STRONG_PERCENT) + 1e-6), 1.0).astype(np.float32)


def _find_displacement(scores: Sequence[Scores]) -> tuple[tuple[int, int], float]:
    """Displacement of the depth to the right and down, pixels, and its gain in strength over other displacements."""
    mean = np.mean(scores, axis=0)
    row, column = np.unravel_index(int(np.argmax(mean)), mean.shape)
    gain = float(mean[row, column] / max(float(np.median(mean)), 1e-6) - 1)
    return (int(column) - _REACH_PX, int(row) - _REACH_PX), gain


def _gain_in_place(scores: Sequence[Scores]) -> float:
    """Gain in strength of depth edges that are not displaced over displaced ones."""
    mean = np.mean(scores, axis=0)
    return float(mean[_REACH_PX, _REACH_PX] / max(float(np.median(mean)), 1e-6) - 1)
