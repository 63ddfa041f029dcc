"""How many images a camera took between two that arrived."""

from collections import deque

import numpy as np

_REMEMBERED = 15  # intervals
_UNKNOWN = 0.1  # s, what most recordings have


class FrameCounter:
    """Counts the images that a gap in the time stamps stands for; without time stamps none is missing."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._intervals: deque[float] = deque(maxlen=_REMEMBERED)

    @property
    def interval_s(self) -> float:
        """Seconds between two images, usually; a tenth while there are no time stamps."""
        return float(np.median(self._intervals)) if self._intervals else _UNKNOWN

    def frames_since_last(self, timestamp: float | None) -> int:
        """Images from the one before to the one taken at a time in seconds, at least 1."""
        if timestamp is None or not np.isfinite(timestamp):
            return 1
        interval = 0.0 if self._last is None else timestamp - self._last
        self._last = timestamp
        if interval <= 0.0:
            return 1
        median_inverse_depth = self.interval_s if self._intervals else interval
        ticks = max(round(interval / median_inverse_depth), 1)
        self._intervals.append(interval / ticks)
        return ticks
