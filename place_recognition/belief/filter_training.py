"""The 3x3 filter learnt from matrices with known revisits, by logistic regression (equations 4.9 to 4.11).

A sample is a cell of the normalised matrix with its eight neighbours, its label whether the cell is a revisit. With
theta_0 for the constant, h(m) = 1 / (1 + exp(-m theta)) is the probability of one; h >= 1/2 where the filter's response
is at least -theta_0, the threshold. The chapter's equation 4.11 has lost the minus in the exponent.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from place_recognition.belief.matrix_filter import FilterConfig, with_background

Array = NDArray[np.float64]
Truth = NDArray[np.bool_]


@dataclass(frozen=True)
class Samples:
    """Cells to learn from.

    Attributes:
        patches: (L, 9) each cell with its neighbours, row by row.
        labels: (L,) whether it is a revisit.
    """

    patches: Array
    labels: Truth


@dataclass(frozen=True)
class TrainingConfig:
    """How the filter is learnt; of the paper's settings none is known.

    Attributes:
        iterations: steps of gradient descent at most.
        tolerance: it ends when the gradient of the mean loss is nowhere more than this.
        ridge: weight of the squared coefficients, the constant's left out: without it, samples that a plane separates
            would drive them to infinity.
        negatives: cells without revisit for each with one, drawn from all of them; 0 takes them all. In a matrix of a
            long drive all but one in hundreds are none, and a filter that never fires would be nearly right.
        seed: of the draw.
    """

    iterations: int = 20000
    tolerance: float = 1e-5
    ridge: float = 1e-4
    negatives: int = 10
    seed: int = 0


def sequence_matrix(matrix: Array, truth: Truth) -> tuple[Array, Truth]:
    """The matrix of sequences and its truth, out of a matrix of images where only first images have rows and columns.

    Args:
        matrix: (N, N) similarities, row = query, NaN where two images were not compared.
        truth: (N, N) whether two images show one place.

    Returns:
        (S, S) similarities, NaN where not compared, and whether any two images of two sequences show one place.

    Raises:
        ValueError: shapes that do not belong together, or nothing was compared.
    """
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or truth.shape != matrix.shape:
        raise ValueError(f"expected a matrix (N, N) and as large a truth, got {matrix.shape} and {truth.shape}")
    compared = np.isfinite(matrix)
    first = np.flatnonzero(compared.any(axis=0) | compared.any(axis=1))
    if len(first) == 0:
        raise ValueError("expected a matrix of similarities, found one without any")
    by_rows = np.logical_or.reduceat(truth, first, axis=0)
    return matrix[np.ix_(first, first)], np.logical_or.reduceat(by_rows, first, axis=1)


def samples_of(matrix: Array, truth: Truth, config: TrainingConfig | None = None) -> Samples:
    """Samples of a matrix of sequences (S, S), NaN where not compared, and its truth (S, S).

    Every compared cell is one; neighbours that were not compared are background, as they are for the filter.
    """
    config = config or TrainingConfig()
    windows = np.lib.stride_tricks.sliding_window_view(with_background(matrix), (3, 3))
    compared = np.isfinite(matrix)
    positive, negative = np.argwhere(compared & truth), np.argwhere(compared & ~truth)
    wanted = config.negatives * len(positive)
    if 0 < wanted < len(negative):
        drawn = np.random.default_rng(config.seed).choice(len(negative), wanted, replace=False)
        negative = negative[np.sort(drawn)]
    cells = np.concatenate([positive, negative])
    labels = np.arange(len(cells)) < len(positive)
    return Samples(windows[cells[:, 0], cells[:, 1]].reshape(-1, 9).astype(np.float64), labels)


def loss(theta: Array, samples: Samples, ridge: float = 0.0) -> float:
    """J (eq. 4.10) of the coefficients (10,), the constant first, plus the ridge."""
    margin = _with_constant(samples.patches) @ theta * np.where(samples.labels, 1.0, -1.0)
    return float(np.logaddexp(0.0, -margin).mean() + 0.5 * ridge * np.sum(theta[1:] ** 2))


def train_filter(samples: Samples, config: TrainingConfig | None = None) -> FilterConfig:
    """The filter and threshold of the least loss.

    Raises:
        ValueError: samples of one kind only.
    """
    config = config or TrainingConfig()
    revisits = int(samples.labels.sum())
    if not 0 < revisits < len(samples.labels):
        raise ValueError(
            f"expected cells of revisits and of none, found {revisits} and {len(samples.labels) - revisits};"
            " is the truth that of this matrix?"
        )
    theta = _descend(samples, config)
    rows = [tuple(float(value) for value in row) for row in theta[1:].reshape(3, 3)]
    return FilterConfig(kernel=(rows[0], rows[1], rows[2]), threshold=float(-theta[0]))  # type: ignore[arg-type]


def _descend(samples: Samples, config: TrainingConfig) -> Array:
    """Coefficients (10,) by gradient descent, with Nesterov's momentum, from 0.

    The step is the inverse of the loss's greatest curvature, so each one goes downhill and none has to be tuned.
    """
    inputs, labels = _with_constant(samples.patches), samples.labels.astype(np.float64)
    ridge = np.r_[0.0, np.full(9, config.ridge)]
    step = 1.0 / (np.linalg.norm(inputs, 2) ** 2 / (4 * len(inputs)) + config.ridge)
    theta = ahead = np.zeros(10)
    for iteration in range(config.iterations):
        gradient = inputs.T @ (expit(inputs @ ahead) - labels) / len(inputs) + ridge * ahead
        if np.abs(gradient).max() <= config.tolerance:
            return ahead
        before, theta = theta, ahead - step * gradient
        ahead = theta + iteration / (iteration + 3) * (theta - before)
    return theta


def _with_constant(patches: Array) -> Array:
    return np.hstack([np.ones((len(patches), 1)), patches])
