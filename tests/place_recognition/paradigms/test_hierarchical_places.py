"""Hierarchical places on real drives."""

import numpy as np
import pytest
from place_images import CachingSurf, changed, kitti_images, sliding_view, textured_world

from place_recognition.image_processing.local_features import FeatureCache
from place_recognition.paradigms.hierarchical_places import HierarchicalPlaces, HierarchicalPlacesConfig
from place_recognition.vocabulary.word_index import ExactWordIndex


class Rows(dict):
    """The rows of the matrix, by query."""

    def add(self, query, matches, values, stage="similarity"):
        self[query] = (matches, values)


SURF = CachingSurf()


class CountingIndex(ExactWordIndex):
    """Remembers how many words there were at each question."""

    def __init__(self):
        super().__init__()
        self.sizes = []

    def nearest(self, query):
        self.sizes.append(len(self))
        return super().nearest(query)


def drive(images, config=None, index=ExactWordIndex):
    """The recogniser, the rows and the beliefs of a drive along which no way is measured."""
    rows = Rows()
    recognizer = HierarchicalPlaces(FeatureCache(SURF), config, rows, index)
    beliefs = [b for i, image in enumerate(images) for b in recognizer.observe(i, image, float("nan"))]
    return recognizer, rows, beliefs + recognizer.finish()


@pytest.fixture(scope="module")
def passes(test_data):
    """Two drives one after the other, and their frames in between as another, changed pass."""
    frames = [kitti_images(test_data, "07", range(60)), kitti_images(test_data, "05", range(44))]
    first = [image for images in frames for image in images[::2]]
    second = [changed(image, seed) for images in frames for seed, image in enumerate(images[1::2])]
    return first, second


@pytest.fixture(scope="module")
def revisit(passes):
    return drive(passes[0] + passes[1])


def offsets(beliefs, first):
    """How far each accepted match of the second pass is off, images; 99 where none was accepted."""
    return np.array([abs(b.query - first - b.match) if b.accepted else 99 for b in beliefs[first:]])


def test_a_second_pass_through_a_changed_camera_is_recognised(passes, revisit):
    assert np.mean(offsets(revisit[2], len(passes[0])) <= 2) > 0.95


def test_new_places_are_not_recognised(passes, revisit):
    assert not any(b.accepted for b in revisit[2][: len(passes[0])])


def test_the_published_values_recognise_the_second_pass_too(passes):
    beliefs = drive(passes[0] + passes[1], HierarchicalPlacesConfig.published())[2]
    assert not any(b.accepted for b in beliefs[: len(passes[0])])
    off = offsets(beliefs, len(passes[0]))
    assert np.mean(off <= 2) > 0.5
    assert not np.any((off > 5) & (off < 99))


def test_all_images_belong_to_places_once_the_drive_has_ended(passes, revisit):
    places = revisit[0]._places
    located = [location for place in range(len(places)) for location in places.images(place)]
    assert located == list(range(len(passes[0]) + len(passes[1])))
    assert revisit[0].word_count == places.count_words_of_first(len(places)) > 10 * len(places)


def test_the_votes_of_an_image_go_to_the_place_that_holds_its_match(passes, revisit):
    _, rows, beliefs = revisit
    query = len(passes[0]) + 20
    ids, votes = rows[query]
    assert votes.min() > 0
    assert beliefs[query].match in ids[votes == votes.max()]


def test_words_are_searched_only_when_their_place_is_outside_the_exclusion(passes):
    indices = []
    recognizer, _, _ = drive(passes[0], index=lambda: indices.append(CountingIndex()) or indices[-1])
    sizes = indices[0].sizes
    assert sizes == sorted(sizes)
    assert 0 < sizes[-1] < recognizer.word_count


def test_an_image_with_hardly_any_features_gets_no_match(passes, revisit):
    first, second = passes
    images = [*first, *second[:20], np.full_like(first[0], 90), *second[21:]]
    beliefs = drive(images)[2]
    blank = beliefs[len(first) + 20]
    assert (blank.match, blank.score, blank.accepted) == (None, 0, False)
    assert np.mean(offsets(beliefs, len(first)) <= 2) > 0.9


def test_another_seed_grows_other_words_and_finds_the_same_places(passes, revisit):
    recognizer, _, beliefs = drive(passes[0] + passes[1], HierarchicalPlacesConfig(seed=1))
    words = [r._places.nearest_words(np.eye(64, dtype=np.float32)) for r in (recognizer, revisit[0])]
    assert not np.array_equal(*words)
    assert np.mean(offsets(beliefs, len(passes[0])) <= 2) > 0.95


def test_a_loop_of_few_images_is_closed():
    lap = sliding_view(textured_world(1000, seed=3), list(range(0, 640, 32)))
    beliefs = drive(lap + lap + lap)[2]
    accepted = [b for b in beliefs if b.accepted]
    assert len(accepted) > 20
    assert all((b.query - b.match) % len(lap) in (0, 1, len(lap) - 1) for b in accepted)
