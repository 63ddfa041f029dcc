"""The naive baselines and their parts: dense maps, lines in a matrix, and the exclusion of recent images."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from place_images import changed, kitti_images, sliding_view, textured_world

from place_recognition.image_processing.global_descriptors import Hog
from place_recognition.map.descriptor_database import DescriptorDatabase, absolute_differences, dot_products
from place_recognition.map.exclusion_window import ExclusionWindow, ExclusionWindowConfig
from place_recognition.paradigms.global_descriptor import GlobalDescriptorMatching
from place_recognition.paradigms.pixel_sequences import PixelSequences, best_lines, local_contrast

DISTANCE_M = float("nan")


class Collected:
    """Keeps the rows of each stage (a MatrixSink)."""

    def __init__(self):
        self.rows = {"similarity": {}, "filtered": {}}

    def add(self, query, matches, values, stage="similarity"):
        self.rows[stage][query] = (np.array(matches), np.array(values))


def drive(recognizer, images):
    return [b for i, image in enumerate(images) for b in recognizer.observe(i, image, DISTANCE_M)]


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
def test_a_lap_driven_at_another_speed_is_recognised_by_its_sequence(speed):
    world = textured_world(2200, seed=8)
    first = sliding_view(world, list(range(0, 1800, 20)))
    starts = np.arange(400, 1500, round(20 * speed))
    beliefs = drive(PixelSequences(), first + sliding_view(world, list(starts)))[len(first) + 10 :]
    right = [
        abs(20 * b.match - start) <= 20 for b, start in zip(beliefs, starts[10:], strict=True) if b.match is not None
    ]
    assert np.mean(right) > 0.9


def test_a_sequence_has_a_higher_score_than_a_few_images():
    lap = sliding_view(textured_world(1600, seed=8), list(range(0, 1240, 31)))
    beliefs = drive(PixelSequences(), lap + lap)[40:]
    assert np.mean([b.score for b in beliefs[10:]]) > 2 * beliefs[2].score
    assert all(b.inliers is None and b.verified for b in beliefs)


def test_baselines_report_the_rows_of_their_matrices_up_to_the_exclusion():
    lap = sliding_view(textured_world(1600, seed=8), list(range(0, 1240, 31)))
    for make in (PixelSequences, lambda rows: GlobalDescriptorMatching(Hog(), rows=rows)):
        rows = Collected()
        beliefs = drive(make(rows=rows), lap + lap)
        for belief in beliefs[50:]:
            matches, values = rows.rows["similarity"][belief.query]
            assert matches[-1] <= belief.query - 10
            assert matches[values.argmax()] == belief.query - 40


def test_real_images_are_recognised_when_they_come_again_a_little_changed(test_data):
    images = kitti_images(test_data, "06", range(0, 50, 2))
    again = [changed(image, seed) for seed, image in enumerate(images)]
    for recognizer in (PixelSequences(), GlobalDescriptorMatching(Hog())):
        beliefs = drive(recognizer, images + again)[len(images) + 5 :]
        near = [b.match is not None and abs(b.query - len(images) - b.match) <= 1 for b in beliefs]
        assert np.mean(near) > 0.8, type(recognizer)


def test_the_present_ends_where_the_view_has_changed_and_waits_where_it_has_not():
    views = sliding_view(textured_world(1600, seed=8), list(range(0, 1240, 31)))
    present = ExclusionWindow(ExclusionWindowConfig(min_gap_frames=3))
    past = []
    for k, image in enumerate(views[:15] + 30 * [views[15]] + views[16:]):
        present.add(k, image, DISTANCE_M)
        past.append(present.count_matchable())
    assert past[14] > 5
    assert len(set(past[20:45])) == 1
    assert past[-1] > 50


def test_the_present_reaches_as_far_back_as_the_distance_demands():
    present = ExclusionWindow(ExclusionWindowConfig(min_gap_frames=3, min_distance_m=20.0))
    for k, image in enumerate(sliding_view(textured_world(1600, seed=8), list(range(0, 1240, 31)))):
        present.add(k, image, 0.5 * k)
    assert present.count_matchable() == 0  # 39 images, but 19.5 m


def test_a_blank_image_does_not_end_the_present():
    views = sliding_view(textured_world(1600, seed=8), list(range(0, 1240, 31)))
    present = ExclusionWindow(ExclusionWindowConfig(min_gap_frames=3))
    for k, image in enumerate(20 * [views[0]] + 5 * [np.zeros_like(views[0])] + 5 * [views[0]]):
        present.add(k, image, DISTANCE_M)
        assert present.count_matchable() == 0
