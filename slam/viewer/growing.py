"""An entity that grows with the drive, logged in parts: the file grows linearly, not with the square of the length."""

from collections.abc import Callable

import numpy as np
import rerun as rr
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MAX_REPLACED_ROWS = 1000  # of a line that is logged again with every loop


class GrowingEntity:
    """Rows (N, 3), metres, shown under one entity path and its parts.

    A viewer shows what was logged last to a path, so adding a row means to log all rows again. Here only the newest
    rows are logged again; once they are more than `max_rows` they become a part of their own that stays as it is.
    """

    def __init__(
        self, recording: rr.RecordingStream, path: str, draw: Callable[[Array], object], max_rows: int
    ) -> None:
        self._recording = recording
        self._path = path
        self._draw = draw
        self._max_rows = max_rows
        self._parts = 0
        self._newest = np.empty((0, 3))

    def append(self, rows: Array) -> None:
        """Add rows (M, 3)."""
        self._newest = np.concatenate([self._newest, rows])
        if len(self._newest) > self._max_rows:
            self._recording.log(f"{self._path}/part_{self._parts:03d}", self._draw(self._newest))
            self._parts += 1
            self._newest = self._newest[-1:]  # the next part begins where this one ends: a line has no gap
        self._recording.log(self._path, self._draw(self._newest))

    def replace(self, rows: Array) -> None:
        """Show rows (M, 3) instead of all earlier ones, subsampled if there are many."""
        self.clear()
        if len(rows):
            stride = len(rows) // _MAX_REPLACED_ROWS + 1
            self._recording.log(f"{self._path}/part_000", self._draw(np.concatenate([rows[::stride], rows[-1:]])))
            self._parts, self._newest = 1, rows[-1:]

    def conclude(self, rows: Array) -> None:
        """Show the final rows (M, 3), all of them under the path itself."""
        self.clear()
        self._recording.log(self._path, self._draw(rows))

    def clear(self) -> None:
        """Remove everything from the view."""
        for part in range(self._parts):
            self._recording.log(f"{self._path}/part_{part:03d}", rr.Clear(recursive=False))
        self._recording.log(self._path, rr.Clear(recursive=False))
        self._parts, self._newest = 0, np.empty((0, 3))
