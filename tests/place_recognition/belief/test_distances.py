"""Distances and scores of vectors, one by one and in batches."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cityblock, cosine, euclidean

from place_recognition.belief.distances import (
    cosine_distance,
    euclidean_distance,
    l2_score,
    scaled_l2_score,
    sum_of_absolute_differences,
)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 40))
def test_distances_agree_with_scipy(seed, n):
    p, q = np.random.default_rng(seed).normal(size=(2, n))
    assert euclidean_distance(p, q) == pytest.approx(euclidean(p, q))
    assert cosine_distance(p, q) == pytest.approx(cosine(p, q), abs=1e-12)
    assert sum_of_absolute_differences(p, q) == pytest.approx(cityblock(p, q) / n)


@pytest.mark.parametrize(
    "measure", [sum_of_absolute_differences, euclidean_distance, cosine_distance, l2_score, scaled_l2_score]
)
def test_a_batch_is_the_same_as_one_by_one(measure):
    one, many = np.random.default_rng(0).random((1, 7))[0], np.random.default_rng(1).random((5, 7))
    np.testing.assert_allclose(measure(one, many), [measure(one, other) for other in many])


def test_grey_levels_do_not_wrap_around():
    assert sum_of_absolute_differences(np.array([0, 255], np.uint8), np.array([255, 0], np.uint8)) == 255


def test_the_printed_score_of_unrelated_word_vectors_is_not_zero_and_the_scaled_one_is():
    assert l2_score([1, 0], [0, 3]) == pytest.approx(1 - np.sqrt(2) / 2)
    assert scaled_l2_score([1, 0], [0, 3]) == pytest.approx(0)
    assert l2_score([1, 2], [2, 4]) == pytest.approx(1)
    assert scaled_l2_score([1, 2], [2, 4]) == pytest.approx(1)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_printed_score_is_the_formula_on_unit_vectors(seed):
    p, q = np.random.default_rng(seed).random((2, 12))
    printed = 1 - 0.5 * np.linalg.norm(p / np.linalg.norm(p) - q / np.linalg.norm(q))
    assert l2_score(p, q) == pytest.approx(printed)


def test_a_zero_vector_is_unlike_everything():
    assert cosine_distance(np.zeros(3), [1, 2, 3]) == 1
    assert scaled_l2_score(np.zeros(3), np.zeros(3)) == 0


def test_vectors_of_different_lengths_are_refused():
    with pytest.raises(ValueError, match=r"expected vectors of the same length, got shapes \(3,\) and \(4,\)"):
        euclidean_distance(np.zeros(3), np.zeros(4))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 30))
def test_distances_are_metrics_and_scores_of_word_vectors_lie_in_their_range(seed, n):
    p, q, r = np.random.default_rng(seed).random((3, n))
    for distance in (sum_of_absolute_differences, euclidean_distance):
        assert distance(p, p) == 0
        assert distance(p, q) == distance(q, p)
        assert distance(p, r) <= distance(p, q) + distance(q, r) + 1e-12
    assert 1 - np.sqrt(0.5) - 1e-12 <= l2_score(p, q) <= 1
    assert 0 <= scaled_l2_score(p, q) <= 1
    assert scaled_l2_score(p, 7 * q) == pytest.approx(scaled_l2_score(p, q))
