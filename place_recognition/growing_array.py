"""Storage that grows with the map: an array of rows in memory, and records of one size that are spilled to disk."""

import errno
import os
import tempfile
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

Scalar = TypeVar("Scalar", bound=np.generic)
Record = NDArray[np.void]


class GrowingArray(Generic[Scalar]):
    """Rows of one shape and type; appending one takes constant time on average, as full storage is doubled."""

    def __init__(self, dtype: type[Scalar]) -> None:
        self._storage: NDArray[Scalar] = np.empty((0, 0), dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def rows(self) -> NDArray[Scalar]:
        """View (N, ...) of all rows so far, (0, 0) before the first; adding more rows does not change it."""
        return self._storage[: self._count]

    def extend(self, rows: NDArray[Scalar]) -> None:
        """Append rows (K, ...); the first ones determine the shape."""
        needed = self._count + len(rows)
        if needed > len(self._storage):
            shape = (max(needed, 2 * len(self._storage)), *rows.shape[1:])
            larger = np.empty(shape, self._storage.dtype)
            if self._count:
                larger[: self._count] = self.rows
            self._storage = larger
        self._storage[self._count : needed] = rows
        self._count = needed

    @property
    def memory_bytes(self) -> int:
        """Memory of the rows; the system provides the rest of the storage when it is written to."""
        return self.rows.nbytes

    def state(self) -> NDArray[Scalar]:
        """The rows, not copied, for a checkpoint."""
        return self.rows

    def restore(self, rows: NDArray[Scalar]) -> None:
        """Take over the rows of another array of the same dtype; they belong to this one from now on.

        Raises:
            ValueError: another dtype.
        """
        if rows.dtype != self._storage.dtype:
            raise ValueError(f"expected rows of {self._storage.dtype}, got {rows.dtype}")
        self._storage, self._count = rows, len(rows)


class SpillFile:
    """Records in the order in which they were appended: the latest in memory, the older ones in a temporary file.

    The file has no name where the system allows it, so that it is gone with the process, however that ends. Records are
    read and written by system calls (docs/decisions/feature_spilling.md).

    Attributes:
        dtype: structured type of a record.
    """

    def __init__(self, dtype: np.dtype[np.void], in_memory: int) -> None:
        self.dtype = dtype
        self._latest = np.zeros(in_memory, dtype)  # a ring buffer; pages that nothing was written to cost no memory
        self._count = 0
        self._erased: set[int] = set()
        self._file = tempfile.TemporaryFile(prefix="revisit-map-", buffering=0)  # noqa: SIM115 - lives as long as this

    def __len__(self) -> int:
        return self._count

    @property
    def memory_bytes(self) -> int:
        """Memory of the records in the ring buffer."""
        return min(self._count, len(self._latest)) * self.dtype.itemsize

    @property
    def disk_bytes(self) -> int:
        """Size of the temporary file; erased records take no room in it."""
        spilled = max(self._count - len(self._latest), 0)
        return (spilled - sum(index < spilled for index in self._erased)) * self.dtype.itemsize

    def append(self, record: Record) -> None:
        """Append a record ().

        Raises:
            OSError: the disk is full.
        """
        slot = self._count % len(self._latest)
        if self._count >= len(self._latest):
            self._spill(self._count - len(self._latest), self._latest[slot])
        self._latest[slot] = record
        self._count += 1

    def read(self, index: int) -> Record:
        """Return the record () of an index, which is valid until the next one is appended."""
        if index in self._erased:
            return np.zeros((), self.dtype)[()]
        if index >= self._count - len(self._latest):
            return self._latest[index % len(self._latest)]
        size = self.dtype.itemsize
        return np.frombuffer(os.pread(self._file.fileno(), size, index * size), self.dtype)[0]

    def erase(self, index: int) -> None:
        """Turn a record into zeros, which take no room on the disk if it has not been written there yet."""
        self._erased.add(index)

    def state(self) -> Record:
        """All records (N,), wherever they are now, for a checkpoint; erased ones cost neither time nor memory."""
        records = np.zeros(self._count, self.dtype)
        for index in range(self._count):
            if index not in self._erased:
                records[index] = self.read(index)
        return records

    def restore(self, records: Record) -> None:
        """Take over records (N,) into a file that has none.

        Raises:
            ValueError: records of another type.
            OSError: the disk is full.
        """
        if records.dtype != self.dtype:
            raise ValueError(f"expected records of {self.dtype}, got {records.dtype}")
        for index, record in enumerate(records):
            self.append(record)
            if not any(record.tobytes()):
                self.erase(index)

    def _spill(self, index: int, record: Record) -> None:
        if index in self._erased:
            return
        size = self.dtype.itemsize
        try:
            written = os.pwrite(self._file.fileno(), record.tobytes(), index * size)
        except OSError as error:
            raise OSError(error.errno, f"{self._disk_full_message(index)}: {error.strerror}") from error
        if written < size:
            raise OSError(errno.ENOSPC, self._disk_full_message(index))

    def _disk_full_message(self, index: int) -> str:
        needed = self.dtype.itemsize * (index + 1) / 1e9
        return (
            f"cannot keep the features of older images in {tempfile.gettempdir()} ({needed:.1f} GB so far); "
            "make room there or point TMPDIR at a larger disk"
        )
