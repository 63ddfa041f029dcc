"""Temporal consistency as a picture: a revisit is a diagonal in the matrix of similarities, and a 3x3 filter finds it.

Bampis, Amanatiadis, Gasteratos, 'Encoding the Description of Image Sequences', IROS 2016, equation 6 (the chapter's
4.8), and 'Fast Loop-Closure Detection Using Visual-Word-Vectors From Image Sequences', IJRR 37(1) 2018 (4.12).
Row = query sequence, column = earlier sequence.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate

Floats = NDArray[np.float32]
Kernel = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]

# Made by hand, equation 4.8: it sums to 0, so that only contrast counts; threshold 0.32.
DIAGONAL: Kernel = ((0.5, -0.5, 0.0), (-0.5, 1.0, -0.5), (0.0, -0.5, 0.5))

# Learnt by logistic regression, equation 4.12; threshold 3.5. It also suppresses passes in the opposite direction.
LEARNT: Kernel = ((2.31, -0.57, -1.88), (-0.41, 2.19, -0.75), (-1.83, -0.34, 2.15))


@dataclass(frozen=True)
class FilterConfig:
    """A filter and what its response means.

    Attributes:
        kernel: weights of a cell and its neighbours; rows = query, as in the matrix.
        threshold: least response of a revisit.
    """

    kernel: Kernel = DIAGONAL
    threshold: float = 0.32

    def __post_init__(self) -> None:
        if np.shape(self.kernel) != (3, 3):
            raise ValueError(f"expected a filter of 3x3 numbers, got shape {np.shape(self.kernel)}")


def normalised(row: Floats, previous: float, floor: float) -> Floats:
    """Scores of a query (N,) in units of its own score with the one just before it (eq. 4.7).

    Args:
        row: scores with earlier sequences.
        previous: score with the one just before.
        floor: least divisor. Where the camera turns on the spot, neighbours share nothing, and what they share would
            blow up all else (Galvez-Lopez, Tardos, T-RO 28(5) 2012, section IV-B, drop such queries).
    """
    return row / np.float32(max(previous, floor))


def filtered(matrix: Floats, kernel: Kernel) -> Floats:
    """Response (N, M) of a whole matrix (N, M); beyond its borders it is 0.

    A correlation, not a convolution: the learnt kernel is not symmetric.
    """
    return np.asarray(correlate(matrix, np.asarray(kernel, matrix.dtype), mode="constant", cval=0.0))


class CausalFilter:
    """Filters a matrix that comes row by row: a row's response needs the next row, so it comes one row late.

    Holds three rows. Rows may grow; what a row does not have is 0.
    """

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel
        self._rows: list[Floats] = []

    def add(self, row: Floats) -> Floats | None:
        """Take row i (M,) and return the response of row i - 1, as long as that row was; None for the first."""
        self._rows = [*self._rows[-2:], row]
        return self._response(len(self._rows) - 2)

    def finish(self) -> Floats | None:
        """Response of the last row, with zeros for the row that never came; None if there was no row."""
        return self._response(len(self._rows) - 1)

    def _response(self, middle: int) -> Floats | None:
        if middle < 0:
            return None
        width = len(self._rows[middle])
        response = np.zeros(width, np.float32)
        for row, weights in zip(self._around(middle), self._kernel, strict=True):
            _add_row(row, weights, response)
        return response

    def _around(self, middle: int) -> list[Floats]:
        nothing = np.empty(0, np.float32)
        return [self._rows[k] if 0 <= k < len(self._rows) else nothing for k in (middle - 1, middle, middle + 1)]


def _add_row(row: Floats, weights: tuple[float, float, float], response: Floats) -> None:
    """Add to response (M,) the three weights times the row's cells at one column less, the same and one more."""
    padded = np.zeros(len(response) + 2, np.float32)
    known = row[: len(response) + 1]
    padded[1 : 1 + len(known)] = known
    for shift, weight in enumerate(weights):
        if weight:
            response += np.float32(weight) * padded[shift : shift + len(response)]
