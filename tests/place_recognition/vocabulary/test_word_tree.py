"""Words are found in a tree of cells nearly as well as by comparing all, and in the same way each time."""

import numpy as np
import pytest
from place_images import textured_world

from place_recognition.image_processing.local_features import SpreadConfig
from place_recognition.image_processing.surf import Surf, SurfConfig
from place_recognition.vocabulary.word_tree import ExactWordIndex, HybridWordIndex, WordTree, beam_width
from place_recognition.vocabulary.word_tree_kernels import CAPACITY, MIN_FILL


@pytest.fixture(scope="module")
def words():
    """Real descriptors, shortened as means of tracks are."""
    images = [textured_world(1200, seed, height=500) for seed in range(12)]
    descriptors = np.concatenate(
        [
            Surf(SurfConfig(max_features=2000, spread=SpreadConfig(bucket_px=10))).extract(image).descriptors
            for image in images
        ]
    )
    return 0.95 * np.random.default_rng(0).permutation(descriptors)


def filled(index, words, batch=37):
    for begin in range(0, len(words), batch):
        index.add(words[begin : begin + batch])
    return index


@pytest.fixture(scope="module")
def tree(words):
    return filled(WordTree(), words)


def test_nearly_all_nearest_words_are_found(tree, words):
    rng = np.random.default_rng(1)
    query = words[:500] + rng.normal(0, 0.02, (500, 64)).astype(np.float32)
    exact = filled(ExactWordIndex(), words).nearest(query)
    assert len(words) > 40 * CAPACITY
    assert np.mean(tree.nearest(query) == exact) > 0.95


def test_every_word_is_in_one_leaf(tree, words):
    nodes = tree._nodes
    level = [int(nodes.shape[1])]
    for _ in range(int(nodes.shape[2]) - 1):
        level = [int(entry) for node in level for entry in nodes.entries[node, : nodes.counts[node]]]
    found = np.concatenate([nodes.entries[leaf, : nodes.counts[leaf]] for leaf in level])
    np.testing.assert_array_equal(np.sort(found), np.arange(len(words)))


def test_cells_are_neither_overfull_nor_nearly_empty(tree):
    nodes = tree._nodes
    used, root = int(nodes.shape[0]), int(nodes.shape[1])
    assert np.all(nodes.counts[:used] < CAPACITY)
    assert np.all(np.delete(nodes.counts[:used], root) >= MIN_FILL)


def test_words_added_one_by_one_are_found_like_words_added_together(words):
    some = words[: 5 * CAPACITY]
    one_by_one, together = filled(WordTree(), some, batch=1), filled(WordTree(), some, batch=len(some))
    np.testing.assert_array_equal(one_by_one.nearest(words[:300]), together.nearest(words[:300]))


def test_equal_words_split_without_end_in_sight():
    index = filled(WordTree(), np.tile(np.eye(64, dtype=np.float32)[:2], (3 * CAPACITY, 1)))
    found = index.nearest(np.eye(64, dtype=np.float32)[:2])
    np.testing.assert_array_equal(found % 2, [0, 1])


def test_few_words_are_all_compared(words):
    few = words[:600]
    np.testing.assert_array_equal(
        filled(HybridWordIndex(max_exact_words=600), few).nearest(words), filled(ExactWordIndex(), few).nearest(words)
    )


def test_an_index_that_outgrows_comparing_all_still_finds_every_word_itself(words):
    index = filled(HybridWordIndex(max_exact_words=300), words[:2000])
    assert len(index) == 2000
    assert np.mean(index.nearest(words[:2000]) == np.arange(2000)) > 0.99


def test_words_of_other_lengths_are_found_too():
    rng = np.random.default_rng(3)
    binary = np.where(rng.random((900, 256)) < 0.5, -1, 1).astype(np.float32) / 16
    np.testing.assert_array_equal(filled(WordTree(), binary).nearest(binary[:100]), np.arange(100))


def test_more_words_take_more_cells():
    assert [beam_width(count) for count in (0, 1000, 65536, 2**20, 2**24)] == [16, 16, 16, 32, 64]
