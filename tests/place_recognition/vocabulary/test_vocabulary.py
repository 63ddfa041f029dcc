"""Words given in advance: the nearest is found, what does not fit is refused, and the shipped ones serve."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from place_images import changed, kitti_images, sliding_view, textured_world

from place_recognition.image_processing.surf import Surf
from place_recognition.vocabulary.vocabulary import FlatVocabulary, default_vocabulary, word_histogram


def some_words(count: int = 50, size: int = 8, seed: int = 0) -> FlatVocabulary:
    rng = np.random.default_rng(seed)
    return FlatVocabulary("test-8", rng.normal(size=(count, size)).astype(np.float32), np.ones(count, np.float32))


@given(st.integers(0, 2**32 - 1), st.integers(1, 400), st.integers(0, 40), st.integers(1, 70))
@settings(deadline=None, max_examples=40)
def test_a_descriptor_gets_the_word_at_the_least_distance(seed: int, words: int, count: int, size: int):
    vocabulary = some_words(words, size, seed)
    descriptors = np.random.default_rng(seed + 1).normal(size=(count, size)).astype(np.float32)
    distances = np.linalg.norm(descriptors[:, None].astype(float) - vocabulary.words[None], axis=2)
    chosen = distances[np.arange(count), vocabulary.assign(descriptors)]
    np.testing.assert_allclose(chosen, distances.min(axis=1, initial=np.inf), rtol=1e-5, atol=5e-4)


def test_of_twin_words_the_first_is_taken():
    words = np.repeat(some_words(5).words, 2, axis=0)
    twins = FlatVocabulary("test-8", words, np.ones(10, np.float32))
    assert twins.assign(words).tolist() == [0, 0, 2, 2, 4, 4, 6, 6, 8, 8]


def test_no_descriptors_have_no_words():
    assert some_words().assign(np.empty((0, 0), np.float32)).shape == (0,)


def test_descriptors_of_another_length_are_refused():
    with pytest.raises(ValueError, match=r"expected descriptors \(N, 8\), got \(3, 9\)"):
        some_words().assign(np.zeros((3, 9), np.float32))


def test_a_vocabulary_of_another_kind_is_refused_by_both_names():
    with pytest.raises(ValueError, match=r"orb-256 features, found one of test-8; .*vocabulary train"):
        some_words().require("orb-256")


def test_a_vocabulary_of_the_right_kind_is_passed_on():
    vocabulary = some_words()
    assert vocabulary.require("test-8") is vocabulary


@pytest.mark.parametrize(
    ("words", "weights"), [((3, 4), (2,)), ((0, 4), (0,)), ((3,), (3,)), ((3, 4), (3, 1)), ((2, 0), (2,))]
)
def test_shapes_that_do_not_belong_together_are_refused(words: tuple[int, ...], weights: tuple[int, ...]):
    with pytest.raises(ValueError, match="expected words"):
        FlatVocabulary("test", np.zeros(words, np.float32), np.zeros(weights, np.float32))


def test_words_that_are_not_finite_are_refused():
    with pytest.raises(ValueError, match="finite"):
        FlatVocabulary("test", np.full((2, 2), np.nan, np.float32), np.ones(2, np.float32))


def test_a_histogram_counts_every_feature_once():
    vocabulary, features = default_vocabulary(), Surf().extract(textured_world(400, 1))
    histogram = word_histogram(features, vocabulary)
    assert histogram.shape == (len(vocabulary),)
    assert histogram.sum() == len(features) > 100


def test_an_image_without_features_has_an_empty_histogram():
    blank = Surf().extract(np.zeros((100, 100), np.uint8))
    assert not word_histogram(blank, default_vocabulary()).any()


def vector(image: np.ndarray) -> np.ndarray:
    vocabulary = default_vocabulary()
    weighted = word_histogram(Surf().extract(image), vocabulary) * vocabulary.weights
    return weighted / np.linalg.norm(weighted)


def test_the_shipped_words_are_made_of_surf_and_fit_into_the_package():
    vocabulary = default_vocabulary().require(Surf().kind)
    assert vocabulary.words.shape[1] == 64
    assert vocabulary.weights.min() >= 0
    assert (np.bincount(vocabulary.assign(vocabulary.words), minlength=len(vocabulary)) == 1).mean() > 0.99


def test_the_shipped_words_tell_places_of_an_unseen_world_apart():
    places = sliding_view(textured_world(2000, 5), [0, 400, 800, 1200, 1600])
    first = np.array([vector(place) for place in places])
    second = np.array([vector(changed(place, k)) for k, place in enumerate(places)])
    assert (second @ first.T).argmax(axis=1).tolist() == [0, 1, 2, 3, 4]


def test_the_shipped_words_tell_real_streets_apart(test_data: Path):
    streets = [
        image for sequence in ("05", "06", "07") for image in kitti_images(test_data, sequence, range(0, 40, 20))
    ]
    first = np.array([vector(street) for street in streets])
    second = np.array([vector(changed(street, k)) for k, street in enumerate(streets)])
    assert (second @ first.T).argmax(axis=1).tolist() == [0, 1, 2, 3, 4, 5]


@given(st.integers(0, 2**32 - 1), st.integers(1, 200), st.integers(0, 40))
@settings(deadline=None, max_examples=40)
def test_of_binary_words_at_one_hamming_distance_the_first_is_taken(seed: int, words: int, count: int):
    rng = np.random.default_rng(seed)
    bits, centers = rng.random((count, 256)) < 0.5, rng.random((words, 256)) < 0.5
    signs = [np.where(rows, 1 / 16, -1 / 16).astype(np.float32) for rows in (bits, centers)]
    assigned = FlatVocabulary("orb-256", signs[1], np.ones(words, np.float32)).assign(signs[0])
    distances = (bits[:, None] != centers[None]).sum(axis=2)
    np.testing.assert_array_equal(assigned, distances.argmin(axis=1) if count else np.empty(0, np.int64))
