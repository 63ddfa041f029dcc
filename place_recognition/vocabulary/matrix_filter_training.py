"""Training of the 3x3 matrix filter by logistic regression, from matrices with known revisits (eq. 4.9 to 4.11).

A sample is a cell of the normalised matrix with its eight neighbours; its label is whether the cell is a revisit. With
theta_0 for the constant, h(m) = 1 / (1 + exp(-m theta)) is the probability of a revisit. It is at least 1/2 where the
filter's response is at least -theta_0, so that is the threshold. The chapter's equation 4.11 lacks the minus in the
exponent.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from place_recognition.belief.matrix_filter import FilterConfig, pad_with_background

Array = NDArray[np.float64]
Truth = NDArray[np.bool_]


@dataclass(frozen=True)
class TrainingSamples:
    """Training samples.

    Attributes:
        patches: (L, 9) values of each cell and its neighbours, row by row.
        labels: (L,) True for a revisit.
    """

    patches: Array
    labels: Truth


@dataclass(frozen=True)
class FilterTrainingConfig:
    """Settings of the training; the paper does not give its own.

    Attributes:
        max_iterations: largest number of steps of gradient descent.
        gradient_threshold: largest absolute component of the gradient of the mean loss at which the descent ends.
        ridge_weight: weight of the squared coefficients except the constant. Without it, samples that a plane separates
            would drive the coefficients to infinity.
        negatives_per_positive: number of cells without revisit for each cell with one, drawn at random; 0 takes all. In
            the matrix of a long recording one cell in hundreds is a revisit, and a filter that never responds would be
            right nearly everywhere.
        seed: seed of the random draw.
    """

    max_iterations: int = 20000
    gradient_threshold: float = 1e-5
    ridge_weight: float = 1e-4
    negatives_per_positive: int = 10
    seed: int = 0


def reduce_to_sequences(matrix: Array, truth: Truth) -> tuple[Array, Truth]:
    """Reduce a matrix of images, in which only the first image of each sequence has values, to one of sequences.

    Args:
        matrix: (N, N) similarities, row = query, NaN where two images were not compared.
        truth: (N, N) True where two images show one place.

    Returns:
        (S, S) similarities, NaN where not compared, and (S, S) True where any two images of two sequences show one
        place.

    Raises:
        ValueError: the shapes differ, or no images were compared.
    """
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or truth.shape != matrix.shape:
        raise ValueError(
            f"expected a matrix (N, N) and a truth of the same shape, got {matrix.shape} and {truth.shape}"
        )
    compared = np.isfinite(matrix)
    first = np.flatnonzero(compared.any(axis=0) | compared.any(axis=1))
    if len(first) == 0:
        raise ValueError("expected a matrix of similarities, found one without any value")
    by_rows = np.logical_or.reduceat(truth, first, axis=0)
    return matrix[np.ix_(first, first)], np.logical_or.reduceat(by_rows, first, axis=1)


def collect_samples(matrix: Array, truth: Truth, config: FilterTrainingConfig | None = None) -> TrainingSamples:
    """Collect the samples of a matrix of sequences (S, S), NaN where not compared, and its truth (S, S).

    Every compared cell is a sample; neighbours that were not compared are background, as they are for the filter.
    """
    config = config or FilterTrainingConfig()
    windows = np.lib.stride_tricks.sliding_window_view(pad_with_background(matrix), (3, 3))
    compared = np.isfinite(matrix)
    positive, negative = np.argwhere(compared & truth), np.argwhere(compared & ~truth)
    wanted = config.negatives_per_positive * len(positive)
    if 0 < wanted < len(negative):
        drawn = np.random.default_rng(config.seed).choice(len(negative), wanted, replace=False)
        negative = negative[np.sort(drawn)]
    cells = np.concatenate([positive, negative])
    labels = np.arange(len(cells)) < len(positive)
    return TrainingSamples(windows[cells[:, 0], cells[:, 1]].reshape(-1, 9).astype(np.float64), labels)


def logistic_loss(theta: Array, samples: TrainingSamples, ridge: float = 0.0) -> float:
    """Return the cost J (eq. 4.10) of the coefficients (10,), the constant first, plus the ridge penalty."""
    margin = _with_constant(samples.patches) @ theta * np.where(samples.labels, 1.0, -1.0)
    return float(np.logaddexp(0.0, -margin).mean() + 0.5 * ridge * np.sum(theta[1:] ** 2))


def train_filter(samples: TrainingSamples, config: FilterTrainingConfig | None = None) -> FilterConfig:
    """Find the kernel and threshold of the smallest loss.

    Raises:
        ValueError: the samples are all revisits, or none is.
    """
    config = config or FilterTrainingConfig()
    revisits = int(samples.labels.sum())
    if not 0 < revisits < len(samples.labels):
        raise ValueError(
            f"expected cells of revisits and others, found {revisits} and {len(samples.labels) - revisits};"
            " check that the ground truth belongs to this matrix"
        )
    theta = _descend(samples, config)
    rows = [tuple(float(value) for value in row) for row in theta[1:].reshape(3, 3)]
    return FilterConfig(kernel=(rows[0], rows[1], rows[2]), threshold=float(-theta[0]))  # type: ignore[arg-type]


def _descend(samples: TrainingSamples, config: FilterTrainingConfig) -> Array:
    """Coefficients (10,) of the smallest loss, by gradient descent from 0 with Nesterov's momentum.

    The step is the inverse of an upper bound of the curvature of the loss, so that it needs no tuning: the second
    derivative of the logistic loss is at most 1/4, hence the largest singular value squared over 4 n, plus the ridge.
    """
    inputs, labels = _with_constant(samples.patches), samples.labels.astype(np.float64)
    ridge = np.r_[0.0, np.full(9, config.ridge_weight)]
    step = 1.0 / (np.linalg.norm(inputs, 2) ** 2 / (4 * len(inputs)) + config.ridge_weight)
    theta = ahead = np.zeros(10)
    for iteration in range(config.max_iterations):
        gradient = inputs.T @ (expit(inputs @ ahead) - labels) / len(inputs) + ridge * ahead
        if np.abs(gradient).max() <= config.gradient_threshold:
            return ahead
        before, theta = theta, ahead - step * gradient
        ahead = theta + iteration / (iteration + 3) * (theta - before)
    return theta


def _with_constant(patches: Array) -> Array:
    return np.hstack([np.ones((len(patches), 1)), patches])
