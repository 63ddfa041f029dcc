"""Matrices of `.npz` and MATLAB files from elsewhere, read so that a damaged file costs an error and never more.

`numpy.load` reserves the memory that an array's header states before it reads a number, so a small file could claim a
large memory. Here the header must agree with the size of the zip member, and that with the size of the file.

SciPy, which reads MATLAB files, trusts the sizes that a file states, and a damaged byte can make it crash the
interpreter. It runs in a process of its own (`matlab_process.py`), which may crash, hang or run out of memory.
"""

import math
import os
import signal
import subprocess
import sys
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

MAX_COMPRESSION = 1032  # bytes that one byte of a deflate stream can stand for (zlib's technical details)

READER = Path(__file__).with_name("matlab_process.py")
# Starting Python and SciPy takes about half a second, and the largest published matrix (4,661 x 4,661) a tenth.
TIMEOUT_S = 30.0
# The reader's whole address space. Python, NumPy and SciPy reserve about one gigabyte, most of it never used.
MAX_MEMORY_BYTES = 4 << 30
MAX_REASON_LENGTH = 200  # characters of an error of SciPy's: the message stays one line

_HEADER_READERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def read_array(path: Path, name: str) -> NDArray[Any] | None:
    """Read one array of a `.npz` file; None where the file has none of that name.

    Raises:
        ValueError: the file is missing or damaged; the message is what was found, without the file's name.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = {member.filename.removesuffix(".npy"): member for member in archive.infolist()}
            if name not in members:
                return None
            _check_size(archive, members[name], path.stat().st_size)
            return _read_member(archive, members[name])
    except Exception as error:  # the library lets whatever a damaged byte provokes through: zlib.error, TokenError, ...
        raise ValueError(" ".join(str(error).split()) or type(error).__name__) from error


def array_names(path: Path) -> tuple[str, ...]:
    """List the names of the arrays of a sound `.npz` file."""
    with zipfile.ZipFile(path) as archive:
        return tuple(name.removesuffix(".npy") for name in archive.namelist())


def _check_size(archive: zipfile.ZipFile, member: zipfile.ZipInfo, archive_bytes: int) -> None:
    with archive.open(member) as file:
        version = npy.read_magic(file)
        if version not in _HEADER_READERS:
            raise ValueError(f"an array of version {version}")
        shape, _, dtype = _HEADER_READERS[version](file)
        stated = math.prod(shape) * dtype.itemsize
        held = member.file_size - file.tell()
        if dtype.hasobject or stated != held or member.file_size > MAX_COMPRESSION * archive_bytes:
            raise ValueError(f"{member.file_size} bytes for {shape} values of {dtype}")


def _read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(member) as file:
        array: NDArray[Any] = npy.read_array(file, allow_pickle=False)
        file.read()  # to the end, where zipfile compares the checksum
    return array


@dataclass(frozen=True)
class NumberMatrix:
    """A matrix of numbers, as far as a truth needs it.

    Attributes:
        positive: (R, C) bool, which numbers are above 0.
        num_values: how many different numbers there are, at most `matlab_process.MAX_VALUES`.
        num_nans: how many cells are NaN, neither above 0 nor not.
    """

    positive: NDArray[np.bool_]
    num_values: int
    num_nans: int = 0


def read_matrices(path: Path) -> dict[str, NumberMatrix]:
    """Read the matrices of a MATLAB file.

    Args:
        path: file of version 4 to 7.2.

    Returns:
        Name to matrix, for all variables that are two-dimensional arrays of more than one real number, dense or sparse,
        and for such fields of structures, as `structure.field`. All other variables are left out.

    Raises:
        ValueError: the file is damaged or of another kind; the message is what was found, without the file's name.
    """
    command = [sys.executable, "-P", "-W", "ignore", str(READER), str(path), str(MAX_MEMORY_BYTES)]
    # One thread of BLAS: each further one reserves memory of the limited address space, and none is used.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    try:
        process = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, timeout=TIMEOUT_S, env=environment, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise ValueError(f"one that takes more than {TIMEOUT_S:g} s to read") from error
    if process.returncode != 0:
        raise ValueError(_failure(process.returncode, process.stderr))
    return _unpack(process.stdout)


def _failure(code: int, errors: bytes) -> str:
    """Describe in one printable line why the reader failed."""
    if code < 0:
        names = {number.value: number.name for number in signal.Signals}
        return f"one that crashes SciPy ({names.get(-code, -code)})"
    lines = errors.decode("ascii", "replace").strip().splitlines() or ["one that ends the reader without a reason"]
    printable = "".join(letter if letter.isprintable() else "?" for letter in " ".join(lines[-1].split()))
    return printable[:MAX_REASON_LENGTH]


def _unpack(output: bytes) -> dict[str, NumberMatrix]:
    """Read the matrices that the reader has written: for each "NAME ROWS COLUMNS VALUES NANS", then its bits."""
    matrices, at = {}, 0
    while at < len(output):
        end = output.index(b"\n", at)
        name, rows, columns, num_values, num_nans = output[at:end].decode().split(" ")
        shape = int(rows), int(columns)
        cells = shape[0] * shape[1]
        packed = np.frombuffer(output, np.uint8, -(-cells // 8), end + 1)
        positive = np.unpackbits(packed, count=cells).astype(np.bool_).reshape(shape)
        matrices[name] = NumberMatrix(positive, int(num_values), int(num_nans))
        at = end + 1 + len(packed)
    return matrices
