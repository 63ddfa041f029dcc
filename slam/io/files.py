"""Text files: writing in one piece, so that a file appears complete or not at all, and reading of lines and numbers."""

import codecs
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from slam.errors import DataError, OutputError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path` with the same suffix; the file written there replaces `path` at the end.

    For libraries that need a file name. If the block fails, the temporary file is removed and `path` stays as it was.

    Raises:
        OutputError: the file cannot be written (no such folder, no permission, disk full).
    """
    temporary = path.with_name(f".{path.stem}-{uuid4().hex[:8]}{path.suffix}")
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(f"{path}: cannot be written, {reason}; choose another folder or make room") from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_writer(path: Path, mode: str = "w") -> Iterator[IO[Any]]:
    """Open `path` to write text ("w": UTF-8, bare line feeds) or bytes ("wb"); it appears at the end.

    Raises:
        OutputError: see `replacing`.
    """
    text = {} if "b" in mode else {"encoding": "utf-8", "newline": "\n"}
    with replacing(path) as temporary, temporary.open(mode, **text) as file:  # type: ignore[call-overload]
        yield file


def check_output_file(path: Path) -> None:
    """Find out before long work whether a file can be written at its end.

    Raises:
        OutputError: the folder is missing or may not be written, or the path is a folder itself.
    """
    folder = path.absolute().parent
    if path.is_dir() or not folder.is_dir():
        found = "a folder" if path.is_dir() else "no such folder"
        raise OutputError(f"{path}: expected a file to write in a folder that exists, found {found}; choose another")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(f"{path}: expected a folder that may be written, found a read-only one; choose another")


def read_text(path: Path) -> str:
    """Return a text of UTF-8, or of UTF-16 with a byte order mark, without that mark.

    Windows editors write the mark, and PowerShell's `>` writes UTF-16; a mark that stayed would spoil the first word.

    Raises:
        OSError: the file cannot be read.
        UnicodeDecodeError: it is no such text.
    """
    data = path.read_bytes()
    is_utf16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return data.decode("utf-16" if is_utf16 else "utf-8-sig")


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file (see `read_text`), without line ends.

    Raises:
        DataError: the file is missing, a folder, not readable or not text.
    """
    try:
        return read_text(path).splitlines()
    except FileNotFoundError:
        raise DataError(f"{path}: expected this file, found none; check the path or copy it there") from None
    except UnicodeDecodeError:
        raise DataError(f"{path}: expected a text file, found other bytes; copy it again") from None
    except OSError as error:
        raise DataError(f"{path}: expected a readable file, found {error.strerror}; check it") from None


def read_numbers(path: Path, columns: int, min_rows: int = 1) -> NDArray[np.float64]:
    """Read a table (N, columns) of finite numbers separated by blanks; empty lines and # lines are skipped.

    Raises:
        DataError: the file has fewer rows than `min_rows`, or a line has another number of words, or a word that is not
            a finite number.
    """
    rows = [
        _numbers(path, number, line, columns)
        for number, line in enumerate(read_lines(path), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if len(rows) < min_rows:
        found = f"{len(rows)} lines" if rows else "an empty file"
        raise DataError(f"{path}: expected lines of {columns} numbers, found {found}; copy it again")
    return np.array(rows, np.float64).reshape(-1, columns)


def check_decimal_points(path: Path, number: int, line: str) -> None:
    """Check that the numbers of a line, between blanks or semicolons, have no decimal commas.

    Raises:
        DataError: they have.
    """
    words = re.split(r"[\s;]+", line.strip("; \t\r\n"))
    if "," in line and all(re.fullmatch(r"[-+]?\d+(,\d+)?([eE][-+]?\d+)?", word) for word in words):
        raise DataError(
            f"{path}, line {number}: expected decimal points, found decimal commas, {line.strip()[:60]!r};"
            " write decimal points"
        )


def _numbers(path: Path, number: int, line: str, columns: int) -> list[float]:
    words = line.split()
    expected = f"{path}, line {number}: expected {columns} finite number{'s' if columns > 1 else ''}"
    if len(words) != columns:
        raise DataError(f"{expected}, found {len(words)}; copy the file again")
    check_decimal_points(path, number, line)
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise DataError(f"{expected}, found {line.strip()[:60]!r}; copy the file again") from None
    if not np.isfinite(values).all():
        raise DataError(f"{expected}, found {line.strip()[:60]!r}; correct that line")
    return values


class PassedOver:
    """Counts the lines of a file that a reader passes over, by what they are."""

    def __init__(self) -> None:
        self._first: dict[str, int] = {}
        self._counts: dict[str, int] = {}

    def __contains__(self, what: str) -> bool:
        return what in self._counts

    def add(self, what: str, line: int) -> None:
        """Count one line."""
        self._first.setdefault(what, line)
        self._counts[what] = self._counts.get(what, 0) + 1

    def names(self) -> list[str]:
        """What was passed over, in the order of its first line."""
        return list(self._counts)

    def describe(self, what: str) -> str:
        """Say how many lines there are, and where the first one is: `3 lines FIX (first in line 7)`."""
        count = self._counts[what]
        return f"{count} line{'s' if count > 1 else ''} {what} (first in line {self._first[what]})"
