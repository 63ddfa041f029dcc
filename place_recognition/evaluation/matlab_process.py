"""Reads a MATLAB file with SciPy; `ground_truth_files.read_positive` runs it in a process of its own, which may crash.

    python matlab_process.py FILE MAX_MEMORY_BYTES

The process writes matrices to standard output as plain bits, or one line of what is wrong to standard error. It imports
nothing of the project, so that it starts quickly.
"""

import sys

MAX_CELLS = 1 << 27  # of a matrix: a few bytes can state a sparse one of any size; 11,585 images have as many pairs


def main() -> None:
    """Write "NAME ROWS COLUMNS" and the bits "above 0", packed by rows, of every matrix with more than one number."""
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
        # A damaged name could hold a space or a line feed, which end the name in the output.
        if not name.isidentifier() or name.startswith("__") or len(value.shape) != 2 or value.dtype.kind not in "biuf":
            continue
        cells = value.shape[0] * value.shape[1]
        if cells > MAX_CELLS:
            raise ValueError(f"a matrix {value.shape} of more than {MAX_CELLS} numbers")
        if issparse(value):
            value.check_format(full_check=True)  # SciPy writes outside the array where an index is damaged
            value = value.toarray()
        if cells > 1:
            sys.stdout.buffer.write(f"{name} {value.shape[0]} {value.shape[1]}\n".encode())
            sys.stdout.buffer.write(np.packbits(np.greater(value, 0)).tobytes())


if __name__ == "__main__":
    main()
