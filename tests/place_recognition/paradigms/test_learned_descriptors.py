"""Learned descriptors among the stages: their score in any light, and what geometry says where it finds nothing."""

import cv2
import numpy as np
import pytest
from place_images import textured_world

from place_recognition.belief.likelihood_ratios import LEARNED_SCORE, LEARNED_WEIGHTS, RatioWeights, log_ratios
from place_recognition.image_processing.global_descriptors import make_global_descriptor
from place_recognition.image_processing.local_features import FeatureCache, LocalFeatures
from place_recognition.image_processing.onnx_network import convert_channels
from place_recognition.image_processing.surf import Surf
from place_recognition.paradigms.registry import ParadigmsConfig, make_recognizer
from place_recognition.paradigms.whole_images import GlobalDescriptorMatching, cosines, distinctness
from place_recognition.recognizer import ObservedImage, takes_color

SMALL_CNN = ParadigmsConfig(descriptor="small-cnn")


def usual(count=60, seed=0):
    return np.random.default_rng(seed).normal(0.2, 0.05, count)


def test_a_similarity_is_as_distinct_in_light_in_which_all_are_smaller():
    similarities = usual()
    similarities[30] = 0.7
    assert distinctness(similarities)[30] > 7
    np.testing.assert_allclose(distinctness(0.6 * similarities - 0.1), distinctness(similarities), rtol=1e-9)


def test_similarities_of_one_kind_are_not_distinct():
    assert max(distinctness(usual(seed=seed)).max() for seed in range(20)) < 4.5


def test_images_around_the_most_similar_one_do_not_make_it_usual():
    similarities = usual()
    similarities[22:39], similarities[30] = 0.69, 0.7
    assert distinctness(similarities)[30] > 7


def test_a_second_pass_of_the_place_leaves_it_distinct():
    similarities = usual(200)
    similarities[[30, 130]] = 0.7
    assert distinctness(similarities)[[30, 130]].min() > 5


def test_few_images_tell_nothing():
    for count in (0, 1, 12, 30):
        scores = distinctness(usual(count))
        assert scores.shape == (count,)
        np.testing.assert_array_equal(LEARNED_SCORE(scores), 0)
    assert not (LEARNED_SCORE(distinctness(usual(60))) == 0).all()


def test_even_images_are_not_distinct():
    assert np.isfinite(distinctness(np.zeros(60))).all()
    assert distinctness(np.zeros(60)).max() == 0


def test_where_geometry_finds_nothing_a_distinct_image_remains_likely_and_another_one_does_not():
    own, nothing = LEARNED_SCORE([5.5, 2.5]), np.zeros(2)
    distinct, usual_one = log_ratios(own, nothing, LEARNED_WEIGHTS)
    assert distinct > 0.5
    assert usual_one < -0.5
    assert (log_ratios(own, nothing) < -0.2).all()  # as for other paradigms: no agreement is evidence against a place


def test_geometry_that_agrees_counts_as_for_all():
    own, evidence = np.zeros(1), np.array([60.0])
    np.testing.assert_array_equal(log_ratios(own, evidence, LEARNED_WEIGHTS), log_ratios(own, evidence))
    assert LEARNED_WEIGHTS.geometry == RatioWeights().geometry


class Recording:
    """A descriptor that keeps the images it is shown."""

    kind = "recording"

    def __init__(self, takes_color):
        self.takes_color, self.seen = takes_color, []

    def describe(self, image):
        self.seen.append(image)
        return np.ones(4, np.float32)


@pytest.mark.parametrize("wants_color", [True, False])
def test_colour_reaches_the_descriptor_that_sees_it_and_grey_any_other(wants_color):
    descriptor = Recording(wants_color)
    proposer = GlobalDescriptorMatching(descriptor, score=cosines)
    nothing = LocalFeatures(*(np.empty(shape, np.float32) for shape in ((0, 2), 0, 0, (0, 8))))
    gray, color = np.zeros((4, 5), np.uint8), np.ones((4, 5, 3), np.uint8)
    proposer.observe(ObservedImage(0, gray, nothing, 0.0, -1, color))
    proposer.observe(ObservedImage(1, gray, nothing, 0.0, -1))
    assert descriptor.seen[0] is (color if wants_color else gray)
    assert descriptor.seen[1] is gray


def test_local_features_of_an_image_in_colour_are_those_of_its_grey():
    color = np.dstack([textured_world(320, seed=2), textured_world(320, seed=3), textured_world(320, seed=4)])
    extractor = Surf()

    class Keeping:
        kind = extractor.kind
        images: list[np.ndarray] = []  # noqa: RUF012

        def extract(self, image, mask=None):
            self.images.append(image)
            return extractor.extract(image, mask)

    recognizer = make_recognizer("global-descriptor", FeatureCache(Keeping()), SMALL_CNN)
    assert takes_color(recognizer)
    recognizer.observe(0, color, float("nan"))
    np.testing.assert_array_equal(Keeping.images[0], cv2.cvtColor(color, cv2.COLOR_RGB2GRAY))
    assert not takes_color(make_recognizer("global-descriptor", FeatureCache(extractor)))
    assert not takes_color(make_recognizer("tracked-words", FeatureCache(extractor)))


def test_most_images_of_a_path_are_most_like_the_same_place_seen_from_its_other_side(test_data):
    folder, rows = test_data / "real_revisits" / "gardens_point", {}
    left, right = (
        [cv2.imread(str(file))[:, :, ::-1] for file in sorted((folder / side).glob("*.jpg"))[:120:step]]
        for side, step in (("day_left", 1), ("day_right", 3))
    )
    for name in ("small-cnn", "hog"):
        descriptor = make_global_descriptor(name)
        channels = 3 if descriptor.takes_color else 1
        first, second = (
            np.array([descriptor.describe(convert_channels(np.ascontiguousarray(image), channels)) for image in images])
            for images in (left, right)
        )
        rows[name] = (np.abs((second @ first.T).argmax(axis=1) - 3 * np.arange(len(second))) <= 3).mean()
    assert rows["small-cnn"] >= 0.9
    assert rows["hog"] < 0.7
