"""Random access to images in files that can only be decoded forwards: videos and bags."""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from slam.errors import DataError

Image = NDArray[np.uint8]

# One cursor follows the current frame, the other re-reads the images that loops were closed with.
_MAX_CURSORS = 2


@dataclass
class _Cursor:
    """An open decoder and the index of the image that it gives next."""

    images: Iterator[Image]
    next_index: int


@dataclass
class SequentialReader:
    """Reads images by index; successive indices continue an open decoder, others open a new one. Thread-safe.

    Attributes:
        open_at: starts decoding at an image index.
    """

    open_at: Callable[[int], Iterator[Image]]
    _cursors: list[_Cursor] = field(default_factory=list)  # least recently used first
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __getitem__(self, index: int) -> Image | None:
        """Read image (H, W) uint8, or return None past the last image that can be decoded."""
        with self._lock:
            cursor = next((c for c in self._cursors if c.next_index == index), None) or self._open_cursor(index)
            self._cursors = [*(c for c in self._cursors if c is not cursor), cursor]
            image = next(cursor.images, None)
            cursor.next_index = index + 1 if image is not None else -1
            return image

    def read(self, index: int, count: int, where: Callable[[int], str], container: str) -> Image:
        """Read image (H, W) uint8 of a container with `count` images.

        Args:
            index: of the image, from 0.
            count: number of images that were counted on opening.
            where: file and position of an image, for error messages.
            container: "video" or "bag", for error messages.

        Raises:
            IndexError: there is no such image.
            DataError: the image cannot be decoded.
        """
        if not 0 <= index < count:
            raise IndexError(f"expected an image from 0 to {count - 1}, got {index}")
        image = self[index]
        if image is None:
            raise DataError(f"{where(index)}: expected an image, found none; copy the {container} again")
        return image

    def _open_cursor(self, index: int) -> _Cursor:
        if len(self._cursors) == _MAX_CURSORS:
            self._cursors.pop(0)  # dropping its generator closes the file
        return _Cursor(self.open_at(index), index)
