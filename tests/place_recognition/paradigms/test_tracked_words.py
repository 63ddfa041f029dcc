"""The bag of tracked words on real drives."""

import numpy as np
import pytest
from place_images import changed, kitti_images, sliding_view, textured_world

from place_recognition.image_processing.local_features import FeatureCache
from place_recognition.image_processing.surf import Surf
from place_recognition.paradigms.tracked_words import TrackedWords


class Rows(dict):
    """The rows of the matrix, by query."""

    def add(self, query, matches, values, stage="similarity"):
        self[query] = (matches, values)


def beliefs_of(images, distances_m=None):
    rows = Rows()
    recognizer = TrackedWords(FeatureCache(Surf()), rows=rows)
    distances_m = np.full(len(images), np.nan) if distances_m is None else distances_m
    beliefs = [b for i, image in enumerate(images) for b in recognizer.observe(i, image, float(distances_m[i]))]
    return rows, beliefs + recognizer.finish()


@pytest.fixture(scope="module")
def drives(test_data):
    """Two drives one after the other, and their frames in between as another, changed pass."""
    frames = [kitti_images(test_data, "07", range(80)), kitti_images(test_data, "05", range(60))]
    first = [image for images in frames for image in images[::2]]
    second = [changed(image, seed) for images in frames for seed, image in enumerate(images[1::2])]
    return first, second


@pytest.fixture(scope="module")
def revisit(drives):
    """The matrix of both passes and the beliefs about them."""
    return beliefs_of(drives[0] + drives[1])


def test_a_second_pass_through_a_changed_camera_is_recognised(drives, revisit):
    first, beliefs = drives[0], revisit[1]
    offsets = np.array([b.query - len(first) - b.match if b.accepted else 99 for b in beliefs[len(first) :]])
    assert np.mean(np.abs(offsets) <= 2) > 0.95


def test_new_places_are_not_recognised(drives, revisit):
    assert not any(b.accepted for b in revisit[1][: len(drives[0])])


def test_a_revisit_in_the_opposite_direction_is_recognised(test_data):
    frames = kitti_images(test_data, "05", range(60))
    order = [*range(0, 60, 2), *range(59, 0, -2)]
    _, beliefs = beliefs_of([frames[k] for k in order], distances_m=np.arange(60.0))
    accepted = [b for b in beliefs if b.accepted]
    assert len(accepted) > 10
    assert all(abs(order[b.query] - order[b.match]) <= 5 for b in accepted)


def test_a_match_keeps_the_smallest_distance_from_its_query():
    images = sliding_view(textured_world(700, seed=3), list(range(0, 360, 9)))
    distance_m = 0.5 * np.arange(80)
    _, beliefs = beliefs_of(images + images, distance_m)
    matched = [b for b in beliefs if b.match is not None]
    assert matched
    assert all(distance_m[b.query] - distance_m[b.match] >= 20 for b in matched)


def test_the_votes_of_an_image_go_to_the_place_it_matches(drives, revisit):
    rows, beliefs = revisit
    query = len(drives[0]) + 20
    ids, votes = rows[query]
    assert votes.min() > 0
    assert abs(ids[votes.argmax()] - beliefs[query].match) <= 6
