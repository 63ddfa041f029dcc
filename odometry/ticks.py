"""Count of the images that a camera took between two that arrived, by time stamps."""

from collections import deque
from typing import Any

import numpy as np

_HISTORY = 15  # intervals whose median is the camera's
_DEFAULT_INTERVAL_S = 0.1  # that of most recordings


class FrameCounter:
    """Counts the images in each gap between time stamps; without time stamps no image is missing."""

    def __init__(self) -> None:
        self._last: float | None = None
        self._intervals: deque[float] = deque(maxlen=_HISTORY)

    @property
    def interval_s(self) -> float:
        """Median time between two images, seconds; 0.1 s while there are no time stamps."""
        return float(np.median(self._intervals)) if self._intervals else _DEFAULT_INTERVAL_S

    def frames_since_last(self, timestamp: float | None) -> int:
        """Number of images, at least 1, from the last one to the one taken at a time in seconds."""
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

    def state(self) -> dict[str, Any]:
        """The latest time and intervals, for a checkpoint."""
        return {"last_timestamp": self._last, "intervals_s": list(self._intervals)}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._last = state["last_timestamp"]
        self._intervals = deque(state["intervals_s"], maxlen=self._intervals.maxlen)
