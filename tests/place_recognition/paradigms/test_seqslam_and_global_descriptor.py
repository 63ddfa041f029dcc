"""The naive baselines and their parts: dense maps, and lines in a matrix."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from place_images import (
    LAP_IMAGES,
    MIN_AGE,
    changed,
    kitti_images,
    observed_images,
    propose_all,
    sliding_view,
    textured_world,
)

from place_recognition.image_processing.global_descriptors import Hog
from place_recognition.map.descriptor_database import DescriptorDatabase, absolute_differences, dot_products
from place_recognition.paradigms.whole_images import (
    GlobalDescriptorMatching,
    PixelSequences,
    best_lines,
    local_contrast,
)


class Collected:
    """Keeps the rows of each stage (a MatrixSink)."""

    def __init__(self):
        self.rows = {"similarity": {}, "filtered": {}}

    def add(self, query, matches, values, stage="similarity"):
        self.rows[stage][query] = (np.array(matches), np.array(values))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.integers(0, 20))
def test_compiled_products_and_differences_agree_with_numpy(seed, size, count):
    rng = np.random.default_rng(seed)
    query, rows = rng.integers(-127, 128, size).astype(np.int8), rng.integers(-127, 128, (count, size)).astype(np.int8)
    np.testing.assert_array_equal(dot_products(query, rows), rows.astype(np.int64) @ query.astype(np.int64))
    one, many = rng.integers(0, 256, size).astype(np.uint8), rng.integers(0, 256, (count, size)).astype(np.uint8)
    expected = np.abs(many.astype(np.int64) - one).sum(axis=1)
    np.testing.assert_array_equal(absolute_differences(one, many), expected)


def test_a_descriptor_database_gives_the_cosine_whatever_the_lengths():
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(50, 300)).astype(np.float32) * rng.uniform(1e-6, 1e6, (50, 1)).astype(np.float32)
    dense = DescriptorDatabase()
    for vector in vectors:
        dense.add(vector)
    unit = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    np.testing.assert_allclose(dense.similarities(vectors[3] * 7, 50), unit @ unit[3], atol=0.01)
    np.testing.assert_array_equal(dense.similarities(vectors[3], 4), dense.similarities(vectors[3], 50)[:4])


def test_vectors_of_zeros_are_like_nothing():
    dense = DescriptorDatabase()
    for vector in np.eye(3, 4, dtype=np.float32) * [[1], [0], [1]]:
        dense.add(vector.astype(np.float32))
    np.testing.assert_array_equal(dense.similarities(np.float32([1, 0, 0, 0]), 3), [1, 0, 0])
    assert not dense.similarities(np.zeros(4, np.float32), 3).any()
    assert dense.similarities(np.zeros(4, np.float32), 0).shape == (0,)


def test_a_descriptor_database_refuses_other_sizes_and_what_is_no_number():
    dense = DescriptorDatabase()
    dense.add(np.ones(5, np.float32))
    with pytest.raises(ValueError, match=r"expected a descriptor \(5,\), got \(4,\)"):
        dense.add(np.ones(4, np.float32))
    with pytest.raises(ValueError, match="expected a descriptor of finite numbers"):
        dense.similarities(np.full(5, np.nan, np.float32), 1)
    with pytest.raises(ValueError, match=r"expected a descriptor \(D,\), got \(2, 2\)"):
        DescriptorDatabase().add(np.ones((2, 2), np.float32))


def test_local_contrast_agrees_with_a_plain_loop():
    differences = np.random.default_rng(1).integers(0, 1000, 40)
    contrast = local_contrast(differences, 6, 1.0)
    for k in range(40):
        around = [differences[i] for i in range(max(k - 6, 0), min(k + 7, 40)) if i != k]
        assert contrast[k] == pytest.approx((np.mean(around) - differences[k]) / np.std(around), rel=1e-5)


def test_local_contrast_of_equal_differences_or_of_a_single_one_is_nothing():
    assert not local_contrast(np.full(30, 77), 5, 1.0).any()
    assert not local_contrast(np.array([5]), 5, 1.0).any()
    assert local_contrast(np.empty(0, np.int64), 5, 1.0).shape == (0,)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 30))
def test_the_best_lines_agree_with_a_plain_search(seed, count):
    rng = np.random.default_rng(seed)
    rows = tuple(rng.normal(size=max(count - i, 0)).astype(np.float32) for i in range(5))
    offsets = np.array([[0, 1, 1, 2, 2], [0, 1, 2, 3, 4], [0, 2, 4, 6, 8]])

    def line(end, steps):
        places = [(i, end - step) for i, step in enumerate(steps)]
        return sum(rows[i][k] for i, k in places if 0 <= k < len(rows[i]))

    expected = [max(line(end, steps) for steps in offsets) for end in range(count)]
    np.testing.assert_allclose(best_lines(rows, offsets, count), expected, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("speed", [0.6, 1.0, 1.6])
def test_a_lap_driven_at_another_speed_is_proposed_by_its_sequence(speed):
    world = textured_world(2200, seed=8)
    first = sliding_view(world, list(range(0, 1800, 20)))
    starts = np.arange(400, 1500, round(20 * speed))
    images = observed_images(first + sliding_view(world, list(starts)))
    proposals = propose_all(PixelSequences(), images)[len(first) + 10 :]
    right = [
        bool(one.locations) and abs(20 * one.locations[0] - start) <= 20
        for one, start in zip(proposals, starts[10:], strict=True)
    ]
    assert np.mean(right) > 0.9


def test_a_sequence_has_a_higher_score_than_a_few_images():
    second = propose_all(PixelSequences(), observed_images())[LAP_IMAGES:]
    assert np.mean([one.scores[0] for one in second[10:]]) > 2 * second[2].scores[0]


def test_the_score_is_what_the_best_line_exceeds_the_best_one_elsewhere_by():
    rows = Collected()
    proposer = PixelSequences(rows=rows)
    proposals = propose_all(proposer, observed_images())
    window = proposer.config.window
    for one in proposals[LAP_IMAGES + 10 :]:
        _, sums = rows.rows["filtered"][one.query]
        best = int(sums.argmax())
        elsewhere = [value for k, value in enumerate(sums) if abs(k - best) > window]
        assert one.locations[0] == best
        assert one.scores[0] == pytest.approx(sums[best] - max(max(elsewhere), 0.0), rel=1e-5)


def test_the_score_of_a_global_descriptor_is_its_cosine():
    rows = Collected()
    proposals = propose_all(GlobalDescriptorMatching(Hog(), rows=rows), observed_images())
    for one in proposals[LAP_IMAGES:]:
        _, cosines = rows.rows["similarity"][one.query]
        assert one.scores == pytest.approx([cosines[location] for location in one.locations])
        assert one.scores[0] == pytest.approx(cosines.max())
        assert list(one.scores) == sorted(one.scores, reverse=True)


def test_baselines_report_the_rows_of_their_matrices_up_to_the_exclusion():
    for make in (PixelSequences, lambda rows: GlobalDescriptorMatching(Hog(), rows=rows)):
        rows = Collected()
        for one in propose_all(make(rows=rows), observed_images())[LAP_IMAGES + 10 :]:
            matches, values = rows.rows["similarity"][one.query]
            assert matches[-1] == one.query - MIN_AGE
            assert matches[values.argmax()] == one.query - LAP_IMAGES


def test_real_images_are_proposed_when_they_come_again_a_little_changed(test_data):
    images = kitti_images(test_data, "06", range(0, 50, 2))
    again = [changed(image, seed) for seed, image in enumerate(images)]
    for proposer in (PixelSequences(), GlobalDescriptorMatching(Hog())):
        proposals = propose_all(proposer, observed_images(images + again))[len(images) + 5 :]
        near = [bool(one.locations) and abs(one.query - len(images) - one.locations[0]) <= 1 for one in proposals]
        assert np.mean(near) > 0.8, type(proposer)
