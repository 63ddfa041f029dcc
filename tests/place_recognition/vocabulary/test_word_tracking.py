"""Tracks follow what is seen, and words are the means of what was seen."""

import numpy as np
from place_images import sliding_view, textured_world

from place_recognition.growing_array import GrowingArray
from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.image_processing.surf import Surf
from place_recognition.vocabulary.word_tracking import (
    FeatureTracks,
    GuidedTrackingConfig,
    TrackConfig,
    WordMap,
    Words,
    count_spans,
    optical_flow,
    select_guided,
)
from place_recognition.vocabulary.word_tree import ExactWordIndex

GUIDED = GuidedTrackingConfig()


def features_at(pixels, descriptors):
    pixels = np.array(pixels, np.float32).reshape(-1, 2)
    ones = np.ones(len(pixels), np.float32)
    return LocalFeatures(pixels, ones, ones, np.array(descriptors, np.float32))


def words_ending(last):
    last = np.array(last)
    return Words(np.ones((len(last), 2), np.float32), np.maximum(last - 4, 0), last)


def test_flow_finds_a_known_shift():
    first, second = sliding_view(textured_world(400, seed=1), [20, 13])
    pixels = Surf().extract(first).pixels[:50]
    moved = optical_flow(first, second, pixels, GUIDED)
    assert np.nanmax(np.abs(moved - pixels - [7, 0])) < 0.3
    assert np.isnan(moved[:, 0]).mean() < 0.2


def test_flow_between_images_of_different_sizes_loses_all_points():
    pixels = np.array([[30, 30]], np.float32)
    assert np.isnan(optical_flow(np.zeros((60, 60), np.uint8), np.zeros((60, 61), np.uint8), pixels, GUIDED)).all()


def test_a_feature_continues_a_track_only_if_it_is_near_in_pixels_and_in_looks():
    features = features_at([[0, 4.9], [20, 5.1], [40, 0]], [[1, 0], [1, 0], [0.8, 0.6]])
    positions = np.array([[0, 0], [20, 0], [40, 0]], np.float32)
    descriptors = np.array([[1, 0], [1, 0], [1, 0]], np.float32)
    np.testing.assert_array_equal(select_guided(positions, descriptors, features, GUIDED), [0, -1, -1])


def test_no_feature_continues_two_tracks():
    features = features_at([[1, 0], [3, 0]], [[1, 0], [1, 0]])
    chosen = select_guided(np.zeros((2, 2), np.float32), np.float32([[1, 0], [1, 0]]), features, GUIDED)
    np.testing.assert_array_equal(chosen, [0, 1])


def test_a_lost_track_is_continued_by_nothing():
    features = features_at([[1, 0]], [[1, 0]])
    lost = np.full((1, 2), np.nan, np.float32)
    np.testing.assert_array_equal(select_guided(lost, np.float32([[1, 0]]), features, GUIDED), [-1])


def test_a_word_is_the_mean_of_its_tracks_descriptors_and_spans_its_images():
    image = textured_world(200, seed=2, height=200)
    looks = np.array([[1.0, 0.0], [0.96, 0.28], [0.8, 0.6]], np.float32)
    tracks = FeatureTracks(TrackConfig(min_length_frames=3))
    for look in looks:
        assert len(tracks.advance(image, features_at([[100, 100]], [look]))) == 0
    words = tracks.advance(image, features_at([], np.empty((0, 2))))
    np.testing.assert_allclose(words.descriptors, [looks.mean(axis=0)], rtol=1e-6)
    assert (words.first.tolist(), words.last.tolist()) == ([0], [2])


def test_a_track_that_is_too_short_leaves_no_word():
    image = textured_world(200, seed=2, height=200)
    tracks = FeatureTracks(TrackConfig(min_length_frames=3))
    lasting = [[40, 40], [150, 40]]
    tracks.advance(image, features_at(lasting, np.eye(3)[:2]))
    for _ in range(2):
        tracks.advance(image, features_at([*lasting, [100, 150]], np.eye(3)))
    tracks.advance(image, features_at(lasting, np.eye(3)[:2]))
    assert len(tracks.advance(image, features_at([], np.empty((0, 3))))) == 2


def test_where_nothing_stays_long_two_images_make_a_word():
    image = textured_world(200, seed=2, height=200)
    tracks = FeatureTracks(TrackConfig(min_length_frames=3))
    for _ in range(2):
        tracks.advance(image, features_at([[100, 100]], [[1, 0]]))
    assert len(tracks.advance(image, features_at([], np.empty((0, 2))))) == 1


