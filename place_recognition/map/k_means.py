"""k-means whose greater part, the search for the nearest of the centres, many can share (Lloyd, IEEE TIT 28(2) 1982).

The bits are those of faiss.Kmeans on one thread, whoever does which block of rows: each search is FAISS's own, over
blocks in which it works anyway, and sums are made here, in the order of the rows. It is imported when it is needed.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import cycle
from typing import Any, Protocol, TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]
Item = TypeVar("Item")
Result = TypeVar("Result")

ROWS = 32768  # of a block; a multiple of the 4,096 that FAISS multiplies at a time
_SPLIT = np.float32(1 / 1024)  # by which the halves of a cluster differ
_SPLIT_SEED = 1234


class Spread(Protocol):
    """The builtin `map`, or one whose work is done elsewhere: results in the order of the items."""

    def __call__(self, work: Callable[[Item], Result], items: Iterable[Item], /) -> Iterator[Result]:
        """The results, one after the other."""
        ...


@dataclass(frozen=True)
class Rows:
    """Some rows of an array (N, D). Where that is mapped from a file, they travel as its name, else as numbers."""

    array: Floats
    begin: int
    end: int

    @property
    def values(self) -> Floats:
        """They (end - begin, D)."""
        return self.array[self.begin : self.end]

    def __reduce__(self) -> tuple[Callable[..., "Rows"], tuple[Any, ...]]:
        """How they travel."""
        if isinstance(self.array, np.memmap):
            return _from_file, (str(self.array.filename), self.begin, self.end)
        return Rows, (self.values, 0, self.end - self.begin)


def _from_file(path: str, begin: int, end: int) -> Rows:
    return Rows(np.lib.format.open_memmap(path, mode="r"), begin, end)


def blocks(array: Floats) -> list[Rows]:
    """All rows of an array (N, D), by ROWS; the same ones whoever works on them."""
    return [Rows(array, begin, min(begin + ROWS, len(array))) for begin in range(0, len(array), ROWS)]


def k_means(rows: Floats, words: int, iterations: int, seed: int, spread: Spread = map) -> Floats:
    """Centres (words, D) of rows (N, D), N at least `words`; the first ones are rows drawn by the seed."""
    centres = rows[_permutation(len(rows), seed)[:words]]
    parts = blocks(rows)
    for _ in range(iterations):
        sums, counts = np.zeros_like(centres), np.zeros(words, np.int64)
        for part, nearest in zip(parts, spread(partial(_nearest, centres), parts), strict=True):
            _add(part.values, nearest, sums)
            counts += np.bincount(nearest, minlength=words)
        centres = sums * (np.float32(1) / np.maximum(counts, 1).astype(np.float32))[:, None]
        _fill_empty(centres, counts.astype(np.float32))
    return centres


def _permutation(count: int, seed: int) -> NDArray[np.int32]:
    import faiss

    order = np.empty(count, np.int32)
    faiss.rand_perm(faiss.swig_ptr(order), count, seed + 1)  # type: ignore[attr-defined]
    return order


def _nearest(centres: Floats, part: Rows) -> Indices:
    """The nearest of centres (K, D) for each row (N,)."""
    import faiss

    # One thread: the sums of a matrix product, and with them a close decision, may depend on how many share it.
    threads = faiss.omp_get_max_threads()
    faiss.omp_set_num_threads(1)
    try:
        index = faiss.IndexFlatL2(centres.shape[1])
        index.add(centres)
        return np.asarray(index.search(np.asarray(part.values), 1)[1][:, 0], np.int64)
    finally:
        faiss.omp_set_num_threads(threads)


@njit(cache=True)
def _add(rows: Floats, nearest: Indices, sums: Floats) -> None:
    """Add each row (N, D) to the sum of its centre, one after the other."""
    for i in range(len(rows)):
        for k in range(rows.shape[1]):
            sums[nearest[i], k] += rows[i, k]


def _fill_empty(centres: Floats, counts: Floats) -> None:
    """Give each centre without rows half of another's, drawn by how many that has; the halves differ a little."""
    import faiss

    draws = faiss.RandomGenerator(_SPLIT_SEED)  # type: ignore[attr-defined]
    spare = np.float32(max(counts.sum() - len(counts), 1))
    shift = np.where(np.arange(centres.shape[1]) % 2, -_SPLIT, _SPLIT)
    chances = ((counts - 1) / spare).tolist()
    for empty in np.flatnonzero(counts == 0).tolist():
        full = next(k for k in cycle(range(len(chances))) if draws.rand_float() < chances[k])
        centres[empty], centres[full] = centres[full] * (1 + shift), centres[full] * (1 - shift)
        counts[empty] = counts[full] / 2
        counts[full] -= counts[empty]
        chances[empty], chances[full] = (float((counts[k] - 1) / spare) for k in (empty, full))
