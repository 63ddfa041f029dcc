"""Reads a MATLAB file with SciPy; `ground_truth_files.read_matrices` runs it in a process of its own, which may crash.

    python matlab_process.py FILE MAX_MEMORY_BYTES

The process writes matrices to standard output as plain bits, or one line of what is wrong to standard error. It imports
nothing of the project, so that it starts quickly.
"""

import sys
from collections.abc import Iterator
from typing import Any

MAX_CELLS = 1 << 27  # of a matrix: a few bytes can state a sparse one of any size; 11,585 images have as many pairs
MAX_VALUES = 100  # that are counted: a truth has two
MAX_DEPTH = 8  # of structures in structures


def main() -> None:
    """Write "NAME ROWS COLUMNS VALUES NANS" and the packed bits "above 0" of every matrix with more than one number."""
    path, limit = sys.argv[1], int(sys.argv[2])
    try:
        _limit_memory(limit)
        _write_matrices(path)
    except MemoryError:
        sys.exit("one that needs too much memory")
    except Exception as error:  # SciPy lets through whatever a damaged byte provokes
        sys.exit(" ".join(str(error).split()) or type(error).__name__)


def _limit_memory(limit: int) -> None:
    try:
        import resource
    except ImportError:  # not on Windows, where the limit of time alone remains
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    allowed = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
    resource.setrlimit(resource.RLIMIT_AS, (allowed, hard))


def _write_matrices(path: str) -> None:
    import numpy as np
    from scipy.io import loadmat
    from scipy.sparse import issparse

    for name, value in loadmat(path, chars_as_strings=False).items():
        for full_name, matrix in [] if name.startswith("__") else _matrices(name, value):
            cells = matrix.shape[0] * matrix.shape[1]
            if cells > MAX_CELLS:
                raise ValueError(f"a matrix {matrix.shape} of more than {MAX_CELLS} numbers")
            if issparse(matrix):
                matrix.check_format(full_check=True)  # SciPy writes outside the array where an index is damaged
                matrix = matrix.toarray()
            if cells > 1:
                counts = f"{count_values(matrix)} {count_nans(matrix)}"
                header = f"{full_name} {matrix.shape[0]} {matrix.shape[1]} {counts}\n"
                sys.stdout.buffer.write(header.encode())
                sys.stdout.buffer.write(np.packbits(np.greater(matrix, 0)).tobytes())


def count_values(matrix: Any) -> int:
    """Count the different numbers of a matrix (R, C), at most MAX_VALUES; all NaN are one."""
    import numpy as np

    values: set[object] = set()
    for row in matrix:  # by rows, as sorting all numbers at once takes time and memory
        values.update("nan" if value != value else value for value in np.unique(row).tolist())
        if len(values) >= MAX_VALUES:
            return MAX_VALUES
    return len(values)


def count_nans(matrix: Any) -> int:
    """Count the cells of a matrix (R, C) that are NaN."""
    return int((matrix != matrix).sum())  # NaN alone differs from itself; takes matrices of whole numbers too


def _matrices(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield name and matrix of a variable, or of the fields of a structure."""
    # A damaged name could hold a space or a line feed, which end the name in the output.
    if not all(part.isidentifier() for part in name.split(".")) or len(value.shape) != 2:
        return
    if value.dtype.names and value.shape == (1, 1):
        for field in value.dtype.names:
            inside = value[field][0, 0]
            if hasattr(inside, "shape") and name.count(".") < MAX_DEPTH:
                yield from _matrices(f"{name}.{field}", inside)
    elif value.dtype.kind in "biuf":
        yield name, value


if __name__ == "__main__":
    main()
