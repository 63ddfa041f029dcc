"""What is kept of images comes back as it was, from memory and from disk."""

import errno
import os

import numpy as np
import pytest
from place_images import textured_world

from place_recognition.evaluation.memory import count_array_bytes
from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.image_processing.surf import Surf
from place_recognition.map.feature_store import FeatureStore


def random_features(rng, count, dimension=8, width=1241):
    descriptors = rng.normal(size=(count, dimension)).astype(np.float32)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    pixels = rng.uniform(0, width, (count, 2)).astype(np.float32)
    ones = np.ones(count, np.float32)
    return LocalFeatures(pixels, ones, ones, descriptors)


def filled_store(images, in_memory=4):
    store = FeatureStore(20, in_memory)
    for features in images:
        store.add(features)
    return store


@pytest.fixture
def images():
    rng = np.random.default_rng(0)
    return [random_features(rng, count) for count in (3, 30, 0, 20, 7, 1, 25, 9, 12, 20, 5)]


def test_stored_features_stay_as_they_were_to_a_fiftieth_and_a_sixteenth_of_a_pixel():
    features, store = Surf().extract(textured_world(300, seed=4)), FeatureStore(100)
    store.add(features)
    error = np.linalg.norm(store[0].descriptors - features.descriptors[:100], axis=1)
    assert error.max() < 0.03
    np.testing.assert_allclose(store[0].pixels, features.pixels[:100], atol=1 / 32 + 1e-6)


def test_images_on_disk_are_the_same_as_images_in_memory(images):
    small, large = filled_store(images, in_memory=2), filled_store(images, in_memory=100)
    assert small.disk_bytes > 0
    assert large.disk_bytes == 0
    for location in range(len(images)):
        np.testing.assert_array_equal(small[location].pixels, large[location].pixels)
        np.testing.assert_array_equal(small[location].quantized, large[location].quantized)


def test_memory_counts_what_was_kept_there_and_not_the_room_for_more(images):
    alone, few, many = filled_store(images[:1], 100), filled_store(images, 100), filled_store(images, 4)
    assert 0 < len(images) * count_array_bytes(alone) == count_array_bytes(few)
    assert count_array_bytes(many) == 4 * count_array_bytes(alone)
    assert count_array_bytes(many) + many.disk_bytes == count_array_bytes(few)


def test_the_strongest_features_of_several_images_come_together(images):
    store = filled_store(images)
    descriptors, counts = store.strongest([9, 0, 2, 10], 6)
    assert descriptors.shape == (4, 6, 8)
    np.testing.assert_array_equal(counts, [6, 3, 0, 5])
    for rows, count, location in zip(descriptors, counts, (9, 0, 2, 10), strict=True):
        np.testing.assert_array_equal(rows[:count], store[location].strongest(6).quantized)


def test_pixels_of_a_very_wide_image_are_kept_coarsely_rather_than_wrongly():
    features, store = random_features(np.random.default_rng(1), 20, width=20000), FeatureStore(20)
    store.add(features)
    np.testing.assert_allclose(store[0].pixels, features.pixels, atol=0.2)


def test_what_was_read_stays_when_its_place_in_memory_is_taken(images):
    store = filled_store(images[:4], in_memory=4)
    before = store[0]
    pixels = before.pixels.copy(), before.quantized.copy()
    for features in images[4:]:
        store.add(features)
    np.testing.assert_array_equal(before.pixels, pixels[0])
    np.testing.assert_array_equal(before.quantized, pixels[1])


def test_a_location_that_was_not_added_is_named(images):
    with pytest.raises(IndexError, match="expected a location below 11, got 11"):
        filled_store(images)[11]
    with pytest.raises(IndexError, match="expected a location below 0, got 0"):
        FeatureStore(20)[0]


def test_descriptors_of_another_length_are_refused(images):
    with pytest.raises(ValueError, match="expected descriptors of 8 numbers, got 9"):
        filled_store(images).add(random_features(np.random.default_rng(0), 4, dimension=9))


def test_a_full_disk_is_named_with_the_remedy(images, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "pwrite", full)
    with pytest.raises(OSError, match=r"cannot keep the features of older images .* point TMPDIR at a larger disk"):
        filled_store(images)


def test_a_disk_that_takes_only_a_part_counts_as_full(images, monkeypatch):
    monkeypatch.setattr(os, "pwrite", lambda *_: 5)
    with pytest.raises(OSError, match="cannot keep the features of older images"):
        filled_store(images)
