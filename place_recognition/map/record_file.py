"""Records of one size, the latest in memory and the older ones in a temporary file."""

import errno
import os
import tempfile

import numpy as np
from numpy.typing import NDArray

Record = NDArray[np.void]


class RecordFile:
    """Records in the order in which they were appended; its memory does not grow with their number.

    The file has no name where the system allows it, so that it is gone with the process, however that ends. Reading
    and writing go past the address space: pages of a mapped file would count as memory of the process.
    """

    def __init__(self, dtype: np.dtype[np.void], in_memory: int) -> None:
        self.dtype = dtype
        self._latest = np.zeros(in_memory, dtype)  # a ring; untouched pages cost nothing
        self._count = 0
        self._file = tempfile.TemporaryFile(prefix="revisit-map-", buffering=0)  # noqa: SIM115 - lives as long as this

    def __len__(self) -> int:
        return self._count

    @property
    def memory_bytes(self) -> int:
        """What it takes of memory: pages of the ring that were never written do not exist."""
        return min(self._count, len(self._latest)) * self.dtype.itemsize

    @property
    def disk_bytes(self) -> int:
        """Size of the file."""
        return max(self._count - len(self._latest), 0) * self.dtype.itemsize

    def append(self, record: Record) -> None:
        """Keep a record ().

        Raises:
            OSError: the disk is full.
        """
        slot = self._count % len(self._latest)
        if self._count >= len(self._latest):
            self._write(self._count - len(self._latest), self._latest[slot])
        self._latest[slot] = record
        self._count += 1

    def read(self, index: int) -> Record:
        """The record () of an index; good until the next one is appended."""
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
            raise OSError(error.errno, f"{self._full(index)}: {error.strerror}") from error
        if written < size:
            raise OSError(errno.ENOSPC, self._full(index))

    def _full(self, index: int) -> str:
        needed = self.dtype.itemsize * (index + 1) / 1e9
        return (
            f"cannot keep the features of older images in {tempfile.gettempdir()} ({needed:.1f} GB so far); "
            "make room there or point TMPDIR at a larger disk"
        )