def test_ended_tracks_make_room_for_the_strongest_unused_features():
    image = textured_world(200, seed=2, height=200)
    tracks = FeatureTracks(TrackConfig(max_points=2))
    tracks.advance(image, features_at([[50, 50], [100, 100]], [[1, 0], [0, 1]]))
    tracks.advance(image, features_at([[150, 150], [100, 100], [20, 20]], [[1, 0], [0, 1], [1, 0]]))
    np.testing.assert_array_equal(tracks.descriptors, [[0, 1], [1, 0]])


def test_one_track_that_never_ends_does_not_count_as_the_longest():
    image = textured_world(200, seed=3, height=200)
    rng, tracks = np.random.default_rng(0), FeatureTracks(TrackConfig())
    for _ in range(12):
        passing = rng.uniform(0, 90, (40, 2))
        tracks.advance(image, features_at([[150, 150], *passing], np.eye(41)))
    assert tracks.max_length_frames < 12


def test_words_are_found_once_the_horizon_has_passed_them():
    words = WordMap(ExactWordIndex())
    words.add(words_ending([4, 4]))
    words.add(words_ending([6]))
    assert (len(words), words.active_count) == (3, 0)
    assert len(words.lookup(np.ones((1, 2), np.float32))) == 0
    past = []
    for location in (3, 4, 5, 6, 5):
        words.activate_until(location)
        past.append(words.active_count)
    assert past == [0, 2, 2, 3, 3]
    np.testing.assert_array_equal(words.spans(np.array([2, 0])), [[2, 6], [0, 4]])


def test_each_descriptor_hits_the_word_nearest_to_it():
    words = WordMap(ExactWordIndex())
    words.add(Words(np.eye(3, dtype=np.float32), np.zeros(3, np.int64), np.full(3, 2)))
    words.activate_until(2)
    np.testing.assert_array_equal(words.lookup(np.float32([[0, 0, 1], [0.1, 0, 1], [1, 0, 0]])), [2, 2, 0])


def test_the_words_that_cover_a_location_are_counted_as_they_come():
    rng, words = np.random.default_rng(2), WordMap(ExactWordIndex())
    last = np.sort(rng.integers(0, 200, 60))
    spans = [(rng.integers(max(end - 30, 0), end + 1, 5), np.full(5, end)) for end in last]
    for first, end in spans:
        words.add(Words(np.ones((5, 2), np.float32), first, end))
    words.activate_until(150)
    first, end = (np.concatenate([span[k] for span in spans if span[1][0] <= 150]) for k in (0, 1))
    covered = [int(np.sum((first <= location) & (location <= end))) for location in range(end.max() + 1)]
    np.testing.assert_array_equal(words.words_at(np.arange(end.max() + 1)), covered)


def test_locations_know_how_many_spans_cover_them():
    counts = count_spans(np.array([0, 1, 3]), np.array([1, 1, 4]), 6)
    np.testing.assert_array_equal(counts, [1, 2, 0, 1, 1, 0])


def test_a_growing_array_holds_all_rows_in_order():
    rng, parts = np.random.default_rng(1), []
    array = GrowingArray(np.float32)
    for count in rng.integers(0, 30, 40):
        parts.append(rng.normal(size=(count, 3)).astype(np.float32))
        array.extend(parts[-1])
    np.testing.assert_array_equal(array.rows, np.concatenate(parts))


def test_words_that_forgotten_images_alone_have_shown_do_not_enter_the_map():
    words, rng = WordMap(ExactWordIndex()), np.random.default_rng(5)
    first, last = np.array([0, 2, 2, 4]), np.array([1, 3, 5, 5])
    for k in range(4):
        words.add(Words(rng.normal(size=(1, 3)).astype(np.float32), first[k : k + 1], last[k : k + 1]))
    for location in (2, 3, 4):
        words.forget(location)
    words.activate_until(5)
    np.testing.assert_array_equal(words.spans(np.arange(words.active_count)), [[0, 1], [2, 5], [4, 5]])
    np.testing.assert_array_equal(words.is_forgotten(np.arange(6)), [False, False, True, True, True, False])
    restored = WordMap(ExactWordIndex())
    restored.restore(words.state())
    np.testing.assert_array_equal(restored.is_forgotten(np.arange(6)), words.is_forgotten(np.arange(6)))
