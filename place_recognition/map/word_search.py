"""The nearest of many words that stay as they are: exact, but most words are dismissed after a few numbers."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from place_recognition.belief.matching import add_products

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]

BLOCK = 128  # words bounded at a time: they stay in the cache
# Principal directions in which words are compared first: they hold 97 % of the variance of SURF words, and leave 4 of
# 4,000 words to be compared in full; 15 leave 24, 11 leave 62. Of 11 to 31 the quickest: half the time of all numbers.
DIRECTIONS = 23
ROUNDING = np.float32(
    1e-5
)  # of a bound, as a part of the lengths of both descriptors; 64 sums of float32 stay far below


class WordSearch:
    """Finds the nearest of words (W, D), W > 0, by Euclidean distance.

    The distance in some directions of a rotated space, and the difference of the lengths of what is left, are less than
    the whole distance: q.w is at most the product of (q's first numbers, length of the rest) with those of w. A word
    whose bound is worse than the best word so far cannot win.
    """

    def __init__(self, words: Floats) -> None:
        self._mean = words.mean(axis=0, dtype=np.float64).astype(np.float32)
        centred = np.ascontiguousarray(words - self._mean)
        self._axes = _principal_axes(centred)
        self._words = centred
        # |q - w|^2 is least where q.w - |w|^2 / 2 is greatest; nothing is greater than what fills the last block up
        halves = -0.5 * np.einsum("wd,wd->w", centred, centred, dtype=np.float64)
        self._penalties = _in_blocks(halves[:, None], -np.inf)[:, 0]
        self._bounds = _in_blocks(self._shortened(centred), 0)
        self._longest = np.sqrt(-2 * halves.min())

    def nearest(self, query: Floats) -> Indices:
        """The nearest word (N,) of each query descriptor (N, D); of equally near ones the first."""
        centred = np.ascontiguousarray(query - self._mean, np.float32)
        slack = ROUNDING * self._longest * (np.linalg.norm(centred, axis=1) + self._longest)
        return _search(centred, self._shortened(centred), slack, self._words, self._bounds, self._penalties)

    def _shortened(self, centred: Floats) -> Floats:
        rotated = centred @ self._axes
        rest = np.linalg.norm(rotated[:, DIRECTIONS:], axis=1, keepdims=True)
        return np.hstack([rotated[:, :DIRECTIONS], rest]).astype(np.float32)


def _principal_axes(centred: Floats) -> NDArray[np.float64]:
    """Directions (D, D) as columns, those of most variance first."""
    exact = centred.astype(np.float64)
    _, axes = np.linalg.eigh(exact.T @ exact)
    return axes[:, ::-1]


def _in_blocks(rows: NDArray[np.floating], fill: float) -> Floats:
    """Rows (W, K) as columns of blocks (B, K, BLOCK); the last one filled up."""
    blocks = -(-len(rows) // BLOCK)
    padded = np.full((blocks * BLOCK, rows.shape[1]), fill, np.float32)
    padded[: len(rows)] = rows
    return np.ascontiguousarray(padded.reshape(blocks, BLOCK, -1).transpose(0, 2, 1))


@njit(cache=True)
def _search(
    query: Floats, shortened: Floats, slack: Floats, words: Floats, bounds: Floats, penalties: Floats
) -> Indices:
    nearest = np.zeros(len(query), np.int64)
    best = np.full(len(query), -np.inf, np.float32)
    bound = np.empty(BLOCK, np.float32)
    for block in range(len(bounds)):
        rows = words[block * BLOCK : (block + 1) * BLOCK]
        for i in range(len(query)):
            bound[:] = penalties[block]
            add_products(shortened[i], bounds[block], bound)
            if not _any_reaches(bound, best[i] - slack[i]):
                continue
            for j in range(len(rows)):
                if bound[j] >= best[i] - slack[i]:
                    closeness = penalties[block, j] + _product(query[i], rows[j])
                    if closeness > best[i]:
                        nearest[i], best[i] = block * BLOCK + j, closeness
    return nearest


@njit(cache=True)
def _any_reaches(values: Floats, limit: np.float32) -> bool:
    found = np.int32(0)
    for j in range(BLOCK):  # to the end: a loop of known length without a way out compares many at once
        found |= np.int32(values[j] >= limit)
    return bool(found)


@njit(cache=True)
def _product(first: Floats, second: Floats) -> np.float32:
    total = np.float32(0)
    for k in range(len(first)):
        total += first[k] * second[k]
    return total
