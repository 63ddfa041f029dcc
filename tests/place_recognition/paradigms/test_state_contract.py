"""A recogniser that is restored from a state goes on, bit for bit, as the one that was never disturbed."""

import copy

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from place_images import CachingSurf, two_laps

from place_recognition.evaluation.similarity_matrix import MatrixRecorder
from place_recognition.growing_array import GrowingArray
from place_recognition.image_processing.local_features import FeatureCache, LocalFeatures
from place_recognition.map.feature_store import FeatureStore
from place_recognition.map.inverted_index import InvertedIndex
from place_recognition.paradigms.registry import PARADIGMS, ParadigmsConfig, make_control, make_recognizer
from place_recognition.recognizer import Belief
from place_recognition.vocabulary.tf_idf import WordVector
from place_recognition.vocabulary.word_tree import ExactWordIndex, HybridWordIndex, WordTree

STEP_M = 2.0  # metres from image to image


def bits(state):
    """A state as a comparable value: arrays as dtype, shape and bytes."""
    if isinstance(state, np.ndarray | np.generic):
        return str(state.dtype), state.shape, state.tobytes()
    if isinstance(state, dict):
        return {key: bits(value) for key, value in state.items()}
    return [bits(value) for value in state] if isinstance(state, list | tuple) else repr(state)


@pytest.fixture(scope="module", params=[*PARADIGMS, "control", "published"])
def name(request):
    return request.param


def make(name, rows=None):
    features = FeatureCache(CachingSurf())
    if name == "control":
        return make_control(features)
    if name == "published":
        return make_recognizer("tracked-words", features, ParadigmsConfig(preset="published"), rows)
    return make_recognizer(name, features, rows=rows)


def observe(recognizer, images, first=0):
    return [b for i, image in enumerate(images, first) for b in recognizer.observe(i, image, STEP_M * i)]


@pytest.mark.parametrize("stop", [0, 1, 23, 44, 70])
def test_a_restored_recogniser_goes_on_with_the_same_bits(name, stop):
    undisturbed, stopped, restored = make(name), make(name), make(name)
    expected = observe(undisturbed, two_laps())
    before = observe(stopped, two_laps()[:stop])
    restored.restore(copy.deepcopy(stopped.state()))
    after = observe(restored, two_laps()[stop:], stop)
    assert before + after == expected
    assert all(np.array_equal(a.pixels, b.pixels) for a, b in zip(before + after, expected, strict=True))
    assert bits(restored.state()) == bits(undisturbed.state())
    assert restored.finish() == undisturbed.finish()


def test_reading_a_state_changes_nothing(name):
    undisturbed, read = make(name), make(name)
    expected = observe(undisturbed, two_laps()[:50])
    beliefs: list[Belief] = []
    for i, image in enumerate(two_laps()[:50]):
        read.state()
        beliefs += read.observe(i, image, STEP_M * i)
    assert beliefs == expected


def test_the_state_of_another_paradigm_is_refused():
    states = {name: make(name) for name in ("tracked-words", "hierarchical-places", "global-descriptor")}
    for recognizer in states.values():
        observe(recognizer, two_laps()[:3])
    for name, recognizer in states.items():
        for other in states.keys() - {name}:
            with pytest.raises((KeyError, TypeError, ValueError)):
                make(other).restore(copy.deepcopy(recognizer.state()))


def test_a_vocabulary_of_another_size_is_refused():
    with pytest.raises(ValueError, match="expected postings of 5 words, got 4"):
        InvertedIndex(5).restore(InvertedIndex(4).state())


@given(st.lists(st.integers(1, 6), max_size=6), st.integers(1, 6))
def test_a_restored_array_grows_as_the_first_one(counts, more):
    array: GrowingArray[np.float64] = GrowingArray(np.float64)
    other: GrowingArray[np.float64] = GrowingArray(np.float64)
    for k, count in enumerate(counts):
        array.extend(np.full((count, 3), k))
    other.restore(array.state().copy())
    for one in (array, other):
        one.extend(np.ones((more, 3)))
    np.testing.assert_array_equal(array.rows, other.rows)


def test_an_array_of_another_type_is_refused():
    with pytest.raises(ValueError, match="expected rows of int64, got float64"):
        GrowingArray(np.int64).restore(np.zeros((2, 2)))


def unit_vectors(rng, count, size=16):
    vectors = rng.standard_normal((count, size)).astype(np.float32)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("index", [ExactWordIndex, WordTree, lambda: HybridWordIndex(max_exact_words=100)])
@pytest.mark.parametrize("count", [0, 60, 700])
def test_a_restored_index_finds_the_same_words(index, count):
    rng = np.random.default_rng(count)
    one, other = index(), index()
    one.add(unit_vectors(rng, count))
    other.restore(copy.deepcopy(one.state()))
    more, queries = unit_vectors(rng, 300), unit_vectors(rng, 50)
    one.add(more)
    other.add(more)
    np.testing.assert_array_equal(one.nearest(queries), other.nearest(queries))
    assert bits(one.state()) == bits(other.state())


@pytest.mark.parametrize("images", [0, 2, 7])
def test_a_restored_store_has_the_same_features_in_memory_and_on_disk(images):
    rng = np.random.default_rng(0)
    one, other = FeatureStore(5, in_memory=3), FeatureStore(5, in_memory=3)
    for _ in range(images):
        some = rng.random((5, 2)).astype(np.float32)
        one.add(LocalFeatures(100 * some, 1 + some[:, 0], some[:, 1], unit_vectors(rng, 5, 8)))
    other.restore(copy.deepcopy(one.state()))
    assert len(other) == images
    assert other.disk_bytes == one.disk_bytes
    for k in range(images):
        np.testing.assert_array_equal(other[k].quantized, one[k].quantized)
        np.testing.assert_array_equal(other[k].pixels, one[k].pixels)


def test_a_restored_inverted_index_gives_the_same_cosines():
    rng, one, other = np.random.default_rng(1), InvertedIndex(20), InvertedIndex(20)
    vectors = [
        WordVector(np.sort(rng.choice(20, 6, replace=False)).astype(np.int64), np.full(6, 6**-0.5, np.float32))
        for _ in range(1200)  # several blocks a word
    ]
    for vector in vectors[:700]:
        one.add(vector)
    other.restore(copy.deepcopy(one.state()))
    for vector in vectors[700:]:
        one.add(vector)
        other.add(vector)
    np.testing.assert_array_equal(one.cosines(vectors[0], 1200), other.cosines(vectors[0], 1200))


def test_a_restored_matrix_goes_on_though_rows_were_merged():
    rng, one, other = np.random.default_rng(2), MatrixRecorder(8), MatrixRecorder(8)
    rows = [(k, np.arange(k), rng.random(k)) for k in range(1, 30)]
    for row in rows[:20]:
        one.add(*row)
    other.restore(copy.deepcopy(one.state()))
    for row in rows[20:]:
        one.add(*row, stage="filtered")
        other.add(*row, stage="filtered")
    for stage in one.stages:
        np.testing.assert_array_equal(one.matrix(30, stage).values, other.matrix(30, stage).values)
