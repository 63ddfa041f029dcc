"""Grey images from files, and sequences of image files of one uncalibrated camera."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, reduce
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.datasets.formats.kitti_files import find_images, find_poses, find_sequence
from slam.datasets.grey_levels import FULL_RANGE, GreyRange, measure_grey_range
from slam.errors import DataError
from slam.io.files import read_numbers
from slam.io.trajectory_files import read_kitti

Array = NDArray[np.float64]

_MEASURED_FILES = 16  # of a sequence of 16-bit images, to find their range

IMAGE_SUFFIXES = frozenset((".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm"))


@dataclass(frozen=True)
class ImageSequence:
    """The image files of one camera in the order of their exposure; each is read on demand.

    Attributes:
        name: name of the folder, or of the KITTI sequence.
        files: N paths, in order.
        timestamps: (N,) seconds, increasing; None where neither a file nor a frame rate gives them.
        poses: KITTI file of ground truth, or None.
    """

    name: str
    files: tuple[Path, ...]
    timestamps: Array | None
    poses: Path | None = None

    @property
    def ground_truth(self) -> Array | None:
        """T_world_camera (N, 4, 4), metres, read from the file; None where there is no file.

        Raises:
            DataError: the file is damaged.
        """
        return None if self.poses is None else read_kitti(self.poses)

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: int) -> NDArray[np.uint8]:
        """Read image (H, W) uint8, grey.

        Raises:
            IndexError: there is no such image.
            DataError: the image cannot be read.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"expected an image from 0 to {len(self) - 1}, got {index}")
        return read_grey(self.files[index], lambda: self._grey_range)

    @cached_property
    def _grey_range(self) -> GreyRange:
        """Range of 16-bit images, by some from all parts of the sequence."""
        some = (_read(path) for path in self.files[:: max(len(self.files) // _MEASURED_FILES, 1)])
        ranges = [measure_grey_range(image) for image in some if image is not None and image.dtype == np.uint16]
        return reduce(GreyRange.joined, ranges) if ranges else FULL_RANGE

    def where(self, index: int) -> str:
        """Path of an image, for error messages."""
        return str(self.files[index])


def open_image_sequence(source: Path, sequence: str | None = None, fps: float | None = None) -> ImageSequence:
    """Open a folder of images, or the left images of a KITTI sequence, which need no calibration here.

    Args:
        source: folder of images, taken in the natural order of their names (2.jpg before 10.jpg), or a folder in
            KITTI odometry layout.
        sequence: name of the KITTI sequence; None where there is only one.
        fps: images per second, where there is no `times.txt`; None if no timestamps are needed.

    Raises:
        DataError: there are no images, or `fps` is not a frame rate.
    """
    folder, files = _folder_and_files(source, sequence)
    poses = find_poses(folder) if files[0].parent != folder else None
    return ImageSequence(folder.absolute().name, files, _timestamps(folder / "times.txt", len(files), fps), poses)


def _folder_and_files(source: Path, sequence: str | None) -> tuple[Path, tuple[Path, ...]]:
    files = list_images(source)
    if files:
        return source, files
    if source.is_dir() and not any(item.is_dir() for item in source.iterdir()):
        raise DataError(f"{source}: expected images or a folder in KITTI layout, found neither; check the path")
    folder = find_sequence(source, sequence)
    return folder, find_images(folder).left


def read_grey(path: Path, find_range: Callable[[], GreyRange] = lambda: FULL_RANGE) -> NDArray[np.uint8]:
    """Read an image (H, W) uint8; colour is converted to grey.

    Args:
        path: file of the image.
        find_range: finds the range of values of the recording; called for images of 16 bits.

    Raises:
        DataError: the file is missing or damaged, or its name is not valid Unicode.
    """
    _check_name(path)
    image = _read(path)
    if image is None and not path.exists():
        raise DataError(f"{path}: expected an image, found none; was the recording moved, or its disk taken out?")
    if image is None:
        raise DataError(f"{path}: expected an image, found a file that cannot be read; copy it again")
    return find_range().to_8_bits(image) if image.dtype == np.uint16 else np.asarray(image, np.uint8)


def _read(path: Path) -> NDArray[Any] | None:
    """Read an image (H, W), uint8 or uint16, grey; None if it cannot be read."""
    try:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
        if image is None or image.dtype in (np.uint8, np.uint16):
            return image
        return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    except cv2.error:  # raised for a header with a size that OpenCV refuses to allocate
        return None


def _check_name(path: Path) -> None:
    try:
        str(path).encode()
    except UnicodeEncodeError:  # OpenCV would abort the process on such a name
        shown = str(path).encode(errors="replace").decode()
        raise DataError(f"{shown}: expected a file name in Unicode, found other bytes; rename it") from None


def read_times(path: Path, count: int) -> Array:
    """Read `count` increasing times, seconds, one per line.

    Raises:
        DataError: the file is missing, has another number of times, or they do not increase.
    """
    times = read_numbers(path, 1)[:, 0]
    if len(times) != count:
        raise DataError(
            f"{path}: expected {count} times, one for each image, found {len(times)}; copy the whole recording again"
        )
    if (np.diff(times) <= 0).any():
        at = int(np.argmax(np.diff(times) <= 0)) + 1
        raise DataError(f"{path}: expected increasing times, found {times[at]} after {times[at - 1]}; correct the line")
    return times


def _timestamps(path: Path, count: int, fps: float | None) -> Array | None:
    if path.is_file():
        return read_times(path, count)
    if fps is None:
        return None
    if not 0 < fps < np.inf:
        raise DataError(
            f"{path}: expected the times of {count} images, found none, and --fps {fps}; give a rate above 0"
        )
    return np.arange(count) / fps


def list_images(folder: Path) -> tuple[Path, ...]:
    """Image files of a folder in the natural order of their names (2.jpg before 10.jpg); none if it does not exist."""
    if not folder.is_dir():
        return ()
    files = [file for file in folder.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES and file.name[0] != "."]
    return tuple(sorted(files, key=natural_sort_key))


def natural_sort_key(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Key that sorts names by the numbers in them."""
    parts = re.findall(r"(\d+)|(\D+)", path.name)
    return [(0, int(digits), "") if digits else (1, 0, word) for digits, word in parts], path.name
