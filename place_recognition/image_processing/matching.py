"""Mutual nearest-neighbour matching of descriptors, with Lowe's ratio test: of floats, or of 8-bit numbers.

`mutual_matches` takes floats. `match_pairs` and `count_matches` take descriptors in steps of 1 / 127 and find the same
pairs in a tenth of the time; `count_matches` compares one image with many in one compiled call. Products of such unit
vectors are at most 131^2 (256 components: 135^2), so 16 bits hold the sums: half the width of floats, twice as many at
a time.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Bytes = NDArray[np.int8]
Shorts = NDArray[np.int16]
Indices = NDArray[np.int64]

LANES = 16  # 16-bit numbers in a 256-bit SIMD register; columns are padded to a multiple
NONE = np.int16(-20000)  # below all products, and far enough from overflow for the products of padding


def mutual_matches(first: Floats, second: Floats, ratio: float = 0.8) -> NDArray[np.intp]:
    """Match the descriptors of two images that are each other's nearest neighbours.

    Args:
        first: (N, D) descriptors of unit length.
        second: (M, D) descriptors of the other image.
        ratio: largest ratio of the distances to the nearest and the second nearest in `second` (Lowe, IJCV 2004,
            section 7.1); 1 keeps all mutual pairs but those whose descriptor occurs twice.

    Returns:
        (K, 2) indices into first and second, increasing in first; (0, 2) where an image has no descriptors.
    """
    if len(first) == 0 or len(second) == 0:
        return np.empty((0, 2), np.intp)
    nearest, best, runner_up, back = _mutual_nearest(first, np.ascontiguousarray(second.T))
    # of unit vectors: distance^2 = 2 - 2 similarity
    clear = np.maximum(1 - best, 0) < ratio**2 * (1 - runner_up)
    keep = np.flatnonzero((back[nearest] == np.arange(len(first))) & clear)
    return np.stack([keep, nearest[keep]], axis=1)


@njit(cache=True, nogil=True)
def add_products(vector: Floats, columns: Floats, out: Floats) -> None:
    """Add to out (M,) the products of a vector (D,) with each column of (D, M), always summed in the same order.

    A compiled loop over contiguous memory instead of a BLAS: so small a product gains little from BLAS threads and
    waits for them on a busy machine, and the bits of a BLAS result depend on the number of threads.
    """
    whole = len(vector) - len(vector) % 4
    for k in range(0, whole, 4):  # four rows a pass: out is read and written once for four
        a, b, c, d = vector[k], vector[k + 1], vector[k + 2], vector[k + 3]
        first, second, third, fourth = columns[k], columns[k + 1], columns[k + 2], columns[k + 3]
        for j in range(len(out)):
            out[j] += a * first[j] + b * second[j] + c * third[j] + d * fourth[j]
    for k in range(whole, len(vector)):
        row = columns[k]
        for j in range(len(out)):
            out[j] += vector[k] * row[j]


@njit(cache=True, nogil=True)
def _mutual_nearest(first: Floats, second_columns: Floats) -> tuple[NDArray[np.intp], Floats, Floats, NDArray[np.intp]]:
    """Nearest neighbours in both directions.

    Args:
        first: (N, D) descriptors.
        second_columns: (D, M) descriptors of the other image, transposed.

    Returns:
        Of each of first: index (N,) of the nearest in second, its similarity (N,) and that of the second nearest (N,).
        Of each of second: index (M,) of the nearest in first.
    """
    n, m = len(first), second_columns.shape[1]
    nearest, back = np.zeros(n, np.intp), np.zeros(m, np.intp)
    best, runner_up = np.full(n, -np.inf, np.float32), np.full(n, -np.inf, np.float32)
    best_back, similarity = np.full(m, -np.inf, np.float32), np.empty(m, np.float32)
    for i in range(n):
        similarity[:] = 0
        add_products(first[i], second_columns, similarity)
        for j in range(m):
            value = similarity[j]
            if value > best[i]:
                nearest[i], best[i], runner_up[i] = j, value, best[i]
            elif value > runner_up[i]:
                runner_up[i] = value
            if value > best_back[j]:
                back[j], best_back[j] = i, value
    return nearest, best, runner_up, back


def to_columns(quantized: Bytes) -> Bytes:
    """Transpose descriptors (N, D) to columns (D, M), with zeros from column N on; M is a multiple of LANES."""
    count, dimension = quantized.shape
    columns = np.zeros((dimension, -(-count // LANES) * LANES), np.int8)
    columns[:, :count] = quantized.T
    return columns


def count_matches(query: Bytes, others: Bytes, counts: Indices, ratio: float) -> Indices:
    """Count the mutual matches (L,) of an image with each of L other images.

    Args:
        query: (N, D) descriptors of the image.
        others: (L, K, D) descriptors of the other images, padded to K rows each.
        counts: (L,) number of valid rows of each.
        ratio: largest ratio of nearest to second nearest distance in the other image.
    """
    return _count_matches(to_columns(query), len(query), others, counts, ratio)


def match_pairs(query: Bytes, other: Bytes, ratio: float) -> NDArray[np.intp]:
    """Match the rows of query (N, D) and other (M, D) mutually; (K, 2) indices, as `mutual_matches`."""
    matched = _match(to_columns(query), len(query), other, ratio)
    keep = np.flatnonzero(matched >= 0)
    return np.stack([keep, matched[keep]], axis=1)


@njit(cache=True, nogil=True)
def _count_matches(columns: Bytes, count: int, others: Bytes, counts: Indices, ratio: float) -> Indices:
    found = np.zeros(len(others), np.int64)
    for k in range(len(others)):
        found[k] = np.count_nonzero(_match(columns, count, others[k, : counts[k]], ratio) >= 0)
    return found


@njit(cache=True, nogil=True)
def _match(columns: Bytes, count: int, rows: Bytes, ratio: float) -> Indices:
    """Index (count,) of the row that each of the first columns is matched with, -1 without match."""
    width = columns.shape[1]
    matched = np.full(count, -1, np.int64)
    nearest, back = np.zeros(width, np.int16), np.zeros(len(rows), np.int64)
    best, runner_up = np.full(width, NONE, np.int16), np.full(width, NONE, np.int16)
    similarity = np.empty(width, np.int16)
    for i in range(len(rows)):
        similarity[:count] = 0
        similarity[count:] = NONE
        add_integer_products(rows[i], columns, similarity)
        back[i] = _first_largest(similarity)
        _keep_nearest(similarity, np.int16(i), nearest, best, runner_up)
    one = np.float32(127.0 * 127.0)  # 1 in quantised units; for unit vectors distance^2 = 2 - 2 similarity
    for j in range(count):
        clear = max(one - best[j], np.float32(0)) < np.float32(ratio**2) * (one - runner_up[j])
        if len(rows) and back[nearest[j]] == j and (clear or len(rows) == 1):
            matched[j] = nearest[j]
    return matched


@njit(cache=True, nogil=True)
def add_integer_products(vector: Bytes, columns: Bytes, out: Shorts) -> None:
    """Add to out (M,) the products of a vector (D,) with each column of (D, M).

    Eight rows a pass, in plain unit-stride loops that compilers turn into SIMD. With one byte a number the columns of
    500 features stay in the first-level cache, which gains more than the widening to 16 bits costs.
    """
    whole = len(vector) - len(vector) % 8
    for k in range(0, whole, 8):
        a, b, c, d = np.int16(vector[k]), np.int16(vector[k + 1]), np.int16(vector[k + 2]), np.int16(vector[k + 3])
        e, f, g, h = np.int16(vector[k + 4]), np.int16(vector[k + 5]), np.int16(vector[k + 6]), np.int16(vector[k + 7])
        first, second, third, fourth = columns[k], columns[k + 1], columns[k + 2], columns[k + 3]
        fifth, sixth, seventh, eighth = columns[k + 4], columns[k + 5], columns[k + 6], columns[k + 7]
        for j in range(len(out)):
            out[j] += (
                a * first[j] + b * second[j] + c * third[j] + d * fourth[j]
                + e * fifth[j] + f * sixth[j] + g * seventh[j] + h * eighth[j]
            )  # fmt: skip
    for k in range(whole, len(vector)):
        a, first = np.int16(vector[k]), columns[k]
        for j in range(len(out)):
            out[j] += a * first[j]


@njit(cache=True, nogil=True)
def _first_largest(values: Shorts) -> int:
    """Index of the first largest value. Two passes that both become SIMD; one pass that keeps an index does not."""
    maximum = largest(values)
    for j in range(len(values)):
        if values[j] == maximum:
            return j
    return 0


@njit(cache=True, nogil=True)
def largest(values: Shorts) -> int:
    """Return the largest of values (M,), M > 0."""
    maximum = values[0]
    for j in range(len(values)):
        maximum = max(maximum, values[j])
    return maximum


@njit(cache=True, nogil=True)
def _keep_nearest(similarity: Shorts, row: int, nearest: Shorts, best: Shorts, runner_up: Shorts) -> None:
    """Update the nearest row, its similarity and the second largest similarity, all (M,), with one more row.

    Each loop writes one array: compilers use SIMD only where they can exclude that arrays overlap.
    """
    for j in range(len(similarity)):
        runner_up[j] = max(runner_up[j], min(best[j], similarity[j]))
    for j in range(len(similarity)):
        nearest[j] = row if similarity[j] > best[j] else nearest[j]
    for j in range(len(similarity)):
        best[j] = max(best[j], similarity[j])
