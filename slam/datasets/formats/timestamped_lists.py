"""Reads lists whose first column is a time: images and poses, as EuRoC (commas) and TUM (spaces) write them."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.datasets.formats.image_sequence import ImageSequence
from slam.errors import DataError
from slam.io.files import read_lines

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ListFormat:
    """The syntax of a list.

    Attributes:
        separator: regular expression between the cells of a line.
        ticks_per_second: units of the first column in one second.
    """

    separator: str
    ticks_per_second: float


CSV_NANOSECONDS = ListFormat(r"\s*,\s*", 1e9)
SPACE_SEPARATED_SECONDS = ListFormat(r"\s+", 1.0)


def read_image_list(path: Path, folder: Path, list_format: ListFormat) -> ImageSequence:
    """Read a list of images: time and file name in each line.

    Args:
        path: list to read.
        folder: folder that the file names are relative to.
        list_format: syntax of the list.

    Raises:
        DataError: the list is missing, empty, damaged or not in the order of time, or an image is missing.
    """
    rows = _cells(path, list_format, 2)
    times = np.array([_number(path, cells[0]) for cells in rows]) / list_format.ticks_per_second
    check_increasing(path, times)
    files = tuple(folder / cells[1] for cells in rows)
    missing = next((file for file in files if not _is_file(file)), None)
    if missing is not None:
        raise DataError(f"{path}: expected the image {missing}, which it lists, found none; unpack it again")
    return ImageSequence(path.parent.name, files, times)


def read_timestamped_rows(path: Path, list_format: ListFormat, columns: int) -> Array:
    """Read the first columns of a list of numbers: (N, columns), the first column in seconds, increasing.

    Raises:
        DataError: the list is missing, empty, damaged or not in the order of time.
    """
    rows = np.array([[_number(path, cell) for cell in cells[:columns]] for cells in _cells(path, list_format, columns)])
    rows[:, 0] /= list_format.ticks_per_second
    check_increasing(path, rows[:, 0])
    return rows


def check_increasing(path: Path, times: Array) -> None:
    """Raise DataError unless times increase."""
    wrong = np.diff(times) <= 0
    if wrong.any():
        at = int(np.argmax(wrong))
        raise DataError(
            f"{path}: expected increasing times, found {times[at + 1]:.6f} after {times[at]:.6f}; correct those lines"
        )


def _cells(path: Path, list_format: ListFormat, columns: int) -> list[list[str]]:
    """Split all lines but comments and empty ones into cells, at least `columns` in each."""
    rows = []
    for number, line in enumerate(read_lines(path), start=1):
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        cells = re.split(list_format.separator, text)
        if len(cells) < columns:
            raise DataError(f"{path}, line {number}: expected {columns} cells, found {len(cells)}; copy the file again")
        rows.append(cells)
    if not rows:
        raise DataError(f"{path}: expected lines of {columns} cells, found none; copy the file again")
    return rows


def _number(path: Path, cell: str) -> float:
    try:
        number = float(cell)
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise DataError(f"{path}: expected finite numbers, found {cell[:40]!r}; copy the file again")
    return number


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that is too long for the file system
        return False
