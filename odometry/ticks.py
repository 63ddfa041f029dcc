"""How many images a camera took between two that arrived."""

from collections import deque
from typing import Any

import numpy as np

_REMEMBERED = 15  # intervals
_UNKNOWN = 0.1  # s, what most recordings have


class Ticks:
    """Counts the images that a gap in the time stamps stands for; without time stamps none is missing."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._intervals: deque[float] = deque(maxlen=_REMEMBERED)

    @property
    def interval(self) -> float:
        """Seconds between two images, usually; a tenth while there are no time stamps."""
        return float(np.median(self._intervals)) if self._intervals else _UNKNOWN

    def since_last(self, timestamp: float | None) -> int:
        """Images from the one before to the one taken at a time in seconds, at least 1."""
        if timestamp is None or not np.isfinite(timestamp):
            return 1
        interval = 0.0 if self._last is None else timestamp - self._last
        self._last = timestamp
        if interval <= 0.0:
            return 1
        usual = self.interval if self._intervals else interval
        ticks = max(round(interval / usual), 1)
        self._intervals.append(interval / ticks)
        return ticks

    def state(self) -> dict[str, Any]:
        """The latest time and intervals, for a checkpoint."""
        return {"last_timestamp": self._last, "intervals_s": list(self._intervals)}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._last = state["last_timestamp"]
        self._intervals = deque(state["intervals_s"], maxlen=self._intervals.maxlen)
