"""Videos with random access to their images, which can only be decoded forwards; decoded with OpenCV.

`SequentialReader` serves any container of that kind, such as a bag.
"""

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.errors import DataError

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Pixels = TypeVar("Pixels", bound=NDArray[Any])

# Bare streams of images: FFmpeg invents their times.
_STREAM_SUFFIXES = frozenset((".h264", ".264", ".h265", ".265", ".hevc", ".mjpeg", ".mjpg", ".m1v", ".m2v"))
VIDEO_SUFFIXES = _STREAM_SUFFIXES | {
    *(".mp4", ".avi", ".mov", ".mkv", ".m4v", ".mpg", ".mpeg", ".webm", ".wmv", ".asf", ".flv", ".3gp", ".3g2"),
    *(".mts", ".m2ts", ".ts", ".vob", ".mxf", ".ogv", ".divx", ".qt", ".y4m", ".dv"),
}
# One cursor follows the current frame, the other reads the matched images of loops again.
_MAX_CURSORS = 2
_DEFAULT_FPS = 30.0  # of a video without frame times and without a frame rate


@dataclass
class _Cursor(Generic[Pixels]):
    """An open decoder and the index of the image that it gives next."""

    images: Iterator[Pixels]
    next_index: int


@dataclass
class SequentialReader(Generic[Pixels]):
    """Reads images by index; successive indices continue an open decoder, others open a new one. Thread-safe.

    Attributes:
        open_at: starts decoding at an image index.
    """

    open_at: Callable[[int], Iterator[Pixels]]
    _cursors: list[_Cursor[Pixels]] = field(default_factory=list)  # least recently used first
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __getitem__(self, index: int) -> Pixels | None:
        """Read image (H, W), or return None past the last image that can be decoded."""
        with self._lock:
            cursor = next((c for c in self._cursors if c.next_index == index), None) or self._open_cursor(index)
            self._cursors = [*(c for c in self._cursors if c is not cursor), cursor]
            image = next(cursor.images, None)
            cursor.next_index = index + 1 if image is not None else -1
            return image

    def read(self, index: int, count: int, where: Callable[[int], str], container: str) -> Pixels:
        """Read image (H, W) of a container with `count` images.

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

    def _open_cursor(self, index: int) -> _Cursor[Pixels]:
        if len(self._cursors) == _MAX_CURSORS:
            self._cursors.pop(0)  # dropping its generator closes the file
        return _Cursor(self.open_at(index), index)


@dataclass(frozen=True)
class Video:
    """A video file. Opening decodes it once from end to end, because headers are wrong about counts and times.

    Attributes:
        path: video file.
        timestamps: (N,) seconds since the beginning of the video, increasing.
        has_times: whether the file holds these times; if not, they follow from a constant rate.
    """

    path: Path
    timestamps: Array
    has_times: bool
    _reader: SequentialReader[Image]
    _colour_reader: SequentialReader[Image]

    @property
    def remarks(self) -> tuple[str, ...]:
        """A note about times that are assumed."""
        if self.has_times or len(self) < 2:
            return ()
        fps = 1 / (self.timestamps[1] - self.timestamps[0])
        return (f"{self.path.name} holds no times: {fps:g} images a second are assumed; give --fps",)

    def __len__(self) -> int:
        return len(self.timestamps)

    def __getitem__(self, index: int) -> Image:
        """Read image (H, W) uint8, grey.

        Raises:
            IndexError: there is no such image.
            DataError: the image cannot be decoded any more.
        """
        return self._reader.read(index, len(self), self.where, "video")

    def read_color(self, index: int) -> Image | None:
        """Read image (H, W, 3), RGB; None if it is grey.

        Raises:
            IndexError: there is no such image.
            DataError: the image cannot be decoded any more.
        """
        image = self._colour_reader.read(index, len(self), self.where, "video")
        return None if image.ndim == 2 else np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)

    def where(self, index: int) -> str:
        """File and index of an image, for error messages."""
        return f"{self.path}, image {index}"


def is_video(path: Path) -> bool:
    """Whether a path is a video file, by its suffix."""
    return path.suffix.lower() in VIDEO_SUFFIXES and path.is_file()


def open_video(path: Path) -> Video:
    """Open a video, count its images and read their times.

    Raises:
        DataError: the file is missing or damaged.
    """
    if not path.is_file():
        raise DataError(f"{path}: expected a video, found no such file; check the path")
    capture = _open_capture(path)
    fps, times_s = capture.get(cv2.CAP_PROP_FPS), []
    while capture.grab():
        times_s.append(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0)
    capture.release()
    if not times_s:
        raise DataError(f"{path}: expected a video, found no image that can be decoded; copy it again or convert it")
    stamps = np.array(times_s)
    can_seek = bool((np.diff(stamps) > 0).all())  # some containers store no frame times
    times = stamps if can_seek else np.arange(len(stamps)) / (fps if 0 < fps < np.inf else _DEFAULT_FPS)
    seekable = stamps if can_seek else None
    colour = SequentialReader(lambda index: _decode_from(path, seekable, index))
    grey = SequentialReader(lambda index: map(_to_grey, _decode_from(path, seekable, index)))
    return Video(path, times, can_seek and path.suffix.lower() not in _STREAM_SUFFIXES, grey, colour)


def _to_grey(image: Image) -> Image:
    return np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def _open_capture(path: Path) -> cv2.VideoCapture:
    # An absolute path: FFmpeg takes what stands before a colon for a protocol, as in 12:30.mp4.
    capture = cv2.VideoCapture(str(path.absolute()), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise DataError(f"{path}: expected a video, found a file that cannot be decoded; copy it again or convert it")
    return capture


def _decode_from(path: Path, stamps: Array | None, start: int) -> Iterator[Image]:
    """Decode the images from an index on. If seeking misses it, all images before it are decoded too."""
    capture = _open_capture(path)
    try:
        is_open = start > 0 and _seek(capture, stamps, start)
        if not is_open:
            capture.release()
            capture = _open_capture(path)
            is_open = all(capture.grab() for _ in range(start + 1))
        while is_open:
            _, image = capture.retrieve()
            yield np.asarray(image, np.uint8)
            is_open = capture.grab()
    finally:
        capture.release()


def _seek(capture: cv2.VideoCapture, stamps: Array | None, index: int) -> bool:
    """Seek to an image and return whether its time is the expected one: decoders may miss if frame times vary."""
    if stamps is None or not (capture.set(cv2.CAP_PROP_POS_FRAMES, index) and capture.grab()):
        return False
    nearest = np.argmin(np.abs(stamps - capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0))
    return bool(nearest == index)
