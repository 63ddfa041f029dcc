"""3x3 filters of the similarity matrix: a revisit of a sequence is a diagonal in it, which the filter amplifies.

Bampis, Amanatiadis, Gasteratos, 'Encoding the Description of Image Sequences', IROS 2016, equation 6 (the chapter's
4.8), and 'Fast Loop-Closure Detection Using Visual-Word-Vectors From Image Sequences', IJRR 37(1) 2018 (4.12).
Row = query sequence, column = earlier sequence. Equations and borders: docs/math.md.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate

Floats = NDArray[np.float32]
Matrix = NDArray[np.floating[Any]]
Kernel = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

# Hand-made kernel of equation 4.8, with threshold 0.32. It sums to 0, so that only contrast counts.
DIAGONAL: Kernel = ((0.5, -0.5, 0.0), (-0.5, 1.0, -0.5), (0.0, -0.5, 0.5))

# Kernel of equation 4.12, learnt by logistic regression, with threshold 3.5. It suppresses passes in the opposite
# direction, which are diagonals from the lower left to the upper right.
LEARNED: Kernel = ((2.31, -0.57, -1.88), (-0.41, 2.19, -0.75), (-1.83, -0.34, 2.15))


@dataclass(frozen=True)
class FilterConfig:
    """A kernel and the threshold that belongs to it.

    Attributes:
        kernel: 3x3 weights of a cell and its neighbours; rows = query, as in the matrix.
        threshold: smallest response of a revisit.
    """

    kernel: Kernel = DIAGONAL
    threshold: float = 0.32

    def __post_init__(self) -> None:
        """Raise ValueError for a kernel of another size."""
        if np.shape(self.kernel) != (3, 3):
            raise ValueError(f"expected a filter of 3x3 numbers, got shape {np.shape(self.kernel)}")


def normalize_row(row: Floats, previous_score: float, min_previous_score: float) -> Floats:
    """Divide the scores (N,) of a query by its score with the sequence just before it (eq. 4.7).

    Args:
        row: (N,) scores of the query with earlier sequences.
        previous_score: score of the query with the sequence just before it.
        min_previous_score: lower bound of the divisor. Where the camera turns on the spot, successive sequences share
            almost nothing, and the division would make all scores large (Galvez-Lopez and Tardos, T-RO 28(5) 2012,
            section IV-B, drop such queries).
    """
    return row / np.float32(max(previous_score, min_previous_score))


def filter_matrix(matrix: Matrix, kernel: Kernel) -> Matrix:
    """Correlate a whole matrix (N, M) with the kernel; NaN cells, which were not compared, stay NaN.

    A correlation, not a convolution: the learnt kernel is not symmetric.
    """
    response = correlate(pad_with_background(matrix), np.asarray(kernel, matrix.dtype), mode="nearest")[1:-1, 1:-1]
    return np.where(np.isnan(matrix), matrix, response)


def pad_with_background(matrix: Matrix) -> Matrix:
    """Add a border to a matrix (N, M) and fill NaN cells, both with the mean of their row; returns (N + 2, M + 2).

    A row without any cell gets the mean of the row after it; the rows of the border get those of the first and the last
    row. Why not zeros: docs/decisions/sequence_paradigms.md.
    """
    counts = np.sum(~np.isnan(matrix), axis=1)
    means = np.nansum(matrix, axis=1) / np.maximum(counts, 1)
    for i in range(len(means) - 1, 0, -1):
        if counts[i - 1] == 0:
            means[i - 1] = means[i]
    complete = np.where(np.isnan(matrix), means[:, None], matrix)
    complete = np.hstack([means[:, None], complete, means[:, None]])
    border = np.broadcast_to(means[[0, -1], None], (2, complete.shape[1]))
    return np.vstack([border[:1], complete, border[1:]]).astype(matrix.dtype)


class OnlineMatrixFilter:
    """Filters a matrix that grows row by row: the response of a row needs the next row, so it comes one row late.

    Holds three rows. Each may be longer than the one before; missing cells are background (`pad_with_background`).
    """

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel
        self._rows: list[Floats] = []

    def add(self, row: Floats) -> Floats | None:
        """Add row i (M,) and return the response of row i - 1, which has the length of that row; None for i = 0."""
        self._rows = [*self._rows[-2:], row]
        return self._response(len(self._rows) - 2)

    def finish(self) -> Floats | None:
        """Return the response of the last row, with background in place of a next row; None if there was no row."""
        return self._response(len(self._rows) - 1)

    def _response(self, middle: int) -> Floats | None:
        if middle < 0:
            return None
        row = self._rows[middle]
        if len(row) == 0:
            return row
        above, below = (self._rows[k : k + 1] for k in (middle - 1, middle + 1))
        response = np.zeros(len(row), np.float32)
        for near, weights in zip((above, [row], below), self._kernel, strict=True):
            known = near[0] if near and len(near[0]) else row.mean(keepdims=True)  # else background
            _add_row(known, weights, response)
        return response

    def state(self) -> list[Floats]:
        """The rows held, for a checkpoint."""
        return list(self._rows)

    def restore(self, rows: list[Floats]) -> None:
        """Continue from a state."""
        self._rows = list(rows)


def _add_row(row: Floats, weights: tuple[float, float, float], response: Floats) -> None:
    """Add to response (M,) the sum of the weights times the row's cells one column before, at and after each cell."""
    padded = np.full(len(response) + 2, row.mean(), np.float32)
    known = row[: len(response) + 1]
    padded[1 : 1 + len(known)] = known
    for shift, weight in enumerate(weights):
        if weight:
            response += np.float32(weight) * padded[shift : shift + len(response)]
