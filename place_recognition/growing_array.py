"""An array that grows by rows in constant time a row on average."""

from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

Scalar = TypeVar("Scalar", bound=np.generic)


class GrowingArray(Generic[Scalar]):
    """Rows of one shape and type in storage that doubles when it is full, so that few rows cause a copy."""

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
