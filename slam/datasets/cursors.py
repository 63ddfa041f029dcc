"""Images by their index, out of something that can only be read forward: a video, a bag."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from slam.errors import DataError

Image = NDArray[np.uint8]

_CURSORS = 2  # one goes along with the drive, the other looks back at what a loop was closed with


@dataclass
class _Cursor:
    """Stands before the image that it gives next."""

    images: Iterator[Image]
    next: int


@dataclass
class Cursors:
    """Gives images by index: the cursor that stands before the wanted one goes on, else another one is moved there.

    Threads may ask at the same time.

    Attributes:
        open_at: starts to read at an image.
    """

    open_at: Callable[[int], Iterator[Image]]
    _cursors: list[_Cursor] = field(default_factory=list)  # the one used longest ago comes first
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __getitem__(self, index: int) -> Image | None:
        """Image (H, W) uint8, or None where nothing more can be read."""
        with self._lock:
            cursor = next((c for c in self._cursors if c.next == index), None) or self._moved(index)
            self._cursors = [*(c for c in self._cursors if c is not cursor), cursor]
            image = next(cursor.images, None)
            cursor.next = index + 1 if image is not None else -1
            return image

    def image(self, index: int, count: int, where: Callable[[int], str], kind: str) -> Image:
        """Image (H, W) uint8 of so many of a source of this kind, which tells where each one is.

        Raises:
            IndexError: no such image.
            DataError: it cannot be read.
        """
        if not 0 <= index < count:
            raise IndexError(f"expected an image from 0 to {count - 1}, got {index}")
        image = self[index]
        if image is None:
            raise DataError(f"{where(index)}: expected an image, found none; copy the {kind} again")
        return image

    def _moved(self, index: int) -> _Cursor:
        if len(self._cursors) == _CURSORS:
            self._cursors.pop(0)  # its generator closes what it has open
        return _Cursor(self.open_at(index), index)
