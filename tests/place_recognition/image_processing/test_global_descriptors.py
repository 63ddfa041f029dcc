"""Whole images become vectors that mean what they should."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from place_images import kitti_images, textured_world

from place_recognition.image_processing.global_descriptors import (
    DEVIATION,
    GLOBAL_DESCRIPTORS,
    MIDDLE,
    ColorHistogram,
    ColorHistogramConfig,
    Hog,
    HogConfig,
    Thumbnail,
    ThumbnailConfig,
    cell_histograms,
    make_global_descriptor,
    make_thumbnail,
    mean_absolute_difference,
)

WORLD = textured_world(640, seed=1, height=320)


def cosine(first, second):
    return first @ second / np.linalg.norm(first) / np.linalg.norm(second)


def ramp(degrees, size=64):
    """An image that rises in a direction by one grey level a pixel."""
    y, x = np.mgrid[:size, :size]
    return (128 + x * np.cos(np.deg2rad(degrees)) + y * np.sin(np.deg2rad(degrees))).astype(np.float32)


@pytest.fixture(params=GLOBAL_DESCRIPTORS)
def descriptor(request):
    return make_global_descriptor(request.param)


@pytest.mark.parametrize("shape", [(376, 1241), (64, 64), (3, 5), (1, 1)])
def test_images_of_all_sizes_become_vectors_of_one(descriptor, shape):
    vector = descriptor.describe(np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8))
    assert vector.dtype == np.float32
    assert vector.shape == descriptor.describe(WORLD).shape
    assert np.isfinite(vector).all()


def test_the_same_image_is_described_the_same_and_left_as_it_is(descriptor):
    image = WORLD.copy()
    np.testing.assert_array_equal(descriptor.describe(image), descriptor.describe(image))
    np.testing.assert_array_equal(image, WORLD)


@pytest.mark.parametrize("name", ["hog", "thumbnail"])
def test_even_images_are_zeros_and_brightness_and_contrast_hardly_matter(name):
    descriptor = make_global_descriptor(name)
    assert not descriptor.describe(np.full((100, 200), 77, np.uint8)).any()
    assert cosine(descriptor.describe(WORLD), descriptor.describe(WORLD // 2 + 60)) > 0.97


def test_the_next_image_of_a_real_drive_is_more_alike_than_one_of_another(test_data):
    first, second = kitti_images(test_data, "05", range(2))
    other = kitti_images(test_data, "06", range(1))[0]
    for name in GLOBAL_DESCRIPTORS:
        here, next_, there = (make_global_descriptor(name).describe(image) for image in (first, second, other))
        assert cosine(here, next_) > cosine(here, there), name


def test_patches_of_a_thumbnail_have_the_same_brightness_and_contrast():
    config = ThumbnailConfig()
    thumbnail = make_thumbnail(WORLD, config)
    assert thumbnail.shape == (32, 64)
    patches = thumbnail.reshape(4, 8, 8, 8).astype(float)
    np.testing.assert_allclose(patches.mean(axis=(1, 3)), MIDDLE, atol=1)
    np.testing.assert_allclose(patches.std(axis=(1, 3)), DEVIATION, atol=2)


def test_noise_on_a_wall_is_not_blown_up():
    noise = np.random.default_rng(0).normal(100, 1, (32, 64)).round().astype(np.uint8)
    assert np.abs(Thumbnail().describe(noise)).mean() < DEVIATION / 2


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_mean_absolute_difference_is_a_distance(seed):
    a, b, c = np.random.default_rng(seed).integers(0, 256, (3, 6, 7)).astype(np.uint8)
    assert mean_absolute_difference(a, a) == 0
    assert mean_absolute_difference(a, b) == mean_absolute_difference(b, a) == np.abs(a - b.astype(float)).mean()
    assert mean_absolute_difference(a, c) <= mean_absolute_difference(a, b) + mean_absolute_difference(b, c) + 1e-9


def test_thumbnails_of_two_sizes_are_not_compared():
    with pytest.raises(ValueError, match=r"expected images of one size, got \(2, 3\) and \(3, 2\)"):
        mean_absolute_difference(np.zeros((2, 3), np.uint8), np.zeros((3, 2), np.uint8))


def test_a_histogram_holds_the_share_of_each_colour():
    image = np.zeros((4, 4, 3), np.uint8)
    image[:1] = 255, 0, 128
    shares = ColorHistogram(ColorHistogramConfig(bins=4)).describe(image).reshape(4, 4, 4)
    assert shares[0, 0, 0] == 0.75
    assert shares[3, 0, 2] == 0.25
    assert shares.sum() == 1


def test_a_grey_histogram_agrees_with_numpy_and_does_not_see_where_things_are():
    shares = ColorHistogram().describe(WORLD)
    np.testing.assert_allclose(shares, np.histogram(WORLD, 64, (0, 256))[0] / WORLD.size, rtol=1e-6)
    np.testing.assert_array_equal(shares, ColorHistogram().describe(WORLD[::-1, ::-1]))


@pytest.mark.parametrize("image", [np.zeros((3, 3, 4), np.uint8), np.zeros((3, 3)), np.zeros((0, 3), np.uint8)])
def test_a_histogram_refuses_what_is_no_image(image):
    with pytest.raises(ValueError, match=r"expected an image \(H, W\) or \(H, W, 3\) uint8, got \("):
        ColorHistogram().describe(image)


@pytest.mark.parametrize("degrees", [10, 50, 90, 130, 170])
def test_gradients_fall_into_the_bin_of_their_direction(degrees):
    cells = cell_histograms(ramp(degrees), 16, 9)
    assert cells.shape == (4, 4, 9)
    inner = cells[1:3, 1:3]
    assert (inner.argmax(axis=2) == degrees // 20).all()
    np.testing.assert_allclose(inner[..., degrees // 20], 2 * 16 * 16, rtol=1e-3)  # [-1, 0, 1] spans two pixels


def test_a_gradient_between_two_bins_is_shared_and_the_opposite_one_the_same():
    shared = cell_histograms(ramp(60), 16, 9)[1, 1]
    np.testing.assert_allclose(shared[2:4], 256, rtol=1e-3)
    np.testing.assert_allclose(cell_histograms(ramp(240), 16, 9)[1, 1], shared, atol=0.1)


def test_histograms_of_cells_agree_with_a_plain_loop():
    image = textured_world(48, seed=3, height=32).astype(np.float32)
    expected = np.zeros((2, 3, 9))
    for y in range(32):
        for x in range(48):
            dx = image[y, x + 1] - image[y, x - 1] if 0 < x < 47 else 0
            dy = image[y + 1, x] - image[y - 1, x] if 0 < y < 31 else 0
            place = np.rad2deg(np.arctan2(dy, dx)) % 180 / 20 - 0.5
            low = int(np.floor(place))
            for k, share in ((low, low + 1 - place), (low + 1, place - low)):
                expected[y // 16, x // 16, k % 9] += share * np.hypot(dx, dy)
    np.testing.assert_allclose(cell_histograms(image, 16, 9), expected, rtol=1e-3, atol=0.5)


def test_blocks_have_unit_length_and_no_gradient_outweighs_all_others():
    blocks = Hog(HogConfig(cell=16)).describe(WORLD).reshape(3, 7, 36)
    np.testing.assert_allclose(np.linalg.norm(blocks, axis=2), 1, rtol=1e-5)
    assert blocks.max() < 0.5


@pytest.mark.parametrize("make", [lambda: HogConfig(cell=24), lambda: HogConfig(cell=64)])
def test_cells_must_fill_the_image(make):
    with pytest.raises(ValueError, match="expected an image of whole cells, two or more each way, got 128 x 64"):
        make()


def test_patches_must_fill_the_thumbnail():
    with pytest.raises(ValueError, match="expected a thumbnail of whole patches, got 60 x 32 in patches of 8"):
        ThumbnailConfig(width=60)


def test_a_name_that_no_descriptor_has_is_refused_with_those_that_there_are():
    with pytest.raises(
        ValueError, match=r"unknown global descriptor 'gist': expected one of hog, thumbnail, .*onnx:FILE"
    ):
        make_global_descriptor("gist")


@pytest.mark.parametrize("name", ["hog", "thumbnail"])
def test_images_in_colour_are_refused_but_by_the_histogram_of_colours(name):
    with pytest.raises(ValueError, match="expected a grey image"):
        make_global_descriptor(name).describe(np.zeros((8, 9, 3), np.uint8))
