"""The dense map: a database of one descriptor of every image, which compares each query with all of them.

A query takes time in proportion to the map, one byte of memory traffic for each number. Products of whole numbers are
exact, so that neither threads nor the order of summation can change a bit.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.growing_array import GrowingArray

Floats = NDArray[np.float32]

STEPS = 127  # the largest number of a vector is stored as this many steps, in one byte


class DescriptorDatabase:
    """Descriptors of whole images by location (0, 1, 2, ...), one byte a number, compared by their cosine (eq. 4.3)."""

    def __init__(self) -> None:
        self._vectors: GrowingArray[np.int8] = GrowingArray(np.int8)
        self._norms: GrowingArray[np.float64] = GrowingArray(np.float64)

    def __len__(self) -> int:
        return len(self._norms)

    def add(self, vector: Floats) -> None:
        """Append a vector (D,) of any length; the first one determines D.

        Raises:
            ValueError: the vector has another D, or holds numbers that are not finite.
        """
        small = self._quantize(vector)
        self._vectors.extend(small[None])
        self._norms.extend(np.array([_norm(small)]))

    def similarities(self, vector: Floats, count: int) -> NDArray[np.float64]:
        """Compute the cosine (count,) of a query (D,) and each of the first vectors; 0 where either is zero."""
        small = self._quantize(vector)
        lengths = self._norms.rows.reshape(-1)[:count] * _norm(small)
        products = dot_products(small, self._vectors.rows[:count]) if count else np.empty(0, np.int64)
        return np.divide(products, lengths, out=np.zeros(count), where=lengths > 0)

    def _quantize(self, vector: Floats) -> NDArray[np.int8]:
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
        return {"vectors": self._vectors.state(), "lengths": self._norms.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self._vectors.restore(state["vectors"])
        self._norms.restore(state["lengths"])


def _norm(vector: NDArray[np.int8]) -> float:
    whole = vector.astype(np.int64)
    return float(np.sqrt(whole @ whole))


@njit(cache=True, nogil=True)
def dot_products(query: NDArray[np.int8], rows: NDArray[np.int8]) -> NDArray[np.int64]:
    """Compute the dot product (N,) of a query (D,) and each row of (N, D), exact for D up to 130,000."""
    # 127^2 x 130,000 is just below 2^31: sums fit into 32 bits, which SIMD adds twice as fast as 64.
    out = np.empty(len(rows), np.int64)
    for k in range(len(rows)):
        row, total = rows[k], np.int32(0)
        for i in range(len(query)):
            total += np.int32(query[i]) * np.int32(row[i])
        out[k] = total
    return out


@njit(cache=True, nogil=True)
def absolute_differences(query: NDArray[np.uint8], rows: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Compute the sum (N,) of the absolute differences of a query (D,) and each row of (N, D)."""
    out = np.empty(len(rows), np.int64)
    for k in range(len(rows)):
        row, total = rows[k], np.int32(0)
        for i in range(len(query)):
            total += abs(np.int32(query[i]) - np.int32(row[i]))
        out[k] = total
    return out
