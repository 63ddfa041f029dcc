"""Filters of the similarity matrix, and how they are learnt."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import correlate
from scipy.optimize import minimize

from place_recognition.belief.matrix_filter import (
    DIAGONAL,
    LEARNED,
    FilterConfig,
    OnlineMatrixFilter,
    filter_matrix,
    normalize_row,
)
from place_recognition.vocabulary.matrix_filter_training import (
    FilterTrainingConfig,
    TrainingSamples,
    collect_samples,
    logistic_loss,
    reduce_to_sequences,
    train_filter,
)


def diagonal_matrix(seed, size=60, lag=30):
    """A noisy matrix (S, S) with a revisit from `lag` on, NaN on and above the diagonal, and its truth."""
    rng = np.random.default_rng(seed)
    truth = np.eye(size, k=-lag) > 0
    matrix = rng.uniform(0, 0.4, (size, size)) + np.where(truth, rng.uniform(0.3, 0.9, (size, size)), 0)
    matrix[np.triu_indices(size, -5)] = np.nan
    return matrix, truth


@pytest.mark.parametrize(
    ("shape", "by_hand", "learnt"),
    [
        (np.eye(3), 2.0, 6.65),
        (np.diag([0, 1, 0]), 1.0, 2.19),
        (np.diag([1, 1, 0]), 1.5, 4.50),
        (np.fliplr(np.eye(3)), 1.0, -1.52),
        (np.ones((3, 3)), 0.0, 0.87),
    ],
    ids=["diagonal", "lone cell", "two of a diagonal", "driven backwards", "all alike"],
)
def test_published_filters_answer_known_shapes_as_worked_out_by_hand(shape, by_hand, learnt):
    assert filter_matrix(shape.astype(float), DIAGONAL)[1, 1] == pytest.approx(by_hand)
    assert filter_matrix(shape.astype(float), LEARNED)[1, 1] == pytest.approx(learnt)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.sampled_from([DIAGONAL, LEARNED]))
def test_the_online_filter_gives_the_response_of_the_whole_matrix(seed, size, kernel):
    rng = np.random.default_rng(seed)
    matrix = rng.random((size, size)).astype(np.float32)
    matrix[np.triu_indices(size, -rng.integers(4))] = np.nan
    rows = [row[~np.isnan(row)] for row in matrix]
    causal = OnlineMatrixFilter(kernel)
    answers = [causal.add(row) for row in rows] + [causal.finish()]
    assert answers[0] is None
    expected = filter_matrix(matrix, kernel)
    for i, answer in enumerate(answers[1:]):
        np.testing.assert_allclose(answer, expected[i, : len(rows[i])], atol=1e-5)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(3, 12), st.integers(3, 12), st.sampled_from([DIAGONAL, LEARNED]))
def test_the_response_inside_a_whole_matrix_is_the_correlation_of_scipy(seed, rows, columns, kernel):
    matrix = np.random.default_rng(seed).normal(size=(rows, columns))
    expected = correlate(matrix, np.array(kernel))[1:-1, 1:-1]
    np.testing.assert_allclose(filter_matrix(matrix, kernel)[1:-1, 1:-1], expected, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.floats(-5, 5))
def test_the_hand_made_filter_ignores_a_constant_and_is_linear(seed, size, constant):
    matrix = np.random.default_rng(seed).normal(size=(size, size))
    response = filter_matrix(matrix, DIAGONAL)
    np.testing.assert_allclose(filter_matrix(matrix + constant, DIAGONAL), response, atol=1e-9)
    np.testing.assert_allclose(filter_matrix(constant * matrix, DIAGONAL), constant * response, atol=1e-9)


def test_a_constant_matrix_has_no_response_to_the_hand_made_filter_not_even_at_the_borders():
    matrix = np.where(np.tri(6, k=-1) > 0, 0.7, np.nan)
    response = filter_matrix(matrix, DIAGONAL)
    np.testing.assert_array_equal(np.isnan(response), np.isnan(matrix))
    np.testing.assert_allclose(response[~np.isnan(matrix)], 0, atol=1e-12)


def test_a_filter_without_rows_has_no_response():
    assert OnlineMatrixFilter(DIAGONAL).finish() is None


def test_a_row_is_divided_by_the_score_with_its_predecessor_and_by_no_less_than_the_minimum():
    row = np.array([0.1, 0.4], np.float32)
    np.testing.assert_allclose(normalize_row(row, 0.2, min_previous_score=0.05), [0.5, 2])
    np.testing.assert_allclose(normalize_row(row, 0.0, min_previous_score=0.05), [2, 8])


def test_a_filter_of_another_size_is_refused():
    with pytest.raises(ValueError, match=r"expected a filter of 3x3 numbers, got shape \(2, 2\)"):
        FilterConfig(kernel=((1, 2), (3, 4)))


def test_the_learnt_filter_separates_revisits_of_a_drive_it_has_not_seen():
    learnt = train_filter(collect_samples(*diagonal_matrix(seed=1)))
    unseen = collect_samples(*diagonal_matrix(seed=2), FilterTrainingConfig(negatives_per_positive=0))
    found = unseen.patches @ np.ravel(learnt.kernel) >= learnt.threshold
    assert found[unseen.labels].mean() > 0.9
    assert found[~unseen.labels].mean() < 0.02
    assert np.trace(learnt.kernel) > 2 * np.abs(np.sum(learnt.kernel) - np.trace(learnt.kernel))


def test_gradient_descent_finds_the_minimum_that_scipy_finds():
    samples, ridge = collect_samples(*diagonal_matrix(seed=3)), 1e-2
    learnt = train_filter(samples, FilterTrainingConfig(ridge_weight=ridge, gradient_threshold=1e-9))
    theta = np.r_[-learnt.threshold, np.ravel(learnt.kernel)]
    reference = minimize(logistic_loss, np.zeros(10), (samples, ridge), method="BFGS", options={"gtol": 1e-9})
    assert logistic_loss(theta, samples, ridge) == pytest.approx(reference.fun, rel=1e-9)
    np.testing.assert_allclose(theta, reference.x, atol=1e-3)


def test_the_loss_is_the_cross_entropy_of_the_chapter():
    samples = TrainingSamples(np.random.default_rng(0).random((20, 9)), np.arange(20) < 8)
    theta = np.random.default_rng(1).normal(size=10)
    h = 1 / (1 + np.exp(-(theta[0] + samples.patches @ theta[1:])))
    assert logistic_loss(theta, samples) == pytest.approx(-np.mean(np.where(samples.labels, np.log(h), np.log(1 - h))))


def test_every_compared_cell_is_a_sample_with_its_neighbourhood_row_by_row():
    matrix = np.full((4, 4), np.nan)
    matrix[2, 0], matrix[3, 0], matrix[3, 1] = 0.2, 0.5, 0.7
    samples = collect_samples(matrix, np.eye(4, k=-2) > 0, FilterTrainingConfig(negatives_per_positive=0))
    np.testing.assert_array_equal(samples.labels, [True, True, False])
    np.testing.assert_allclose(samples.patches[0], [0.2, 0.2, 0.2, 0.2, 0.2, 0.2, 0.6, 0.5, 0.7])
    np.testing.assert_allclose(samples.patches[1], [0.2, 0.2, 0.2, 0.5, 0.7, 0.6, 0.6, 0.6, 0.6])


def test_a_matrix_of_first_images_becomes_one_of_sequences():
    matrix, truth = np.full((9, 9), np.nan), np.zeros((9, 9), bool)
    matrix[6, [0, 3]] = 0.1, 0.8
    truth[8, 5] = True
    sequences, revisits = reduce_to_sequences(matrix, truth)
    np.testing.assert_array_equal(sequences[2, :2], [0.1, 0.8])
    np.testing.assert_array_equal(np.argwhere(revisits), [[2, 1]])


def test_training_without_revisits_or_with_another_matrix_is_refused():
    matrix, truth = diagonal_matrix(seed=0)
    with pytest.raises(ValueError, match="expected cells of revisits and others, found 0 and"):
        train_filter(collect_samples(matrix, np.zeros_like(truth)))
    with pytest.raises(ValueError, match=r"expected a matrix \(N, N\) and a truth of the same shape"):
        reduce_to_sequences(matrix, truth[:5])
    with pytest.raises(ValueError, match="found one without any value"):
        reduce_to_sequences(np.full((5, 5), np.nan), np.zeros((5, 5), bool))
