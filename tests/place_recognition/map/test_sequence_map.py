"""Sequences, their word vectors and the inverted index."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from place_recognition.belief.distances import cosine_similarity
from place_recognition.map.inverted_index import InvertedIndex
from place_recognition.map.sequence_map import (
    FixedDistanceConfig,
    FixedDistanceSegmentation,
    SequenceMap,
    WordVariance,
    WordVarianceConfig,
)
from place_recognition.vocabulary.tf_idf import ImageWords, WordVector, word_vector

WORDS = 50
WEIGHTS = np.linspace(0.1, 3, WORDS).astype(np.float32)
NAN = float("nan")


def dense(words, power=1.0):
    """The tf-idf vector (WORDS,) written out."""
    return np.bincount(words, minlength=WORDS) ** power * WEIGHTS


def begins_of(segmentation, words, distances):
    return [
        i for i, (w, d) in enumerate(zip(words, distances, strict=True)) if segmentation.starts_sequence(np.array(w), d)
    ]


@settings(max_examples=40, deadline=None)
@given(st.lists(st.lists(st.integers(0, WORDS - 1), max_size=90), max_size=120), st.sampled_from([0.5, 1.0]))
def test_the_inverted_index_gives_the_cosines_of_the_written_out_vectors(sequences, power):
    index = InvertedIndex(WORDS)
    for words in sequences:
        index.add(word_vector(np.array(words, np.int64), WEIGHTS, power))
    query = np.arange(0, WORDS, 3)
    for count in (0, len(sequences) // 2, len(sequences)):
        vectors = np.array([dense(np.array(w, np.int64), power) for w in sequences[:count]]).reshape(count, WORDS)
        cosines = index.cosines(word_vector(query, WEIGHTS, power), count)
        np.testing.assert_allclose(cosines, cosine_similarity(dense(query, power), vectors), atol=2e-4)
    assert len(index) == len(sequences)


def test_an_index_without_words_in_it_finds_nothing():
    index = InvertedIndex(WORDS)
    index.add(word_vector(np.empty(0, np.int64), WEIGHTS))
    np.testing.assert_array_equal(index.cosines(word_vector(np.arange(9), WEIGHTS), 1), [0])


def test_a_word_vector_has_unit_length_and_counts_repeated_words():
    vector = word_vector(np.array([7, 3, 7]), WEIGHTS)
    np.testing.assert_array_equal(vector.words, [3, 7])
    assert np.linalg.norm(vector.values) == pytest.approx(1)
    assert vector.values[1] / vector.values[0] == pytest.approx(2 * WEIGHTS[7] / WEIGHTS[3])
    assert vector.cosine(vector) == pytest.approx(1)
    assert vector.cosine(word_vector(np.array([1, 2]), WEIGHTS)) == 0


def test_words_that_everything_has_weigh_nothing():
    assert len(word_vector(np.array([0, 0]), np.zeros(4, np.float32))) == 0


@pytest.mark.parametrize("vocabulary", [WORDS, 70000])
def test_an_image_is_most_like_itself_and_order_and_repetition_do_not_matter(vocabulary):
    rng = np.random.default_rng(0)
    words = ImageWords(vocabulary)
    images = [rng.choice(vocabulary, 12, replace=False) for _ in range(20)]
    images[5] = np.repeat(images[3][::-1], 3)
    for image in images:
        words.add(image)
    np.testing.assert_array_equal(words.words_between(3, 4), np.concatenate(images[3:5]))
    likeness = words.correlation(3, np.arange(20))
    np.testing.assert_allclose(likeness[[3, 5]], likeness.max(), rtol=1e-5)
    assert np.median(likeness) < 0.5 * likeness[3]


def test_likeness_is_the_correlation_of_words_written_out():
    words = ImageWords(4)
    for image in ([0, 1, 2], [0, 3], [], [1, 1, 2]):
        words.add(np.array(image, np.int64))
    share = (np.array([2, 2, 2, 1]) + 0.5) / 5.5
    idf = -np.log(share)
    query, other = np.array([1, 1, 1, 0]), np.array([0, 1, 1, 0])
    expected = (query - share) * idf @ (other * idf) / np.linalg.norm(query * idf) / np.linalg.norm(other * idf)
    np.testing.assert_allclose(words.correlation(0, np.array([3, 2])), [expected, 0], rtol=1e-5)


def test_a_rare_word_says_more_than_a_common_one():
    """Without the weights of rarity both images would be equally like the first."""
    words = ImageWords(8)
    for image in ([0, 1, 4], [1, 5], [0, 6], [1, 7], [1, 2, 3], [1, 3], [1, 2]):
        words.add(np.array(image, np.int64))
    with_common, with_rare = words.correlation(0, np.array([1, 2]))
    assert with_rare > 2 * max(with_common, 0.0)
    share = (np.array([2, 6, 2, 2, 1, 1, 1, 1]) + 0.5) / 8.5
    idf = -np.log(share)
    query = np.isin(np.arange(8), [0, 1, 4])
    for location, present in ((1, [1, 5]), (2, [0, 6])):
        other = np.isin(np.arange(8), present)
        lengths = np.linalg.norm(query * idf) * np.linalg.norm(other * idf)
        expected = (query - share) * idf @ (other * idf) / lengths
        assert words.correlation(0, np.array([location]))[0] == pytest.approx(expected, rel=1e-5)


def test_fixed_sequences_are_as_long_as_they_should_be():
    distances = np.arange(30) * 1.0
    assert begins_of(FixedDistanceSegmentation(), 30 * [[]], distances) == [0, *range(5, 30, 5)][:6]


def test_a_fast_car_may_have_sequences_of_one_image():
    assert begins_of(FixedDistanceSegmentation(), 4 * [[]], [0, 7, 14, 21]) == [0, 1, 2, 3]


@pytest.mark.parametrize("distance", [0.0, 12.5, NAN])
def test_where_no_distance_is_measured_the_number_of_images_decides(distance):
    assert begins_of(
        FixedDistanceSegmentation(FixedDistanceConfig(unmeasured_images=4)), 10 * [[]], 10 * [distance]
    ) == [
        0,
        4,
        8,
    ]


def test_a_stop_does_not_make_an_endless_sequence():
    distances = [0, 1, 2, *(40 * [3])]
    begins = begins_of(FixedDistanceSegmentation(FixedDistanceConfig(max_images=20)), 43 * [[]], distances)
    assert max(np.diff(begins)) == 20


def test_the_share_of_new_words_ends_a_sequence_and_the_image_begins_the_next():
    words = [[0, 1, 2, 3], [0, 1, 2, 4], [1, 2, 4, 0], [9, 8, 7, 1], [9, 8, 7, 6]]
    config = WordVarianceConfig(min_variance=0.5, min_variance_ratio=0, min_images=1)
    assert begins_of(WordVariance(10, config), words, 5 * [NAN]) == [0, 3]


def test_words_count_once_an_image():
    words = [[0, 1], [0, 5, 5, 5, 5, 5, 1]]
    config = WordVarianceConfig(min_variance=0.5, min_variance_ratio=0, min_images=1)
    assert begins_of(WordVariance(10, config), words, 2 * [NAN]) == [0]


def test_dynamic_sequences_adapt_to_what_is_usual():
    """Half of each image is new to the one before: no fixed limit below that would hold images together."""
    words = [[k, k + 1] for k in range(20)] + [[40, 41]] + [[k, k + 1] for k in range(41, 48)]
    begins = begins_of(
        WordVariance(50, WordVarianceConfig(min_variance_ratio=1.1, min_images=1, max_images=100)), words, 28 * [NAN]
    )
    assert begins == [0, 20]


def test_images_without_words_end_no_dynamic_sequence_but_its_length_does():
    begins = begins_of(WordVariance(10, WordVarianceConfig(max_images=10)), 25 * [np.empty(0, np.int64)], 25 * [NAN])
    assert begins == [0, 10, 20]


def test_the_map_of_sequences_knows_its_images():
    sequences = SequenceMap(WORDS)
    for last in (2, 3, 7, 9):
        sequences.add(last, word_vector(np.array([1]), WEIGHTS))
    assert [sequences.count_ended_by(k) for k in (-1, 1, 2, 8, 20)] == [0, 0, 1, 3, 4]
    assert [sequences.sequence_of(k) for k in (0, 2, 3, 4, 9, 10)] == [0, 0, 1, 2, 3, 4]
    np.testing.assert_array_equal(sequences.first(np.arange(4)), [0, 3, 4, 8])
    np.testing.assert_array_equal(sequences.images_near(np.array([0])), np.arange(4))
    np.testing.assert_array_equal(sequences.images_near(np.array([3, 2])), np.arange(3, 10))
    assert len(sequences.images_near(np.empty(0, np.int64))) == 0


def test_the_heaviest_words_keep_their_values():
    vector = WordVector(np.array([2, 5, 7, 9]), np.array([0.1, 0.7, 0.2, 0.7], np.float32))
    strongest = vector.strongest(3)
    np.testing.assert_array_equal(strongest.words, [5, 7, 9])
    np.testing.assert_array_equal(strongest.values, np.float32([0.7, 0.2, 0.7]))
    assert vector.strongest(4) is vector
