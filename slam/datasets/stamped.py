"""Tables whose first column is a time: lists of images and of poses, as EuRoC (csv) and TUM (blanks) write them."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.datasets.images import ImageSequence
from slam.errors import DataError
from slam.storage.text import read_lines

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Table:
    """How a table is written.

    Attributes:
        separator: regular expression between cells.
        second: of the first column, how many make one second.
    """

    separator: str
    second: float


CSV_NANOSECONDS = Table(r"\s*,\s*", 1e9)
BLANKS_SECONDS = Table(r"\s+", 1.0)


def read_image_list(path: Path, folder: Path, table: Table) -> ImageSequence:
    """Images that a table lists: time and file name.

    Args:
        path: of the table.
        folder: where the files lie.
        table: how it is written.

    Raises:
        DataError: the table is missing, empty, damaged or not in the order of time, or an image is missing.
    """
    rows = _cells(path, table, 2)
    times = np.array([_number(path, cells[0]) for cells in rows]) / table.second
    check_increasing(path, times)
    files = tuple(folder / cells[1] for cells in rows)
    missing = next((file for file in files if not _is_file(file)), None)
    if missing is not None:
        raise DataError(f"{path}: expected the image {missing}, which it lists, found none; unpack it again")
    return ImageSequence(path.parent.name, files, times)


def read_stamped(path: Path, table: Table, columns: int) -> Array:
    """Numbers (N, columns) of a table; the first column becomes seconds, and increases. Further columns are left out.

    Raises:
        DataError: the table is missing, empty, damaged or not in the order of time.
    """
    rows = np.array([[_number(path, cell) for cell in cells[:columns]] for cells in _cells(path, table, columns)])
    rows[:, 0] /= table.second
    check_increasing(path, rows[:, 0])
    return rows


def check_increasing(path: Path, times: Array) -> None:
    """Raise DataError unless times increase."""
    wrong = np.diff(times) <= 0
    if wrong.any():
        at = int(np.argmax(wrong))
        raise DataError(
            f"{path}: expected increasing times, found {times[at + 1]:.6f} after {times[at]:.6f}; mend those lines"
        )


def _cells(path: Path, table: Table, columns: int) -> list[list[str]]:
    """Lines that say something, in at least so many cells."""
    rows = []
    for number, line in enumerate(read_lines(path), start=1):
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        cells = re.split(table.separator, text)
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
    except OSError:  # a name too long to be one
        return False
