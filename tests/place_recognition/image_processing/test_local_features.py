"""All local features keep one contract, and are spread over the image."""

from hashlib import sha256

import cv2
import numpy as np
import pytest
from place_images import gaussian_blob, textured_world

from place_recognition.image_processing.extractors import (
    BRIEF_PATTERN,
    EXTRACTORS,
    Brief,
    BriefConfig,
    make_extractor,
    unpack_bits,
)
from place_recognition.image_processing.local_features import SpreadConfig, select_strongest
from place_recognition.image_processing.surf import Surf, SurfConfig


@pytest.mark.parametrize("name", EXTRACTORS)
def test_features_of_all_kinds_come_strongest_first_of_unit_length_and_no_more_than_asked_for(name):
    features = make_extractor(name, 100).extract(textured_world(400, seed=4))
    assert 80 <= len(features) <= 100
    assert np.all(np.diff(features.responses) <= 0)
    assert features.descriptors.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(features.descriptors, axis=1), 1, rtol=1e-5)
    assert (features.scales > 0.5).all()


@pytest.mark.parametrize("name", EXTRACTORS)
@pytest.mark.parametrize("shape", [(376, 1241), (32, 33), (20, 24), (3, 500), (1, 1)])
def test_blank_and_tiny_images_have_no_features(name, shape):
    features = make_extractor(name).extract(np.full(shape, 77, np.uint8))
    assert len(features) == len(features.pixels) == 0
    assert features.descriptors.shape == (0, make_extractor(name).extract(textured_world(300, 1)).descriptors.shape[1])


@pytest.mark.parametrize("name", EXTRACTORS)
def test_features_of_all_kinds_are_the_same_each_time(name):
    first, second = (make_extractor(name).extract(textured_world(300, seed=3)) for _ in range(2))
    np.testing.assert_array_equal(first.descriptors, second.descriptors)
    np.testing.assert_array_equal(first.pixels, second.pixels)


@pytest.mark.parametrize("name", EXTRACTORS)
def test_images_in_colour_are_refused_by_all_extractors(name):
    with pytest.raises(ValueError, match=r"grey image \(H, W\) uint8, got \(8, 9, 3\)"):
        make_extractor(name).extract(np.zeros((8, 9, 3), np.uint8))


@pytest.mark.parametrize("name", ["surf", "sift"])
def test_features_keep_to_the_middle_of_a_blob_as_it_grows(name):
    for sigma in (4.0, 6.0):
        features = make_extractor(name).extract(gaussian_blob(sigma, center=(70.3, 59.8)))
        assert np.abs(features.pixels[0] - [70.3, 59.8]).max() < 0.12


def test_a_name_that_no_extractor_has_is_refused_with_those_that_there_are():
    with pytest.raises(ValueError, match="unknown local features 'brisk': expected one of surf, surf-oriented, sift"):
        make_extractor("brisk")


def test_brief_takes_the_strongest_corners_of_fast_and_compares_brightness_at_fixed_places():
    image = textured_world(400, seed=4)
    features = Brief(BriefConfig(50)).extract(image)
    corners = cv2.FastFeatureDetector.create(10).detect(image)
    inside = [p for p in corners if 16 <= p.pt[0] < 400 - 16 and 16 <= p.pt[1] < 240 - 16]
    strongest = sorted((p.response for p in inside), reverse=True)[:50]
    np.testing.assert_array_equal(features.responses, strongest)
    smooth = cv2.GaussianBlur(image, (9, 9), 2)
    for (x, y), descriptor in zip(features.pixels.astype(int)[:5], features.descriptors, strict=False):
        expected = [smooth[y + b, x + a] < smooth[y + d, x + c] for (a, b), (c, d) in BRIEF_PATTERN]
        assert ((descriptor > 0) == expected).all()


def test_the_pattern_of_brief_never_changes():
    # The words that ship are made of it.
    assert BRIEF_PATTERN.shape == (256, 2, 2)
    assert np.abs(BRIEF_PATTERN).max() == 15
    assert sha256(BRIEF_PATTERN.astype(np.int8).tobytes()).hexdigest()[:16] == "576e2933c0609a55"


def test_orb_descriptors_are_as_far_apart_as_their_bits_differ():
    features = make_extractor("orb").extract(textured_world(400, seed=4))
    packed = np.packbits(features.descriptors > 0, axis=1)
    np.testing.assert_array_equal(unpack_bits(packed), features.descriptors)
    differing = cv2.norm(packed[0], packed[1], cv2.NORM_HAMMING)
    assert np.linalg.norm(features.descriptors[0] - features.descriptors[1]) == pytest.approx(np.sqrt(differing) / 8)


def test_a_corner_full_of_strong_blobs_leaves_features_to_the_rest():
    image = textured_world(640, seed=5) // 4 + 90
    image[:80, :80] = textured_world(80, seed=6, height=80)
    inside = (Surf(SurfConfig(max_features=200)).extract(image).pixels < 80).all(axis=1)
    assert inside.sum() < 60


def test_the_strongest_are_taken_where_no_square_is_crowded():
    pixels = np.stack([np.arange(40) % 8 * 80 + 40, np.arange(40) // 8 * 80 + 40], axis=1)
    responses = np.random.default_rng(0).permutation(40).astype(np.float32)
    chosen = select_strongest(pixels, responses, (400, 640), 10, SpreadConfig())
    np.testing.assert_array_equal(chosen, np.argsort(-responses)[:10])


def test_a_crowded_square_fills_up_only_where_the_others_do_not():
    crowd, rest = np.full((50, 2), 10), np.array([[100, 10], [200, 10], [300, 10]])
    responses = np.arange(53, 0, -1).astype(np.float32)
    chosen = select_strongest(np.vstack([crowd, rest]), responses, (80, 400), 10, SpreadConfig(80, 2.0))
    np.testing.assert_array_equal(chosen, [0, 1, 2, 3, 4, 5, 6, 50, 51, 52])
