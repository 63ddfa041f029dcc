"""A tree of binary words: descent finds what it must, and the tree that ships serves the published presets."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from place_images import changed, kitti_images

from place_recognition.image_processing.extractors import Brief
from place_recognition.vocabulary.vocabulary import Vocabulary, published_vocabulary
from place_recognition.vocabulary.vocabulary_training import VocabularyTrainingConfig, train_tree
from place_recognition.vocabulary.vocabulary_tree import BEAM, VocabularyTree, as_numbers, hamming

PUBLISHED_VARIANCE = 0.75  # at which a sequence ends (Bampis et al., IJRR 2018)


def tree_of(children: list[int], size: int = 8, seed: int = 0) -> VocabularyTree:
    """A tree of this shape with random centres."""
    centers = np.random.default_rng(seed).integers(0, 256, (len(children), size // 8), dtype=np.uint8)
    return VocabularyTree("t", size, centers, np.array(children, np.uint8), np.ones(children.count(0), np.float32))


def signs(bits: np.ndarray) -> np.ndarray:
    return np.where(bits, 1, -1).astype(np.float32) / np.float32(np.sqrt(bits.shape[1]))


@given(st.integers(0, 2**32 - 1), st.integers(1, BEAM), st.integers(0, 30))
@settings(deadline=None, max_examples=40)
def test_where_no_level_is_wider_than_the_beam_the_nearest_word_is_found_and_the_first_of_equals(seed, words, count):
    tree, bits = tree_of([words] + [0] * words, 64, seed), np.random.default_rng(seed + 1).random((count, 64)) < 0.5
    distances = (bits[:, None] != (tree.words > 0)[None]).sum(axis=2)
    np.testing.assert_array_equal(tree.assign(signs(bits)), distances.argmin(axis=1) if count else [])


def test_words_of_all_depths_are_found_and_numbered_in_the_order_of_the_nodes():
    tree = tree_of([3, 0, 2, 1, 0, 0, 0], 64)  # leaves: node 1 at the first level, 4 to 6 at the second
    assert len(tree) == 4
    np.testing.assert_array_equal(tree.words > 0, np.unpackbits(tree.centers[[1, 4, 5, 6]], axis=1))
    assert tree.assign(tree.words).tolist() == [0, 1, 2, 3]


def test_in_a_large_tree_nearly_every_nearest_word_is_found():
    # Comparisons of brightness depend on few causes; independent bits would have no clusters to descend to.
    rng = np.random.default_rng(0)
    bits = rng.normal(size=(20000, 12)) @ rng.normal(size=(12, 256)) > 0
    tree = train_tree("t", 256, as_numbers(np.packbits(bits, axis=1)), VocabularyTrainingConfig(words=3000))
    query = bits[::40] ^ (rng.random((500, 256)) < 0.05)
    distances = (query[:, None] != (tree.words > 0)[None]).sum(axis=2)
    found = distances[np.arange(500), tree.assign(signs(query))]
    assert (found == distances.min(axis=1)).mean() > 0.9


@given(st.lists(st.integers(0, 2**64 - 1), min_size=1, max_size=5), st.data())
def test_distances_count_the_bits_that_differ(first, data):
    second = data.draw(st.lists(st.integers(0, 2**64 - 1), min_size=len(first), max_size=len(first)))
    expected = sum((a ^ b).bit_count() for a, b in zip(first, second, strict=True))
    assert hamming(np.array(first, np.uint64), np.array(second, np.uint64)) == expected


@pytest.mark.parametrize("children", [[0], [1], [2, 0], [0, 2, 0], [2, 0, 0, 0], [1, 0, 2, 0, 0], [1, 2, 0]])
def test_what_is_no_tree_is_refused(children):
    with pytest.raises(ValueError, match="make a tree"):
        tree_of(children)


def test_shapes_that_do_not_belong_together_and_other_descriptors_are_refused():
    tree = tree_of([2, 0, 0])
    with pytest.raises(ValueError, match=r"centers \(3, 1\), got \(2, 1\)"):
        VocabularyTree("t", 8, tree.centers[:2], tree.children, tree.weights)
    with pytest.raises(ValueError, match=r"weights \(2,\), got \(3,\)"):
        VocabularyTree("t", 8, tree.centers, tree.children, np.ones(3, np.float32))
    with pytest.raises(ValueError, match="finite"):
        VocabularyTree("t", 8, tree.centers, tree.children, np.array([1, np.nan], np.float32))
    with pytest.raises(ValueError, match=r"descriptors \(N, 8\), got \(3, 9\)"):
        tree.assign(np.zeros((3, 9), np.float32))
    with pytest.raises(ValueError, match="orb-256 features, found one of t"):
        tree.require("orb-256")
    assert tree.assign(np.empty((0, 0), np.float32)).shape == (0,)


@pytest.fixture(scope="module")
def published() -> Vocabulary:
    return published_vocabulary()


def test_the_published_words_are_many_and_made_of_brief(published: Vocabulary):
    assert len(published.require(Brief().kind)) == 100000
    assert published.weights.min() >= 0
    assert (published.assign(published.words[::50]) == np.arange(0, 100000, 50)).mean() > 0.95


def variance(words: np.ndarray, shown: list[np.ndarray]) -> float:
    """Share of the distinct words of an image that the images of its sequence have not shown."""
    return 1 - float(np.isin(np.unique(words), np.concatenate(shown)).mean())


def test_the_published_variance_parts_a_drive_from_other_streets(published: Vocabulary, test_data: Path):
    drives = {
        name: [published.assign(Brief().extract(image).descriptors) for image in kitti_images(test_data, name, frames)]
        for name, frames in {"05": range(0, 60, 1), "07": range(0, 60, 1)}.items()
    }
    for name, other in (("05", "07"), ("07", "05")):
        here, elsewhere = drives[name], drives[other]
        inside = [variance(here[k], here[k - 3 : k]) for k in range(3, 60)]
        outside = [variance(elsewhere[k], here[k - 3 : k]) for k in range(3, 60)]
        assert np.mean(np.array(inside) < PUBLISHED_VARIANCE) > 0.95
        assert min(outside) > 0.85 > PUBLISHED_VARIANCE


def test_the_published_words_find_a_place_again_by_histograms_alone(published: Vocabulary, test_data: Path):
    streets = [image for name in ("05", "06", "07") for image in kitti_images(test_data, name, range(0, 50, 10))]

    def vector(image: np.ndarray) -> np.ndarray:
        counts = np.bincount(published.assign(Brief().extract(image).descriptors), minlength=len(published))
        return counts * published.weights / np.linalg.norm(counts * published.weights)

    first = np.array([vector(street) for street in streets])
    second = np.array([vector(changed(street, k)) for k, street in enumerate(streets)])
    cosines = second @ first.T
    assert (cosines.argmax(axis=1) == np.arange(len(streets))).all()
    others = cosines[~np.eye(len(streets), dtype=bool)]
    assert np.diag(cosines).min() > np.percentile(others, 90)
