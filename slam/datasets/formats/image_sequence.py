"""Grey images from files, and sequences of image files of one uncalibrated camera."""

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property, reduce
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.datasets.grey_levels import FULL_RANGE, GreyRange, measure_grey_range
from slam.datasets.time_sync import are_unclear, find_clock_unit, find_ticks_per_second, short_name, unit_name
from slam.errors import DataError
from slam.io.files import read_lines, read_numbers

Array = NDArray[np.float64]

_MEASURED_FILES = 16  # of a sequence of 16-bit images, to find their range
_MAX_DIGITS = 18  # of a number in a name

IMAGE_SUFFIXES = frozenset(
    (".png", ".jpg", ".jpeg", ".jpe", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".pnm", ".webp", ".jp2")
)
# Words by which the names of the images of two cameras differ, left and right.
_CAMERA_WORDS = (("left", "right"), ("l", "r"), ("cam0", "cam1"), ("camera0", "camera1"), ("cam_0", "cam_1"))
# A name that ends in a number, which may have decimals: text before, digits, decimals, text after.
_NUMBERED = re.compile(r"(.*[^\d.])?(\d+)(?:\.(\d+))?(\D*)")


@dataclass(frozen=True)
class ImageSequence:
    """The image files of one camera in the order of their exposure; each is read on demand.

    Attributes:
        name: name of the folder, or of the KITTI sequence.
        files: N paths, in order.
        timestamps: (N,) seconds, increasing; None where neither a file nor a frame rate gives them.
        ground_truth: T_world_camera (N, 4, 4), metres, or None.
        remarks: notes for the user about times and ground truth.
        partner_files: images of the other camera of a pair; those of 16 bits have one scale in both.
    """

    name: str
    files: tuple[Path, ...]
    timestamps: Array | None
    ground_truth: Array | None = None
    remarks: tuple[str, ...] = ()
    partner_files: tuple[Path, ...] = ()

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

    def read_color(self, index: int) -> NDArray[np.uint8] | None:
        """Read image (H, W, 3), RGB, 8 bits; None if the file holds grey values, or cannot be read."""
        try:
            check_name(self.files[index])
            image = cv2.imread(str(self.files[index]), cv2.IMREAD_ANYCOLOR)
        except (cv2.error, DataError):  # which reading the grey image reports
            return None
        return None if image is None or image.ndim == 2 else np.asarray(image[..., ::-1], np.uint8)

    @cached_property
    def _grey_range(self) -> GreyRange:
        """Range of 16-bit images, by some from all parts of the sequence and of its partner's."""
        cameras = (self.files, self.partner_files)
        some = (_read(path) for files in cameras for path in files[:: max(len(files) // _MEASURED_FILES, 1)])
        ranges = [measure_grey_range(image) for image in some if image is not None and image.dtype == np.uint16]
        return reduce(GreyRange.join, ranges) if ranges else FULL_RANGE

    def where(self, index: int) -> str:
        """Path of an image, for error messages."""
        return str(self.files[index])


def open_image_folder(folder: Path, fps: float | None = None) -> ImageSequence:
    """Open a folder of images, taken in the natural order of their names (2.jpg before 10.jpg).

    Args:
        folder: folder of the images of one camera.
        fps: images per second, where there is no `times.txt`; None if no timestamps are needed.

    Raises:
        DataError: there are no images or those of two cameras, or `fps` is not a frame rate.
    """
    files = list_images(folder)
    if not files:
        raise DataError(f"{folder}: expected images, found none; check the path")
    check_one_camera(files)
    times, remarks = read_or_count_times(folder / "times.txt", len(files), fps)
    return ImageSequence(folder.absolute().name, files, times, remarks=remarks)


def check_one_camera(files: tuple[Path, ...]) -> None:
    """Raise DataError if the names of most images differ in left and right only: they are those of two cameras."""
    names = {file.stem.lower() for file in files}
    for left, right in _CAMERA_WORDS:
        is_word = rf"(?<![a-z]){left}(?!{'[a-z]' if left.isalpha() else '[0-9]'})"
        word = re.compile(left if left == "left" else is_word)  # leftimg0000 is one of a left camera too
        pairs = {name: word.sub(right, name) for name in names}
        both = [name for name, other in pairs.items() if other != name and other in names]
        if len(files) < 4 * len(both):
            example = next(file for file in files if file.stem.lower() == both[0])
            other = next(file for file in files if file.stem.lower() == pairs[both[0]])
            raise DataError(
                f"{example.parent}: expected the images of one camera, found those of two, such as {example.name} and"
                f" {other.name}; move them into two folders called left and right"
            )


def read_grey(path: Path, find_range: Callable[[], GreyRange] = lambda: FULL_RANGE) -> NDArray[np.uint8]:
    """Read an image (H, W) uint8; colour is converted to grey.

    Args:
        path: file of the image.
        find_range: finds the range of values of the recording; called for images of 16 bits.

    Raises:
        DataError: the file is missing or damaged, or its name is not valid Unicode.
    """
    check_name(path)
    image = _read(path)
    if image is None and not path.exists():
        raise DataError(f"{path}: expected an image, found none; was the recording moved, or its disk taken out?")
    if image is None:
        raise DataError(f"{path}: expected an image, found a file that cannot be read; copy it again")
    if image.dtype.kind == "f":
        found = f"{8 * image.itemsize}-bit floats"
        raise DataError(f"{path}: expected an image of 8 or 16 bits, found {found}; save as 8 or 16 bit")
    return find_range().to_8_bits(image) if image.dtype == np.uint16 else np.asarray(image, np.uint8)


def _read(path: Path) -> NDArray[Any] | None:
    """Read an image (H, W), grey, of uint8, uint16 or floats; None if it cannot be read."""
    try:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
        if image is None or image.dtype in (np.uint8, np.uint16) or image.dtype.kind == "f":
            return image
        return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    except cv2.error:  # raised for a header with a size that OpenCV refuses to allocate
        return None


def check_name(path: Path) -> None:
    """Raise DataError if OpenCV cannot open a file of this name."""
    try:
        str(path).encode()
    except UnicodeEncodeError:  # OpenCV would abort the process on such a name
        shown = str(path).encode(errors="replace").decode()
        raise DataError(f"{shown}: expected a file name in Unicode, found other bytes; rename it") from None


def read_times(path: Path, count: int) -> tuple[Array, tuple[str, ...]]:
    """Read `count` increasing times, one per line: seconds (N,), and a remark if the file has another unit.

    TUM's monocular data set and 4Seasons have three numbers in a line: number of the image, time and exposure.

    Raises:
        DataError: the file is missing, has another number of times, or they do not increase.
    """
    lines = enumerate(read_lines(path), start=1)
    rows = [(number, line.split()) for number, line in lines if line.strip() and line.strip()[0] != "#"]
    columns = 3 if rows and len(rows[0][1]) == 3 else 1
    ticks = read_numbers(path, columns)[:, columns // 2]
    if len(ticks) != count:
        raise DataError(
            f"{path}: expected {count} times, one for each image, found {len(ticks)}; copy the whole recording again"
        )
    if (np.diff(ticks) <= 0).any():
        at = int(np.argmax(np.diff(ticks) <= 0)) + 1
        raise DataError(
            f"{path}: expected increasing times, found {ticks[at]} after {ticks[at - 1]} in line {rows[at][0]}; correct"
            " the line, or remove the file and give --fps"
        )
    unit = find_ticks_per_second(ticks, 1.0)
    remark = f"{short_name(path)}: the times are read as {unit_name(unit)}; if they are "
    remark += "milliseconds, divide them by 1000" if unit == 1.0 else "seconds, give --fps instead"
    return ticks / unit, () if unit == 1.0 and not are_unclear(ticks) else (remark,)


def read_or_count_times(path: Path, count: int, fps: float | None) -> tuple[Array | None, tuple[str, ...]]:
    """Read the times of `count` images, or count them at a rate: seconds (N,) or None, and a remark (see `read_times`).

    Raises:
        DataError: the file does not fit the images, or there is none and `fps` is not a frame rate.
    """
    if path.is_file():
        return read_times(path, count)
    if fps is None:
        return None, ()
    if not 0 < fps < np.inf:
        raise DataError(
            f"{path}: expected the times of {count} images, found none, and --fps {fps}; give a rate above 0"
        )
    return np.arange(count) / fps, ()


def times_from_names(files: Sequence[Path]) -> tuple[Array | None, tuple[str, ...]]:
    """Read the times of images from their names if these are dates in seconds, or in thousandths to billionths of them.

    Returns:
        Seconds (N,), increasing, or None where names are no times; and the remark that they were read from names.
    """
    parts = [match.groups() for file in files if (match := _NUMBERED.fullmatch(file.stem))]
    if len(parts) < max(len(files), 2) or len({(part[0], part[3]) for part in parts}) > 1:
        return None, ()
    ticks = np.array([float(f"{part[1]}.{part[2] or 0}") for part in parts])
    unit = find_clock_unit(ticks)
    if unit is None or (np.diff(ticks) <= 0).any():
        return None, ()
    remark = f"{files[0].parent.name}: the times are read from the names, as {unit_name(unit)}; --fps gives others"
    return ticks / unit, (remark,)


def find_numbers(files: Sequence[Path]) -> NDArray[np.int64] | None:
    """Read the numbers (N,), increasing, in which the names of images end; None if they do not all have one."""
    parts = [match.groups() for file in files if (match := _NUMBERED.fullmatch(file.stem))]
    if len(parts) < len(files) or len({(part[0], part[2], part[3]) for part in parts}) > 1 or parts[0][2]:
        return None
    if max(len(part[1]) for part in parts) > _MAX_DIGITS:
        return None
    numbers = np.array([int(part[1]) for part in parts], np.int64)
    return numbers if (np.diff(numbers) > 0).all() else None


def list_images(folder: Path) -> tuple[Path, ...]:
    """Image files of a folder in the order of their names; none if it does not exist."""
    if not folder.is_dir():
        return ()
    return sort_by_name(
        file for file in folder.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES and file.name[0] != "."
    )


def sort_by_name(files: Iterable[Path]) -> tuple[Path, ...]:
    """Sort files by the numbers in their names: as seconds (1.05 before 1.4) if they are, else 2.jpg before 10.jpg."""
    unsorted = list(files)
    key = seconds_sort_key if are_seconds([file.stem for file in unsorted]) else natural_sort_key
    return tuple(sorted(unsorted, key=key))


def are_seconds(names: Sequence[str]) -> bool:
    """Whether names are decimal fractions, rather than two numbers with a point between them such as 1.9 and 1.10.

    Numbers that count have no leading zeros; decimal fractions have no zeros at their end if their lengths differ.
    """
    parts = [match.groups() for name in names if (match := _NUMBERED.fullmatch(name))]
    decimals = [part[2] for part in parts if part[2]]
    if len(parts) < len(names) or not decimals or len({(part[0], part[3]) for part in parts}) > 1:
        return False
    has_leading_zero = any(digits[0] == "0" and len(digits) > 1 for digits in decimals)
    has_last_zero = any(digits[-1] == "0" and len(digits) > 1 for digits in decimals)
    return has_leading_zero or not has_last_zero or len({len(digits) for digits in decimals}) == 1


def seconds_sort_key(path: Path) -> tuple[Decimal, str]:
    """Key that sorts names for which `are_seconds` holds."""
    match = _NUMBERED.fullmatch(path.stem)
    return Decimal(f"{match[2]}.{match[3] or 0}" if match else 0), path.name


def natural_sort_key(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Key that sorts names by the numbers in them."""
    parts = re.findall(r"(\d+)|(\D+)", path.name)
    return [(0, int(digits), "") if digits else (1, 0, word) for digits, word in parts], path.name
