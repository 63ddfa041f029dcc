"""Masks of a recording: features keep off them and stay as many, and a resumed run makes the same ones."""

import numpy as np
import pytest
from place_images import DRIVE_SHAPE, bonnet, drive, textured_world

from place_recognition.image_processing.extractors import EXTRACTORS, make_extractor
from place_recognition.image_processing.static_regions import ImageMasks, MaskedExtractor, StaticRegionConfig, intersect

OFF = StaticRegionConfig(enabled=False)


@pytest.mark.parametrize("name", EXTRACTORS)
def test_features_keep_off_the_mask_and_are_as_many_as_before(name: str):
    image, extractor = textured_world(DRIVE_SHAPE[1], 3), make_extractor(name, 50)
    mask = np.full(image.shape, 255, np.uint8)
    mask[:, 100:300] = 0
    features, free = extractor.extract(image, mask), extractor.extract(image)
    columns = np.rint(features.pixels[:, 0])
    assert ((free.pixels[:, 0] > 105) & (free.pixels[:, 0] < 295)).any()
    assert ((columns < 101) | (columns > 298)).all()
    assert len(free) == 50
    assert len(features) >= 45  # OpenCV's SIFT drops the masked ones after choosing twice as many as are wanted


def test_a_bonnet_is_left_out_once_it_is_known():
    masks = ImageMasks()
    extractor = MaskedExtractor(make_extractor("surf", 200), masks)
    features = [extractor.extract(bonnet(image, k)) for k, image in enumerate(drive(30))]
    assert (features[0].pixels[:, 1] > 180).sum() > 20
    assert (features[-1].pixels[:, 1] < 180).all()
    assert len(features[-1]) == 200
    assert 0.1 < masks.mean_static_ratio < 0.3


def test_without_the_detector_and_a_mask_nothing_is_left_out():
    masks = ImageMasks(OFF)
    assert all(masks.observe(bonnet(image, k)).pixels is None for k, image in enumerate(drive(30)))
    assert masks.mean_static_ratio == 0.0


def test_what_the_user_leaves_out_is_left_out_from_the_first_image_on():
    mask = np.full(DRIVE_SHAPE, 255, np.uint8)
    mask[:, :50] = 0
    masks = ImageMasks(fixed=mask)
    images = [bonnet(image, k) for k, image in enumerate(drive(30))]
    first, *_, last = [masks.observe(image) for image in images]
    assert np.array_equal(first.pixels, mask)
    assert first.static_ratio == 0.0  # the share that was found, not the user's
    assert not last.pixels[:, :50].any()
    assert not last.pixels[190:].any()
    assert last.pixels[:150, 60:].all()


def test_a_run_that_is_resumed_makes_the_same_masks_whatever_was_read_ahead():
    images = [bonnet(image, k) for k, image in enumerate(drive(40))]
    undisturbed = ImageMasks()
    expected = [undisturbed.observe(image) for image in images]
    ahead = ImageMasks()
    seen = [ahead.observe(image) for image in images[:20]]
    ahead.confirm(seen[14])  # the run stops after this image, with five more read
    resumed = ImageMasks()
    resumed.restore(ahead.state())
    found = [resumed.observe(image) for image in images[15:]]
    for one, other in zip(found, expected[15:], strict=True):
        assert intersect(one.pixels, None) is one.pixels
        assert np.array_equal(one.pixels, other.pixels)
        assert one.static_ratio == other.static_ratio
    undisturbed.confirm(expected[-1])
    resumed.confirm(found[-1])
    assert resumed.mean_static_ratio == undisturbed.mean_static_ratio > 0
