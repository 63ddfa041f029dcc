"""Mutual nearest-neighbour matching of float descriptors, with Lowe's ratio test."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float32]


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
    nearest, best, runner_up, back = _nearest_both_ways(first, np.ascontiguousarray(second.T))
    # of unit vectors: distance^2 = 2 - 2 similarity
    clear = np.maximum(1 - best, 0) < ratio**2 * (1 - runner_up)
    keep = np.flatnonzero((back[nearest] == np.arange(len(first))) & clear)
    return np.stack([keep, nearest[keep]], axis=1)


@njit(cache=True)
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


@njit(cache=True)
def _nearest_both_ways(
    first: Floats, second_columns: Floats
) -> tuple[NDArray[np.intp], Floats, Floats, NDArray[np.intp]]:
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
