"""Reads lists whose first column is a time: images and poses, as EuRoC (commas) and TUM (spaces) write them."""

import re
from dataclasses import dataclass
from itertools import compress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.datasets.formats.image_sequence import ImageSequence, list_images
from slam.datasets.time_sync import describe_lines, order_by_time, short_name
from slam.errors import DataError
from slam.io.files import read_lines

Array = NDArray[np.float64]

_MAX_MISSING = 0.1  # share of listed images that may be missing; more are a copy that failed


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


def read_image_list(
    path: Path, folder: Path, list_format: ListFormat, columns: tuple[int, int] = (0, 1)
) -> ImageSequence:
    """Read a list of images: time and file name in each line. They are sorted by time, with a remark.

    A few listed images that do not exist are left out, with a remark.

    Args:
        path: list to read.
        folder: folder that the file names are relative to.
        list_format: syntax of the list.
        columns: those of the time and of the file name, from 0.

    Raises:
        DataError: the list is missing, empty or damaged, or more than a tenth of the images are missing.
    """
    time, name = columns
    lines, cells = read_cells(path, list_format, max(columns) + 1)
    ticks = np.array([_number(path, line, row[time]) for line, row in zip(lines, cells, strict=True)])
    ordered = order_by_time(path, ticks, list_format.ticks_per_second, lines)
    files = tuple(folder / cells[row][name] for row in ordered.rows)
    is_there = np.array([_is_file(file) for file in files], bool)
    missing = _describe_missing(path, files, is_there)
    if not files:
        raise DataError(f"{path}: expected a time in each line, found none; export it again")
    listed = {folder / row[name] for row in cells}
    return ImageSequence(
        path.parent.name,
        tuple(compress(files, is_there)),
        ordered.seconds[is_there],
        remarks=(*ordered.remarks, *missing, *_describe_unlisted(path, listed)),
    )


def _describe_missing(path: Path, files: tuple[Path, ...], is_there: NDArray[np.bool_]) -> list[str]:
    """A remark about listed images that do not exist. Raises DataError if they are more than a tenth."""
    count = len(files) - int(is_there.sum())
    if not count:
        return []
    first = files[int(np.argmin(is_there))]
    if count > _MAX_MISSING * len(files):
        raise DataError(
            f"{path}: expected the image {first}, which it lists, found none; {count} of {len(files)} listed images are"
            " missing: unpack them again"
        )
    return [
        f"{short_name(path)}: {count} of {len(files)} listed images are missing and left out, the first is {first.name}"
    ]


def _describe_unlisted(path: Path, listed: set[Path]) -> list[str]:
    """Remarks about images in the folders of a list that it does not name; beside the list there may be any others."""
    folders = sorted({file.parent for file in listed} - {path.parent})
    unlisted = {folder: [file for file in list_images(folder) if file not in listed] for folder in folders}
    return [
        f"{short_name(path)}: {len(files)} images in {folder.name} are not listed and left out, the first is"
        f" {files[0].name}"
        for folder, files in unlisted.items()
        if files
    ]


@dataclass(frozen=True)
class TimedRows:
    """Rows of numbers in the order of time.

    Attributes:
        values: (N, columns), the first column in seconds, increasing.
        remarks: lines that were left out or sorted, and the unit of the times if it is not the expected one.
    """

    values: Array
    remarks: tuple[str, ...]


def read_timestamped_rows(path: Path, list_format: ListFormat, columns: int) -> TimedRows:
    """Read the first columns of a list of numbers. Lines that cannot be used are left out, with a remark.

    Raises:
        DataError: the list is missing, or no line can be used.
    """
    lines, cells = read_cells(path, list_format)
    values = np.array([_row(row[:columns], columns) for row in cells]).reshape(-1, columns)
    good = np.isfinite(values).all(axis=1)
    if not good.any():
        raise DataError(f"{path}, line {lines[0]}: expected {columns} finite numbers, found none; copy the file again")
    ordered = order_by_time(path, values[good, 0], list_format.ticks_per_second, np.array(lines)[good].tolist())
    values = values[good][ordered.rows]
    values[:, 0] = ordered.seconds
    trouble = f"without {columns} finite numbers are left out"
    return TimedRows(values, (*describe_lines(path, np.array(lines)[~good], trouble), *ordered.remarks))


def read_cells(path: Path, list_format: ListFormat, min_columns: int = 1) -> tuple[list[int], list[list[str]]]:
    """Split all lines but a header, comments and empty ones into cells; return line numbers and cells.

    Raises:
        DataError: the list is missing, has no such line, or one with fewer cells.
    """
    lines: list[int] = []
    rows: list[list[str]] = []
    for number, line in enumerate(read_lines(path), start=1):
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        cells = re.split(list_format.separator, text)
        if not rows and cells[0].lower() != "nan" and re.match(r"[\"']?[a-z]", cells[0].lower()):
            continue  # names of the columns, without a # before them
        if len(cells) < min_columns:
            expected = f"{path}, line {number}: expected {min_columns} cells"
            raise DataError(f"{expected}, found {len(cells)}; copy the file again")
        lines.append(number)
        rows.append(cells)
    if not rows:
        raise DataError(f"{path}: expected lines of {min_columns} cells, found none; copy the file again")
    return lines, rows


def _row(cells: list[str], columns: int) -> list[float]:
    return [_value(cell) for cell in cells] if len(cells) == columns else [np.nan] * columns


def _value(cell: str) -> float:
    """Number in a cell; NaN where there is none."""
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _number(path: Path, line: int, cell: str) -> float:
    """Time in a cell; NaN if the cell says that there is none."""
    number = _value(cell)
    if np.isnan(number) and cell.lower() not in ("nan", "-nan", ""):
        raise DataError(f"{path}, line {line}: expected a time, found {cell[:40]!r}; copy the file again")
    return number


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that is too long for the file system
        return False
