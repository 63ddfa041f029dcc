"""Something that grows with the drive, recorded so that the file grows likewise and not with the square."""

from collections.abc import Callable

import numpy as np
import rerun as rr
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MOST_ROWS = 1000  # of a line that is logged again with every loop


class Growing:
    """Rows (N, 3), metres, shown under one path and its parts.

    A viewer shows what was logged last to a path. So the newest rows are logged again with each addition, and
    whenever there are enough of them they become a part of their own, which is then left alone.
    """

    def __init__(self, recording: rr.RecordingStream, path: str, draw: Callable[[Array], object], size: int) -> None:
        self._recording = recording
        self._path = path
        self._draw = draw
        self._size = size
        self._parts = 0
        self._newest = np.empty((0, 3))

    def append(self, rows: Array) -> None:
        """Add rows (M, 3)."""
        self._newest = np.concatenate([self._newest, rows])
        if len(self._newest) > self._size:
            self._recording.log(f"{self._path}/part_{self._parts:03d}", self._draw(self._newest))
            self._parts += 1
            self._newest = self._newest[-1:]  # so that a line has no gap
        self._recording.log(self._path, self._draw(self._newest))

    def replace(self, rows: Array) -> None:
        """Forget what was shown and show rows (M, 3) instead, thinned where they are many."""
        self.clear()
        if len(rows):
            stride = len(rows) // _MOST_ROWS + 1
            self._recording.log(f"{self._path}/part_000", self._draw(np.concatenate([rows[::stride], rows[-1:]])))
            self._parts, self._newest = 1, rows[-1:]

    def conclude(self, rows: Array) -> None:
        """Show rows (M, 3) at the end of the drive, all of them under the path itself."""
        self.clear()
        self._recording.log(self._path, self._draw(rows))

    def clear(self) -> None:
        """Show nothing any more."""
        for part in range(self._parts):
            self._recording.log(f"{self._path}/part_{part:03d}", rr.Clear(recursive=False))
        self._recording.log(self._path, rr.Clear(recursive=False))
        self._parts, self._newest = 0, np.empty((0, 3))
