"""Images of 16 bits become images of 8 bits, with one scale for the whole recording.

Sensors of 10, 12 and 14 bits write into the low bits of 16-bit values, and thermal cameras fill a small part of their
range: the high byte of such an image is black or has no contrast. One scale for all images keeps their brightness.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

_BIT_DEPTHS = (8, 10, 12, 14, 16)
_PERCENT = (0.5, 99.5)  # dead and hot pixels lie outside
_STEP = 3  # every third pixel of every third row is enough for percentiles
_MIN_GREY_LEVELS = 64  # with fewer between dark and bright, the range is stretched


@dataclass(frozen=True)
class GreyRange:
    """Values that the 16-bit images of a recording have.

    Attributes:
        dark, bright: values of the darkest and the brightest parts.
        max_value: largest value of all.
    """

    dark: int
    bright: int
    max_value: int

    @property
    def bit_depth(self) -> int:
        """Bits of the sensor, 8 to 16."""
        return next((bits for bits in _BIT_DEPTHS if self.max_value < 1 << bits), _BIT_DEPTHS[-1])

    @property
    def is_narrow(self) -> bool:
        """Whether the images would have hardly any contrast at the sensor's bit depth."""
        shift = self.bit_depth - 8
        return 0 < self.bright - self.dark < _MIN_GREY_LEVELS << shift and shift > 0

    @property
    def remark(self) -> str:
        """How the values are scaled; empty for the high byte of 16 bits."""
        if self.is_narrow:
            return f"16-bit images with values from {self.dark} to {self.bright}: black to white between these"
        return "" if self.bit_depth == _BIT_DEPTHS[-1] else f"16-bit images with values of {self.bit_depth} bits"

    def join(self, other: "GreyRange") -> "GreyRange":
        """Return the range of two sets of images."""
        return GreyRange(
            min(self.dark, other.dark), max(self.bright, other.bright), max(self.max_value, other.max_value)
        )

    def to_8_bits(self, values: NDArray[np.uint16]) -> Image:
        """Scale values (H, W): the eight highest bits of the sensor's, or a narrow range stretched."""
        if self.is_narrow:
            stretched = (values.astype(np.float32) - self.dark) * (255.0 / (self.bright - self.dark))
            return np.clip(np.rint(stretched), 0, 255).astype(np.uint8)
        return np.minimum(values >> (self.bit_depth - 8), 255).astype(np.uint8)


FULL_RANGE = GreyRange(0, 65535, 65535)


def measure_grey_range(values: NDArray[np.uint16]) -> GreyRange:
    """Measure the values (H, W) or (H, W, channels) of one image."""
    dark, bright = np.percentile(values[::_STEP, ::_STEP], _PERCENT)
    return GreyRange(int(dark), int(bright), int(values.max()))
