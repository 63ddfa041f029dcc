"""A reference is mapped first; then its images alone are the past of every query, and nothing connects the two."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from place_images import LAP_IMAGES, CachingSurf, bonnet, changed, drive, two_laps

from place_recognition.image_processing.local_features import FeatureCache
from place_recognition.image_processing.static_regions import ImageMasks
from place_recognition.map.image_history import ImageHistory
from place_recognition.paradigms.registry import (
    PARADIGMS,
    ParadigmsConfig,
    make_control,
    make_feature_extractor,
    make_recognizer,
    with_preset,
)
from place_recognition.verification.present_view import CameraSteps, FixedPast

REFERENCE = two_laps()[:LAP_IMAGES]
QUERY = [changed(image, k) for k, image in enumerate(REFERENCE)]
CONFIG = ParadigmsConfig(reference=True)


def match(recognizer, query, reference=REFERENCE):
    """Beliefs about the images of a query, which count from 0, as those of the reference do."""
    for k, image in enumerate(reference):
        recognizer.observe(k, image, float("nan"))
    recognizer.end_reference()
    first = len(reference)
    beliefs = [one for k, image in enumerate(query) for one in recognizer.observe(first + k, image, float("nan"))]
    return [replace(one, query=one.query - first) for one in beliefs + recognizer.finish()]


def make(name, **settings):
    config = with_preset(name, replace(CONFIG, **settings))
    extractor = CachingSurf() if config.features == "surf" else make_feature_extractor(config)
    return make_recognizer(name, FeatureCache(extractor), config)


def recall(beliefs, truth=lambda query: query):
    """Share of the queries with an accepted match within two images of the true one."""
    right = [b.accepted and b.match is not None and abs(b.match - truth(b.query)) <= 2 for b in beliefs]
    return float(np.mean(right))


@pytest.mark.parametrize("name", PARADIGMS)
def test_every_query_is_answered_once_and_matched_with_the_reference(name):
    beliefs = match(make(name), QUERY)
    assert [b.query for b in beliefs] == list(range(LAP_IMAGES))
    assert recall(beliefs) > 0.8
    assert not any(b.accepted and abs(b.match - b.query) > 2 for b in beliefs)


@pytest.mark.parametrize("name", PARADIGMS)
def test_no_image_of_the_query_is_ever_proposed_although_it_comes_twice(name):
    for beliefs in (match(make(name), [*QUERY, *QUERY]), match(make(name, preset="published"), [*QUERY, *QUERY])):
        named = [image for b in beliefs for image in (*b.stages.candidates, b.match, b.stages.geometry_match)]
        assert max(image for image in named if image is not None) < LAP_IMAGES


@pytest.mark.parametrize("name", PARADIGMS)
def test_the_query_may_begin_where_the_reference_ends(name):
    """Nothing of its end is carried over: the answers are those of the same query behind a foreign stretch."""
    query = [changed(image, k) for k, image in enumerate(REFERENCE[LAP_IMAGES // 2 :])]
    beliefs = match(make(name), query, REFERENCE)
    assert recall(beliefs, lambda k: k + LAP_IMAGES // 2) > 0.6


def test_a_query_in_the_opposite_direction_is_matched():
    beliefs = match(make("hierarchical-places"), QUERY[::-1])
    assert recall(beliefs, lambda k: LAP_IMAGES - 1 - k) > 0.8


@pytest.mark.parametrize("name", ["global-descriptor", "hierarchical-places"])
def test_without_the_temporal_model_the_order_of_the_queries_does_not_matter(name):
    order = np.random.default_rng(3).permutation(LAP_IMAGES)
    sorted_, shuffled = (
        match(make(name, temporal=False), query) for query in (QUERY, [QUERY[k] for k in order.tolist()])
    )
    by_image = {int(order[b.query]): (b.match, b.score, b.stages.candidates) for b in shuffled}
    assert by_image == {b.query: (b.match, b.score, b.stages.candidates) for b in sorted_}
    assert recall(sorted_) > 0.8


def test_with_the_temporal_model_the_order_does_matter():
    """The control of the test before: shuffled queries are no drive along the reference."""
    order = np.random.default_rng(3).permutation(LAP_IMAGES)
    beliefs = match(make("global-descriptor"), [QUERY[k] for k in order.tolist()])
    assert recall(beliefs, lambda k: order[k]) < 0.5


def test_a_reference_that_comes_to_its_own_places_again_is_no_rival_of_itself():
    """The images of both passes show one place, as the reference was recognised while it was mapped."""
    twice = [*REFERENCE, *[changed(image, 100 + k) for k, image in enumerate(REFERENCE)]]
    beliefs = match(make("tracked-words"), QUERY, twice)
    right = [b.accepted and abs(b.match % LAP_IMAGES - b.query) <= 2 for b in beliefs]
    assert np.mean(right) > 0.7


def test_the_control_proposes_images_of_the_reference_alone():
    beliefs = match(make_control(FeatureCache(CachingSurf()), CONFIG), [*QUERY, *QUERY])
    proposed = np.array([image for b in beliefs for image in b.stages.candidates])
    assert proposed.max() < LAP_IMAGES
    assert len(np.unique(proposed)) == LAP_IMAGES


def test_the_first_image_of_a_query_is_a_step_of_its_own_and_joins_no_places():
    history = ImageHistory()
    steps = CameraSteps(history)
    features = CachingSurf().extract(REFERENCE[0])
    for k in range(3):  # a standing camera, before and after
        steps.add(history.add(k, features, float("nan")))
    assert len(steps) == 1
    steps.end_reference()
    assert steps.add(history.add(3, features, float("nan")))
    assert not steps.add(history.add(4, features, float("nan")))
    steps.recognize(1, 0)
    assert len(steps) == 2
    assert steps.places(np.array([3])).tolist() == [1]
    assert len(steps.junctions()) == 0


def test_a_fixed_past_does_not_move():
    assert [FixedPast(7).advance() for _ in range(3)] == [7, 7, 7]


def test_what_was_static_in_the_reference_is_not_in_the_query():
    masks, images = ImageMasks(), drive(60)
    for k, image in enumerate(images):
        found = masks.observe(bonnet(image, k))
    assert found.static_ratio > 0.1
    masks.end_reference()
    assert masks.observe(images[0]).static_ratio == 0.0


def test_two_walks_on_either_side_of_a_real_path(test_data):
    """Gardens Point by day: image i of one walk shows the place of image i of the other."""
    walks = [
        [
            cv2.imread(str(test_data / "real_revisits" / "gardens_point" / walk / f"Image{k:03d}.jpg"), 0)
            for k in range(50)
        ]
        for walk in ("day_left", "day_right")
    ]
    accepted = [b for b in match(make("tracked-words"), walks[1], walks[0]) if b.accepted]
    assert len(accepted) > 25
    assert all(abs(b.match - b.query) <= 5 for b in accepted)
