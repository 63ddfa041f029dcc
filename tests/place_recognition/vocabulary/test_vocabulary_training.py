"""Training finds the groups that are there, in bounded memory, and the same ones every time."""

import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from place_recognition.vocabulary.vocabulary_training import (
    DescriptorSample,
    VocabularyTrainingConfig,
    grow_tree,
    inverse_document_frequencies,
    train_tree,
    train_vocabulary,
)
from place_recognition.vocabulary.vocabulary_tree import as_bytes, as_numbers

TRAIN_AND_PRINT = """
import hashlib, numpy as np
from place_recognition.vocabulary.vocabulary_training import VocabularyTrainingConfig, train_vocabulary
points = np.random.default_rng(3).normal(size=(6000, 64)).astype(np.float32)
vocabulary = train_vocabulary("test", points / 8, VocabularyTrainingConfig(words=150, iterations=8))
print(hashlib.sha256(vocabulary.words.tobytes() + vocabulary.weights.tobytes()).hexdigest())
"""


def groups(count: int, members: int, noise: float = 0.01) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (count * members, 16) around as many centres as count, and the centres."""
    rng = np.random.default_rng(count)
    centers = rng.normal(size=(count, 16))
    centers /= np.linalg.norm(centers, axis=1, keepdims=True)
    spread = np.repeat(centers, members, axis=0) + rng.normal(0, noise, (count * members, 16))
    return spread.astype(np.float32), centers.astype(np.float32)


def binary_groups(count: int, members: int, flips: float) -> tuple[np.ndarray, np.ndarray]:
    """Bits (count * members, 256), each flipped with a chance, and the groups' own (count, 256)."""
    rng = np.random.default_rng(count)
    centers = rng.random((count, 256)) < 0.5
    return np.repeat(centers, members, axis=0) ^ (rng.random((count * members, 256)) < flips), centers


def leaf_bits(bits: np.ndarray, words: int, branching: int, seed: int = 0) -> np.ndarray:
    """Bits (W, D) of the leaves of a tree of descriptors (N, D)."""
    numbers = as_numbers(np.packbits(bits, axis=1))
    centers, children = grow_tree(numbers, words, branching, np.random.default_rng(seed))
    return np.unpackbits(as_bytes(centers, bits.shape[1])[children == 0], axis=1, count=bits.shape[1])


def test_each_group_of_descriptors_becomes_a_word():
    descriptors, centers = groups(12, 40)
    vocabulary = train_vocabulary("test", descriptors, VocabularyTrainingConfig(words=60))
    assert len(vocabulary) == 60
    assert np.linalg.norm(vocabulary.words[vocabulary.assign(centers)] - centers, axis=1).max() < 0.06


def test_weights_are_the_logarithm_of_how_rare_a_word_is():
    seen = np.array([0, 0, 0, 0, 0, 0, 1, 1])
    np.testing.assert_allclose(inverse_document_frequencies(3, seen), np.log([8 / 6, 8 / 2, 8]), rtol=1e-6)


def test_threads_do_not_change_a_bit():
    digests = set()
    for threads in ("1", "4"):
        path = ":".join(folder for folder in sys.path if folder)
        environment = {
            "PYTHONPATH": path,
            "OMP_NUM_THREADS": threads,
            "OPENBLAS_NUM_THREADS": threads,
            "NUMBA_NUM_THREADS": "1",
        }
        command = [sys.executable, "-c", TRAIN_AND_PRINT]
        run = subprocess.run(command, env=os.environ | environment, capture_output=True, text=True, check=True)
        digests.add(run.stdout)
    assert len(digests) == 1


def test_another_seed_gives_other_words():
    descriptors, _ = groups(30, 30, noise=0.3)
    first, second = (
        train_vocabulary("t", descriptors, VocabularyTrainingConfig(words=40, seed=seed)) for seed in (0, 1)
    )
    assert not np.array_equal(first.words, second.words)


def test_binary_descriptors_get_binary_words_of_the_groups():
    bits, centers = binary_groups(25, 30, flips=0.1)
    signs = np.where(bits, 1 / 16, -1 / 16).astype(np.float32)
    vocabulary = train_vocabulary("orb-256", signs, VocabularyTrainingConfig(words=100))
    assert set(np.unique(vocabulary.words)) == {np.float32(-1 / 16), np.float32(1 / 16)}
    distances = (centers[:, None] != (vocabulary.words > 0)[None]).sum(axis=2)
    assert (distances.min(axis=1) < 8).mean() > 0.9  # the tree may part a group at its root


