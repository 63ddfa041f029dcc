"""Reads video files with OpenCV: any image by its index, at the time of its exposure."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.datasets.cursors import SequentialReader
from slam.errors import DataError

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

VIDEO_SUFFIXES = frozenset((".mp4", ".avi", ".mov", ".mkv", ".m4v", ".mpg", ".mpeg", ".webm", ".wmv"))

_DEFAULT_FPS = 30.0  # of a video without frame times and without a frame rate


@dataclass(frozen=True)
class Video:
    """A video file. Opening decodes it once from end to end, because headers are wrong about counts and times.

    Attributes:
        path: video file.
        timestamps: (N,) seconds since the beginning of the video, increasing.
    """

    path: Path
    timestamps: Array
    _reader: SequentialReader

    def __len__(self) -> int:
        return len(self.timestamps)

    def __getitem__(self, index: int) -> Image:
        """Read image (H, W) uint8, grey.

        Raises:
            IndexError: there is no such image.
            DataError: the image cannot be decoded any more.
        """
        return self._reader.read(index, len(self), self.where, "video")

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
    has_times = bool((np.diff(stamps) > 0).all())  # some containers store no frame times
    times = stamps if has_times else np.arange(len(stamps)) / (fps if 0 < fps < np.inf else _DEFAULT_FPS)
    return Video(path, times, SequentialReader(lambda index: _decode_from(path, stamps if has_times else None, index)))


def _open_capture(path: Path) -> cv2.VideoCapture:
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
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
            yield np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
            is_open = capture.grab()
    finally:
        capture.release()


def _seek(capture: cv2.VideoCapture, stamps: Array | None, index: int) -> bool:
    """Seek to an image and return whether its time is the expected one: decoders may miss if frame times vary."""
    if stamps is None or not (capture.set(cv2.CAP_PROP_POS_FRAMES, index) and capture.grab()):
        return False
    nearest = np.argmin(np.abs(stamps - capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0))
    return bool(nearest == index)
