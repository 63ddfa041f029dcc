"""Do the images show something? Light, blanks, repetitions, sizes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.inspection.finding import EVERYTHING, Finding, bad, doubtful, good

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_DARK, _BRIGHT = 30, 250  # grey values
_SHARE_BRIGHT = 0.25  # of the pixels, from which on an image is over-exposed
_FLAT = 4.0  # grey values, deviation of an image that shows nothing
_FEW = 0.05  # share of the images that does no harm


@dataclass(frozen=True)
class Looks:
    """What can be said of an image by itself.

    Attributes:
        shape: (height, width).
        dark: nine tenths of it are nearly black.
        glaring: a quarter of it is white.
        blank: it shows nothing.
        repeated: it equals the one before.
    """

    shape: tuple[int, int]
    dark: bool
    glaring: bool
    blank: bool
    repeated: bool


def look(image: Image, before: Image | None) -> Looks:
    """Look at an image (H, W) uint8, and at the one before it, if there is one."""
    return Looks(
        shape=(image.shape[0], image.shape[1]),
        dark=bool(np.percentile(image, 90) < _DARK),
        glaring=bool((image >= _BRIGHT).mean() > _SHARE_BRIGHT),
        blank=bool(image.std() < _FLAT),
        repeated=before is not None and np.array_equal(image, before),
    )


def judge_images(looks: Sequence[Looks], pairs: Sequence[Looks]) -> list[Finding]:
    """Judge some images.

    Args:
        looks: at all of them.
        pairs: at those among them that came right after another one that was looked at.
    """
    return [
        _sizes(looks),
        _share("light", [one.dark for one in looks], "dark: more light or a longer exposure would help"),
        _share("light", [one.glaring for one in looks], "over-exposed: a shorter exposure would help"),
        _share("blanks", [one.blank for one in looks], "blank: was the lens covered, or the camera not ready?"),
        _share("repetitions", [one.repeated for one in pairs], "the same as the one before: remove the copies"),
    ]


def _sizes(looks: Sequence[Looks]) -> Finding:
    shapes = sorted({one.shape for one in looks})
    text = ", ".join(f"{width} x {height}" for height, width in shapes)
    if len(shapes) > 1:
        return doubtful("sizes", f"images of several sizes, {text}; only places can be recognised in them", sizes=text)
    return good("sizes", f"{text} pixels, in all {len(looks)} images looked at", sizes=text)


def _share(topic: str, which: Sequence[bool], trouble: str) -> Finding:
    share = float(np.mean(which)) if which else 0.0
    word = trouble.split(":", maxsplit=1)[0]
    if share > 1.0 - _FEW:
        return bad(topic, f"{share:.0%} of the images are {trouble}", EVERYTHING, share=share)
    if share > _FEW:
        return doubtful(topic, f"{share:.0%} of the images are {trouble}", share=share)
    return good(topic, f"{share:.0%} of the images are {word}", share=share)
