"""Votes and their binomial density, descriptor matching, and epipolar verification."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binom

from place_recognition.belief.voting import count_votes, expand_spans, log_binomial
from place_recognition.image_processing.matching import count_matches, match_pairs, mutual_matches
from place_recognition.verification.candidate_verification import EpipolarConfig, epipolar_inliers
from place_recognition.vocabulary.word_tracking import WordMap, Words
from place_recognition.vocabulary.word_tree import ExactWordIndex, nearest_words


def unit(rng, n, d=64):
    rows = rng.normal(size=(n, d)).astype(np.float32)
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def two_views(rng, n):
    """Pixels of n points in two cameras that differ by a turn and a step."""
    points = rng.uniform([-4, -2, 5], [4, 2, 20], (n, 3))
    angle = 0.1
    R = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    moved = points @ R.T + [0.8, 0.1, 0.3]
    return [(700 * p[:, :2] / p[:, 2:] + [600, 180]).astype(np.float32) for p in (points, moved)]


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 200), st.integers(0, 200), st.floats(0, 1))
def test_log_binomial_agrees_with_scipy(x, extra, p):
    expected = binom.logpmf(x, x + extra, p)
    assert log_binomial(np.array([x]), x + extra, np.array([p]))[0] == pytest.approx(expected, rel=1e-9, abs=1e-7)


def test_nearest_words_are_those_that_scipy_finds():
    rng = np.random.default_rng(0)
    query, words = unit(rng, 60), unit(rng, 9000) * rng.uniform(0.8, 1, (9000, 1)).astype(np.float32)
    from scipy.spatial.distance import cdist

    np.testing.assert_array_equal(nearest_words(query, words), cdist(query, words).argmin(axis=1))


def test_each_word_hit_votes_once_for_each_image_it_spans():
    words = WordMap(ExactWordIndex())
    for first, last in ((0, 1), (1, 1), (1, 2), (3, 4)):
        words.add(Words(np.zeros((1, 2), np.float32), np.array([first]), np.array([last])))
    words.activate_until(4)
    votes = count_votes(np.array([0, 2]), words)
    np.testing.assert_array_equal(votes.locations, [0, 1, 2])
    np.testing.assert_array_equal(votes.votes, [1, 2, 1])
    np.testing.assert_allclose(votes.expected, [0.5, 1.5, 0.5])
    np.testing.assert_allclose(votes.log_density, binom.logpmf(votes.votes, 2, np.array([1, 3, 1]) / 4))


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(0, 5)), max_size=20))
def test_spans_are_expanded_as_by_a_loop(spans):
    array = np.array([(first, first + length) for first, length in spans], np.int32).reshape(-1, 2)
    expected = [k for first, length in spans for k in range(first, first + length + 1)]
    np.testing.assert_array_equal(expand_spans(array), expected)


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 300), st.floats(0.001, 0.9))
def test_above_the_expected_number_more_votes_are_less_likely(trials, p):
    """The density may stand for the tail of the binomial distribution: beyond the mean both fall."""
    votes = np.arange(math.ceil(trials * p + 1), trials + 1)
    density = log_binomial(votes, trials, np.full(len(votes), p))
    assert np.all(np.diff(density) < 0)
    tail = binom.logsf(votes - 1, trials, p)  # of at least as many votes
    assert np.all((density <= tail + 1e-7) | (density < -600))  # below, scipy's tail underflows to 0


def test_without_hits_there_are_no_votes():
    votes = count_votes(np.empty(0, np.int64), WordMap(ExactWordIndex()))
    assert len(votes.locations) == 0


def test_a_word_that_is_hit_often_votes_once_or_as_often():
    words = WordMap(ExactWordIndex())
    for first, last in ((0, 1), (1, 2)):
        words.add(Words(np.zeros((1, 2), np.float32), np.array([first]), np.array([last])))
    words.activate_until(4)
    hit = np.array([0, 0, 0, 1])
    np.testing.assert_array_equal(count_votes(hit, words).votes, [1, 2, 1])
    often = count_votes(hit, words, distinct=False)
    np.testing.assert_array_equal(often.votes, [3, 4, 1])
    np.testing.assert_allclose(often.log_density, binom.logpmf([3, 4, 1], 4, [0.5, 1.0, 0.5]), atol=1e-12)


def test_mutual_matches_undo_a_shuffle():
    rng = np.random.default_rng(1)
    first, order = unit(rng, 80), rng.permutation(80)
    pairs = mutual_matches(first, first[order])
    np.testing.assert_array_equal(order[pairs[:, 1]], pairs[:, 0])
    assert len(pairs) == 80


def test_mutual_matches_agree_with_a_plain_search():
    rng = np.random.default_rng(2)
    first, second = unit(rng, 50, 8), unit(rng, 40, 8)
    distance = np.linalg.norm(first[:, None] - second[None], axis=2)
    nearest, back = distance.argmin(axis=1), distance.argmin(axis=0)
    expected = [(i, nearest[i]) for i in range(50) if back[nearest[i]] == i]
    np.testing.assert_array_equal(mutual_matches(first, second, ratio=1), expected)
    clear = [(i, j) for i, j in expected if distance[i, j] <= 0.8 * np.partition(distance[i], 1)[1]]
    np.testing.assert_array_equal(mutual_matches(first, second, ratio=0.8), clear)


def quantized(rng, n, d):
    return np.round(127 * unit(rng, n, d)).astype(np.int8)


def plain_pairs(first, second):
    """Mutual nearest neighbours that are nearer than 4/5 of the second nearest, in plain integers."""
    product = first.astype(np.int64) @ second.T.astype(np.int64)
    distance = np.maximum(127**2 - product, 0)
    nearest, back = product.argmax(axis=1), product.argmax(axis=0)
    others = [np.delete(distance[i], nearest[i]).min(initial=10**9) for i in range(len(first))]
    clear = 25 * distance[np.arange(len(first)), nearest] < 16 * np.array(others)  # squares of 5 and 4
    return [(i, nearest[i]) for i in range(len(first)) if back[nearest[i]] == i and clear[i]]


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 70), st.integers(1, 70), st.sampled_from([2, 3, 8, 13, 64, 256]))
def test_quantized_descriptors_match_as_in_plain_integers(seed, n, m, d):
    rng = np.random.default_rng(seed)
    first, second = quantized(rng, n, d), quantized(rng, m, d)
    shared = min(n, m) // 2
    second[:shared] = first[shared : 2 * shared]
    expected = np.reshape(plain_pairs(first, second), (-1, 2))
    np.testing.assert_array_equal(match_pairs(first, second, 0.8), expected)


def test_the_largest_products_of_unit_vectors_do_not_overflow():
    extreme = np.full((1, 256), np.round(127 / 16), np.int8)  # a binary descriptor: 256 equal numbers
    np.testing.assert_array_equal(match_pairs(extreme, np.concatenate([-extreme, extreme]), 0.8), [[0, 1]])


def test_one_image_is_matched_with_many_as_with_each():
    rng = np.random.default_rng(8)
    query, others, counts = quantized(rng, 40, 64), quantized(rng, 90, 64).reshape(3, 30, 64), np.array([30, 0, 17])
    others[0, 5:20], others[2, 10:20] = query[:15], query[20:30]
    expected = [len(match_pairs(query, other[:count], 0.8)) for other, count in zip(others, counts, strict=True)]
    np.testing.assert_array_equal(count_matches(query, others, counts, 0.8), expected)
    assert expected[0] >= 15


@pytest.mark.parametrize(("n", "m"), [(0, 0), (0, 5), (5, 0)])
def test_no_quantised_features_match_nothing(n, m):
    first, second = np.zeros((n, 64), np.int8), np.zeros((m, 64), np.int8)
    assert match_pairs(first, second, 0.8).shape == (0, 2)


def test_an_image_without_features_matches_nothing():
    assert mutual_matches(np.empty((0, 64), np.float32), unit(np.random.default_rng(0), 5)).shape == (0, 2)


def test_inliers_of_a_rigid_scene_are_found_and_outliers_are_not():
    rng = np.random.default_rng(3)
    first, second = two_views(rng, 100)
    second[:30] = rng.uniform([0, 0], [1200, 360], (30, 2))
    agree = epipolar_inliers(first, second, EpipolarConfig())
    assert agree[30:].mean() > 0.95
    assert agree[:30].mean() < 0.2


def test_verification_is_the_same_each_time():
    first, second = two_views(np.random.default_rng(4), 60)
    first += np.random.default_rng(5).normal(0, 1, first.shape).astype(np.float32)
    masks = [epipolar_inliers(first, second, EpipolarConfig()) for _ in range(3)]
    np.testing.assert_array_equal(masks[0], masks[1])
    np.testing.assert_array_equal(masks[0], masks[2])


@pytest.mark.parametrize("count", [0, 3, 8, 40])
def test_degenerate_matches_cause_no_error(count):
    same = np.full((count, 2), 5, np.float32)
    agree = epipolar_inliers(same, same, EpipolarConfig())
    assert agree is None or len(agree) == count


def test_random_matches_rarely_look_rigid():
    rng = np.random.default_rng(6)
    config = EpipolarConfig(min_inliers=20)
    pixels = rng.uniform([0, 0], [1200, 360], (20, 2, 60, 2)).astype(np.float32)
    assert all(epipolar_inliers(first, second, config) is None for first, second in pixels)


def test_quantized_descriptors_of_real_size_match_as_floats_do():
    rng = np.random.default_rng(9)
    first, second = quantized(rng, 300, 64), quantized(rng, 280, 64)
    second[:90] = np.clip(first[100:190].astype(int) + rng.integers(-9, 10, (90, 64)), -127, 127)
    expected = mutual_matches(first / np.float32(127), second / np.float32(127), 0.8)
    np.testing.assert_array_equal(match_pairs(first, second, 0.8), expected)
    assert len(expected) >= 85
