"""The dense map: one descriptor of every image, all of which are compared with each query.

A query costs time in proportion to the map, a byte or less of memory traffic for each number; products of whole
numbers are exact, so that neither threads nor the order of summing can change a bit.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.map.growing import GrowingArray

Floats = NDArray[np.float32]

STEPS = 127  # the largest number of a vector is kept as so many steps: one byte


class DenseMap:
    """Descriptors of whole images by location (0, 1, 2, ...): one byte a number, compared by their cosine (eq. 4.3)."""

    def __init__(self) -> None:
        self._vectors: GrowingArray[np.int8] = GrowingArray(np.int8)
        self._lengths: GrowingArray[np.float64] = GrowingArray(np.float64)

    def __len__(self) -> int:
        return len(self._lengths)

    def add(self, vector: Floats) -> None:
        """Append a vector (D,) of any length; the first one settles D.

        Raises:
            ValueError: it has another D, or holds anything but finite numbers.
        """
        small = self._quantised(vector)
        self._vectors.extend(small[None])
        self._lengths.extend(np.array([_length(small)]))

    def similarities(self, vector: Floats, count: int) -> NDArray[np.float64]:
        """Cosine of a query (D,) and each of the first so many vectors: (count,), 0 where either is all zeros."""
        small = self._quantised(vector)
        lengths = self._lengths.rows.reshape(-1)[:count] * _length(small)
        products = dot_products(small, self._vectors.rows[:count]) if count else np.empty(0, np.int64)
        return np.divide(products, lengths, out=np.zeros(count), where=lengths > 0)

    def _quantised(self, vector: Floats) -> NDArray[np.int8]:
        known = self._vectors.rows.shape[1]
        if vector.ndim != 1 or len(vector) == 0 or (len(self) and len(vector) != known):
            wanted = f"({known},)" if len(self) else "(D,)"
            raise ValueError(f"expected a descriptor {wanted}, got {vector.shape}")
        largest = np.abs(vector).max()
        if not np.isfinite(largest):
            raise ValueError("expected a descriptor of finite numbers, got some that are not")
        return np.round(vector * (STEPS / largest) if largest > 0 else vector).astype(np.int8)

    def state(self) -> dict[str, Any]:
        """All descriptors, for a checkpoint."""
        return {"vectors": self._vectors.state(), "lengths": self._lengths.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._vectors.restore(state["vectors"])
        self._lengths.restore(state["lengths"])


def _length(vector: NDArray[np.int8]) -> float:
    whole = vector.astype(np.int64)
    return float(np.sqrt(whole @ whole))


@njit(cache=True)
def dot_products(query: NDArray[np.int8], rows: NDArray[np.int8]) -> NDArray[np.int64]:
    """Product (N,) of a query (D,) with each row of (N, D), exact for D up to 130,000."""
    out = np.empty(len(rows), np.int64)
    for k in range(len(rows)):
        row, total = rows[k], np.int32(0)
        for i in range(len(query)):
            total += np.int32(query[i]) * np.int32(row[i])
        out[k] = total
    return out


@njit(cache=True)
def absolute_differences(query: NDArray[np.uint8], rows: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Sum (N,) of the absolute differences of a query (D,) and each row of (N, D)."""
    out = np.empty(len(rows), np.int64)
    for k in range(len(rows)):
        row, total = rows[k], np.int32(0)
        for i in range(len(query)):
            total += abs(np.int32(query[i]) - np.int32(row[i]))
        out[k] = total
    return out