@given(st.integers(0, 1000), st.integers(1, 40), st.integers(2, 12), st.integers(1, 120))
@settings(deadline=None, max_examples=40)
def test_a_tree_has_as_many_leaves_as_asked_or_as_there_are_descriptors(seed: int, words: int, branching: int, n: int):
    bits = np.random.default_rng(seed).random((n, 24)) < 0.5
    leaves = leaf_bits(bits, words, branching, seed)
    different = len(np.unique(bits, axis=0))
    assert 1 <= len(leaves) <= min(words, different)
    assert len(leaves) >= min(words, different, 2)


def test_equal_descriptors_are_one_word():
    assert leaf_bits(np.ones((50, 32), bool), 10, 4).tolist() == [[1] * 32]


def test_a_majority_votes_bit_by_bit_and_a_tie_is_zero():
    bits = np.array([[1, 1, 0, 0], [1, 0, 1, 0]], bool)
    assert leaf_bits(bits, 1, 4).tolist() == [[1, 0, 0, 0]]


def test_a_tree_trained_twice_is_the_same_and_depends_on_its_seed():
    bits = np.random.default_rng(1).integers(0, 2**63, (3000, 4)).astype(np.uint64)
    first, again, other = (
        train_tree("t", 256, bits, VocabularyTrainingConfig(words=200, seed=seed)) for seed in (0, 0, 1)
    )
    assert len(first) == 200
    assert first.centers.tobytes() == again.centers.tobytes() != other.centers.tobytes()
    assert first.weights.tobytes() == again.weights.tobytes()


def test_a_center_is_the_majority_of_the_descriptors_below_it():
    bits = np.random.default_rng(2).integers(0, 2**63, (400, 2)).astype(np.uint64)
    centers, children = grow_tree(bits, 4, 4, np.random.default_rng(0))
    assert children.tolist() == [4, 0, 0, 0, 0]
    rows, means = (np.unpackbits(as_bytes(numbers, 128), axis=1) for numbers in (bits, centers[1:]))
    members = (rows[:, None] != means[None]).sum(axis=2).argmin(axis=1)
    for k in range(4):
        votes = rows[members == k].mean(axis=0)
        assert ((votes > 0.5) == means[k]).mean() > 0.95  # the last round may move a few members


@given(st.lists(st.integers(0, 40), max_size=12), st.integers(1, 60))
@settings(deadline=None)
def test_a_sample_holds_what_was_seen_and_no_more_than_allowed(sizes: list[int], limit: int):
    sample, stream = DescriptorSample(limit, seed=0), np.arange(sum(sizes), dtype=np.float32)[:, None]
    for block in np.split(stream, np.cumsum(sizes)[:-1]) if sizes else []:
        sample.add(block)
    kept = sample.descriptors.ravel()
    assert sample.seen == len(stream)
    assert len(kept) == len(set(kept)) == min(limit, len(stream))


def test_every_descriptor_of_a_stream_has_the_same_chance():
    times = np.zeros(100)
    for seed in range(600):
        sample = DescriptorSample(20, seed)
        for block in np.array_split(np.arange(100, dtype=np.float32)[:, None], 7):
            sample.add(block)
        times[sample.descriptors.ravel().astype(int)] += 1
    # binomial of 600 draws with a chance of 0.2: 120 +- 9.8; five sigmas
    assert np.abs(times - 120).max() < 49


def test_too_few_descriptors_are_refused():
    with pytest.raises(ValueError, match=r"expected at least 30 descriptors for 30 words, got 4; give more images"):
        train_vocabulary("test", groups(2, 2)[0], VocabularyTrainingConfig(words=30))


@pytest.mark.parametrize("setting", [{"words": 0}, {"iterations": 0}, {"words": 100, "sample": 10}])
def test_settings_that_cannot_work_are_refused(setting: dict[str, int]):
    with pytest.raises(ValueError, match="expected words and iterations from 1"):
        VocabularyTrainingConfig(**setting)
