"""Checks of images: light, blank and repeated images, sizes.

Checks of timestamps: frame rate and pauses.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.diagnostics.findings import ALL_USES, Finding, report_fault, report_ok, report_warning

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_MAX_DARK, _MIN_BRIGHT = 30, 250  # grey values
_MAX_BRIGHT_SHARE = 0.25  # of the pixels; with more, an image is over-exposed
_MIN_DEVIATION = 4.0  # grey values, standard deviation of an image that is not blank
_HARMLESS_SHARE = 0.05  # of the images


@dataclass(frozen=True)
class ImageStatistics:
    """Properties of one image.

    Attributes:
        shape: (height, width).
        is_dark: whether nine tenths of the pixels are nearly black.
        is_overexposed: whether a quarter of the pixels is white.
        is_blank: whether the image has no contrast.
        is_repeated: whether it equals the image before.
    """

    shape: tuple[int, int]
    is_dark: bool
    is_overexposed: bool
    is_blank: bool
    is_repeated: bool


def measure_image(image: Image, before: Image | None) -> ImageStatistics:
    """Measure an image (H, W) uint8, and compare it with the image before it, if there is one."""
    return ImageStatistics(
        shape=(image.shape[0], image.shape[1]),
        is_dark=bool(np.percentile(image, 90) < _MAX_DARK),
        is_overexposed=bool((image >= _MIN_BRIGHT).mean() > _MAX_BRIGHT_SHARE),
        is_blank=bool(image.std() < _MIN_DEVIATION),
        is_repeated=before is not None and np.array_equal(image, before),
    )


def check_images(images: Sequence[ImageStatistics], successors: Sequence[ImageStatistics]) -> list[Finding]:
    """Check the light, the contrast, the repetitions and the sizes of images.

    Args:
        images: all measured images.
        successors: those of them whose predecessor was measured too.
    """
    return [
        _check_sizes(images),
        _check_share("light", [image.is_dark for image in images], "dark: more light or a longer exposure would help"),
        _check_share(
            "light", [image.is_overexposed for image in images], "over-exposed: a shorter exposure would help"
        ),
        _check_share(
            "blanks", [image.is_blank for image in images], "blank: was the lens covered, or the camera not ready?"
        ),
        _check_share(
            "repetitions", [image.is_repeated for image in successors], "the same as the one before: remove the copies"
        ),
    ]


def _check_sizes(images: Sequence[ImageStatistics]) -> Finding:
    shapes = sorted({image.shape for image in images})
    text = ", ".join(f"{width} x {height}" for height, width in shapes)
    if len(shapes) > 1:
        return report_warning(
            "sizes", f"images of several sizes, {text}; only places can be recognised in them", sizes=text
        )
    return report_ok("sizes", f"{text} pixels, in all {len(images)} images looked at", sizes=text)


def _check_share(topic: str, flags: Sequence[bool], trouble: str) -> Finding:
    share = float(np.mean(flags)) if flags else 0.0
    word = trouble.split(":", maxsplit=1)[0]
    if share > 1.0 - _HARMLESS_SHARE:
        return report_fault(topic, f"{share:.0%} of the images are {trouble}", ALL_USES, share=share)
    if share > _HARMLESS_SHARE:
        return report_warning(topic, f"{share:.0%} of the images are {trouble}", share=share)
    return report_ok(topic, f"{share:.0%} of the images are {word}", share=share)


_PAUSE_RATIO = 3.0  # a pause is a step longer than this many median steps
_MIN_RATE_HZ = 4.0  # at less, successive images from a car have too little in common


def check_timestamps(times: Array) -> list[Finding]:
    """Check the rate and the pauses of times (N,), seconds, increasing."""
    if len(times) < 2:
        return []
    steps = np.diff(times)
    median_s = float(np.median(steps))
    return [_check_rate(times, median_s), _check_pauses(steps, median_s, times)]


def _check_rate(times: Array, median_s: float) -> Finding:
    seconds = float(times[-1] - times[0])
    text = f"{1 / median_s:.1f} images a second, {seconds:.1f} s in all"
    figures = {"rate_hz": 1 / median_s, "seconds": seconds}
    if 1 / median_s < _MIN_RATE_HZ:
        return report_warning("rate", f"{text}: slow; successive images must still show the same things", **figures)
    return report_ok("rate", text, **figures)


def _check_pauses(steps: Array, median_s: float, times: Array) -> Finding:
    pauses = np.flatnonzero(steps > _PAUSE_RATIO * median_s)
    if not len(pauses):
        return report_ok("pauses", f"none: no step above {steps.max():.3f} s", pauses=0, longest_s=float(steps.max()))
    longest = int(pauses[np.argmax(steps[pauses])])
    return report_warning(
        "pauses",
        f"{len(pauses)}, the longest of {steps[longest]:.2f} s after image {longest}; motion is guessed across them",
        pauses=len(pauses),
        longest_s=float(steps[longest]),
        after_s=float(times[longest] - times[0]),
    )
