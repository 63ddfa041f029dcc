"""Arrays of `.npz` files from elsewhere, checked so that a small file cannot claim a large memory.

`numpy.load` reserves the memory that an array's header states before it reads a number. Here the header must agree with
the size of the zip member, and that with the size of the file.
"""

import math
import zipfile
from pathlib import Path
from typing import Any

from numpy.lib import format as npy
from numpy.typing import NDArray

MAX_COMPRESSION = 1032  # bytes that one byte of a deflate stream can stand for (zlib's technical details)

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
