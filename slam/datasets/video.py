"""Video files, read with OpenCV."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.datasets.cursors import Cursors
from slam.errors import DataError

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

SUFFIXES = frozenset((".mp4", ".avi", ".mov", ".mkv", ".m4v", ".mpg", ".mpeg", ".webm", ".wmv"))

_USUAL_RATE = 30.0  # images a second, where a video does not even say that


@dataclass(frozen=True)
class Video:
    """A video file, read once from end to end on opening, since headers are wrong about counts and times.

    Attributes:
        path: of the file.
        timestamps: (N,) seconds since its beginning, increasing.
    """

    path: Path
    timestamps: Array
    _cursors: Cursors

    def __len__(self) -> int:
        return len(self.timestamps)

    def __getitem__(self, index: int) -> Image:
        """Read image (H, W) uint8, grey.

        Raises:
            IndexError: no such image.
            DataError: it cannot be read any more.
        """
        return self._cursors.image(index, len(self), self.where, "video")

    def where(self, index: int) -> str:
        """The file and the image's number in it."""
        return f"{self.path}, image {index}"


def is_video(path: Path) -> bool:
    """Whether a path is that of a video file, by its name."""
    return path.suffix.lower() in SUFFIXES and path.is_file()


def open_video(path: Path) -> Video:
    """Open a video and find out how many images it has, and when each was taken.

    Raises:
        DataError: the file is missing or damaged.
    """
    if not path.is_file():
        raise DataError(f"{path}: expected a video, found no such file; check the path")
    capture = _opened(path)
    rate, moments = capture.get(cv2.CAP_PROP_FPS), []
    while capture.grab():
        moments.append(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0)
    capture.release()
    if not moments:
        raise DataError(f"{path}: expected a video, found no image that can be decoded; copy it again or convert it")
    stamps = np.array(moments)
    timed = bool((np.diff(stamps) > 0).all())  # some containers have no times of their own
    times = stamps if timed else np.arange(len(stamps)) / (rate if 0 < rate < np.inf else _USUAL_RATE)
    return Video(path, times, Cursors(lambda index: _images(path, stamps if timed else None, index)))


def _opened(path: Path) -> cv2.VideoCapture:
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise DataError(f"{path}: expected a video, found a file that cannot be decoded; copy it again or convert it")
    return capture


def _images(path: Path, stamps: Array | None, start: int) -> Iterator[Image]:
    """Images from one on. Those before it are decoded too where the file cannot be entered exactly there."""
    capture = _opened(path)
    try:
        there = start > 0 and _enter(capture, stamps, start)
        if not there:
            capture.release()
            capture = _opened(path)
            there = all(capture.grab() for _ in range(start + 1))
        while there:
            _, image = capture.retrieve()
            yield np.asarray(image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
            there = capture.grab()
    finally:
        capture.release()


def _enter(capture: cv2.VideoCapture, stamps: Array | None, index: int) -> bool:
    """Go to an image and tell by its time whether it is that one: where steps vary, a decoder may only guess."""
    if stamps is None or not (capture.set(cv2.CAP_PROP_POS_FRAMES, index) and capture.grab()):
        return False
    nearest = np.argmin(np.abs(stamps - capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0))
    return bool(nearest == index)
