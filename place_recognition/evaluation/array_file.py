"""Arrays in `.npz` files, read so that a file claims no more memory than it has bytes for."""

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

_READERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def read_array(path: Path, name: str) -> NDArray[Any] | None:
    """One array of a `.npz` file, or None where it has none of that name.

    Raises:
        ValueError: the file is missing or damaged; says what was found, without the name of the file.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
            return _array(archive, entries[name]) if name in entries else None
    except Exception as error:  # the library lets whatever a damaged byte provokes through: zlib.error, TokenError, ...
        raise ValueError(" ".join(str(error).split()) or type(error).__name__) from error


def array_names(path: Path) -> tuple[str, ...]:
    """Names of the arrays of a sound `.npz` file."""
    with zipfile.ZipFile(path) as archive:
        return tuple(name.removesuffix(".npy") for name in archive.namelist())


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(entry) as file:
        version = npy.read_magic(file)
        if version not in _READERS:
            raise ValueError(f"an array of version {version}")
        shape, by_columns, dtype = _READERS[version](file)
        size = math.prod(shape) * dtype.itemsize
        if dtype.hasobject or size != entry.file_size - file.tell():
            raise ValueError(f"{entry.file_size} bytes for {shape} values of {dtype}")
        data = file.read(size)
        file.read()  # to the end, where the checksum is compared
    if len(data) != size:
        raise ValueError(f"{len(data)} bytes for {shape} values of {dtype}")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if by_columns else "C")
