"""Matrices of MATLAB files (.mat), read by SciPy in a process of its own.

SciPy trusts the sizes that a file states, and a damaged byte can make it crash the interpreter. A process that crashes,
hangs or runs out of memory costs one error here, and never the program.
"""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

READER = Path(__file__).with_name("matlab_process.py")
# Starting Python and SciPy takes about half a second, and the largest published matrix (4,661 x 4,661) a tenth.
TIMEOUT_S = 30.0
# The reader's whole address space. Python, NumPy and SciPy reserve about one gigabyte, most of it never used.
MAX_MEMORY_BYTES = 4 << 30
MAX_REASON_LENGTH = 200  # characters of an error of SciPy's: the message stays one line


def read_positive(path: Path) -> dict[str, NDArray[np.bool_]]:
    """Read which numbers of each matrix in a MATLAB file are above 0.

    Args:
        path: file of version 4 to 7.2.

    Returns:
        Name to matrix (R, C), for all variables that are two-dimensional arrays of more than one real number, dense or
        sparse. All other variables are left out.

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


def _unpack(output: bytes) -> dict[str, NDArray[np.bool_]]:
    """Read the matrices that the reader has written: for each a line "NAME ROWS COLUMNS", then its packed bits."""
    matrices, at = {}, 0
    while at < len(output):
        end = output.index(b"\n", at)
        name, rows, columns = output[at:end].decode().split(" ")
        shape = int(rows), int(columns)
        cells = shape[0] * shape[1]
        packed = np.frombuffer(output, np.uint8, -(-cells // 8), end + 1)
        matrices[name] = np.unpackbits(packed, count=cells).astype(np.bool_).reshape(shape)
        at = end + 1 + len(packed)
    return matrices
