"""A sequence of records of one size: the latest in memory, the older ones spilled to a temporary file."""

import errno
import os
import tempfile

import numpy as np
from numpy.typing import NDArray

Record = NDArray[np.void]


class SpillFile:
    """Records in the order in which they were appended, in bounded memory.

    The file has no name where the system allows it, so that it is gone with the process, however that ends. Records are
    read and written by system calls (docs/decisions/feature_spilling.md).

    Attributes:
        dtype: structured type of a record.
    """

    def __init__(self, dtype: np.dtype[np.void], in_memory: int) -> None:
        self.dtype = dtype
        self._latest = np.zeros(in_memory, dtype)  # a ring buffer; pages that nothing was written to cost no memory
        self._count = 0
        self._file = tempfile.TemporaryFile(prefix="revisit-map-", buffering=0)  # noqa: SIM115 - lives as long as this

    def __len__(self) -> int:
        return self._count

    @property
    def memory_bytes(self) -> int:
        """Memory of the records in the ring buffer."""
        return min(self._count, len(self._latest)) * self.dtype.itemsize

    @property
    def disk_bytes(self) -> int:
        """Size of the temporary file."""
        return max(self._count - len(self._latest), 0) * self.dtype.itemsize

    def append(self, record: Record) -> None:
        """Append a record ().

        Raises:
            OSError: the disk is full.
        """
        slot = self._count % len(self._latest)
        if self._count >= len(self._latest):
            self._write(self._count - len(self._latest), self._latest[slot])
        self._latest[slot] = record
        self._count += 1

    def read(self, index: int) -> Record:
        """Return the record () of an index, which is valid until the next one is appended."""
        if index >= self._count - len(self._latest):
            return self._latest[index % len(self._latest)]
        size = self.dtype.itemsize
        return np.frombuffer(os.pread(self._file.fileno(), size, index * size), self.dtype)[0]

    def state(self) -> Record:
        """All records (N,), wherever they are now, for a checkpoint."""
        early = max(self._count - len(self._latest), 0)
        older = [self.read(index) for index in range(early)]
        latest = np.roll(self._latest, -(early % len(self._latest)))[: self._count - early]
        return np.concatenate([np.array(older, self.dtype), latest])

    def restore(self, records: Record) -> None:
        """Take over records (N,) into a file that has none.

        Raises:
            ValueError: records of another type.
            OSError: the disk is full.
        """
        if records.dtype != self.dtype:
            raise ValueError(f"expected records of {self.dtype}, got {records.dtype}")
        for record in records:
            self.append(record)

    def _write(self, index: int, record: Record) -> None:
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
