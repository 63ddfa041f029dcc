"""SURF finds blobs where they are, and finds them again."""

import cv2
import numpy as np
import pytest
from place_images import changed, kitti_images, textured_world

from place_recognition.belief.matching import mutual_matches
from place_recognition.image_processing import surf_kernels as kernels
from place_recognition.image_processing.features import LocalFeatures
from place_recognition.image_processing.surf import Surf, SurfConfig, layer_sizes

TURN = np.array([[0.98, -0.05, 9.0], [0.04, 1.02, -6.0], [2e-5, 1e-5, 1.0]])


def gaussian_blob(sigma, centre=(70.0, 60.0), shape=(128, 144)):
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.round(200 * np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (2 * sigma**2))).astype(np.uint8)


def sift(image):
    points, descriptors = cv2.SIFT_create(500).detectAndCompute(image, None)
    pixels = np.array([p.pt for p in points], np.float32)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    return LocalFeatures(pixels, pixels[:, 0], pixels[:, 0], descriptors)


def correct_matches(extract, image, homography):
    """Matches between an image and its warped self that land within three pixels of where they should."""
    seen = cv2.warpPerspective(image, homography, image.shape[::-1], borderMode=cv2.BORDER_REFLECT)
    first, second = extract(image), extract(seen)
    pairs = mutual_matches(first.descriptors, second.descriptors)
    expected = cv2.perspectiveTransform(first.pixels[None], homography)[0]
    return np.sum(np.linalg.norm(expected[pairs[:, 0]] - second.pixels[pairs[:, 1]], axis=1) < 3)


def box(image, top, bottom, left, right):
    return int(image[top:bottom, left:right].sum(dtype=np.int64))


def test_determinants_equal_those_of_directly_summed_boxes():
    image = textured_world(60, seed=1, height=50)
    out = np.empty(image.shape, np.float32)
    kernels.hessian_determinants(cv2.integral(image), 15, out)
    for y, x in [(7, 7), (20, 31), (42, 52)]:
        xx = box(image, y - 4, y + 5, x - 7, x + 8) - 3 * box(image, y - 4, y + 5, x - 2, x + 3)
        yy = box(image, y - 7, y + 8, x - 4, x + 5) - 3 * box(image, y - 2, y + 3, x - 4, x + 5)
        xy = box(image, y - 5, y, x - 5, x) + box(image, y + 1, y + 6, x + 1, x + 6)
        xy -= box(image, y - 5, y, x + 1, x + 6) + box(image, y + 1, y + 6, x - 5, x)
        assert out[y, x] == pytest.approx((xx * yy - (0.912 * xy) ** 2) / 15**4, rel=1e-4, abs=1e-3)


def test_determinants_are_zero_where_the_filter_leaves_the_image():
    out = np.ones((40, 41), np.float32)
    kernels.hessian_determinants(cv2.integral(textured_world(41, seed=1, height=40)), 9, out)
    assert out[4:-4, 4:-4].all()
    out[4:-4, 4:-4] = 0
    assert not out.any()


@pytest.mark.parametrize("sigma", [2.3, 3.0, 3.6, 5.0])
def test_a_gaussian_blob_is_found_where_it_is(sigma):
    features = Surf().extract(gaussian_blob(sigma, centre=(70.3, 59.8)))
    assert np.abs(features.pixels[0] - [70.3, 59.8]).max() < 0.1


def test_the_scale_of_a_blob_grows_in_proportion_to_its_size():
    sizes = np.array([2.3, 2.6, 3.0, 3.6, 4.2, 5.0, 6.0])
    ratios = [Surf().extract(gaussian_blob(sigma)).scales[0] for sigma in sizes] / sizes
    np.testing.assert_allclose(ratios, ratios.mean(), rtol=0.06)  # boxes are no Gaussians: the ratio is not quite 1
    assert 0.65 < ratios.mean() < 1.1


def test_descriptors_have_unit_length_and_sixty_four_numbers():
    features = Surf().extract(textured_world(300, seed=2))
    assert features.descriptors.shape == (len(features), 64)
    np.testing.assert_allclose(np.linalg.norm(features.descriptors, axis=1), 1, rtol=1e-5)


def test_descriptors_do_not_change_with_contrast_and_brightness():
    image = textured_world(300, seed=3) // 2
    first, second = Surf().extract(image), Surf().extract((1 + 2 * image.astype(int)).clip(0, 255).astype(np.uint8))
    pairs = mutual_matches(first.descriptors, second.descriptors)
    distances = np.linalg.norm(first.descriptors[pairs[:, 0]] - second.descriptors[pairs[:, 1]], axis=1)
    assert len(pairs) > 0.9 * len(first)
    assert np.median(distances) < 1e-3


def test_features_come_strongest_first_and_no_more_than_asked_for():
    features = Surf(SurfConfig(features=100)).extract(textured_world(400, seed=4))
    assert 80 <= len(features) <= 100
    assert np.all(np.diff(features.responses) <= 0)


def test_a_corner_full_of_strong_blobs_leaves_features_to_the_rest():
    image = textured_world(640, seed=5) // 4 + 90
    image[:80, :80] = textured_world(80, seed=6, height=80)
    inside = (Surf(SurfConfig(features=200)).extract(image).pixels < 80).all(axis=1)
    assert inside.sum() < 60


@pytest.mark.parametrize("shape", [(376, 1241), (20, 24), (3, 500), (1, 1)])
def test_blank_and_tiny_images_have_no_features(shape):
    features = Surf().extract(np.full(shape, 77, np.uint8))
    assert len(features) == 0
    assert features.descriptors.shape == (0, 64)


def test_an_image_in_colour_is_refused():
    with pytest.raises(ValueError, match=r"grey image \(H, W\) uint8, got \(8, 9, 3\)"):
        Surf().extract(np.zeros((8, 9, 3), np.uint8))


def test_layers_of_the_octaves_overlap_as_in_the_paper():
    assert layer_sizes(3) == [9, 15, 21, 27, 39, 51, 75, 99]


def test_matches_of_a_synthetic_image_under_a_homography_are_as_many_as_with_sift():
    world = textured_world(640, seed=7, height=360)
    assert correct_matches(Surf().extract, world, TURN) > 0.9 * correct_matches(sift, world, TURN)


def test_matches_of_real_images_under_a_homography_are_as_many_as_with_sift(test_data):
    for image in kitti_images(test_data, "05", range(0, 60, 25)) + kitti_images(test_data, "06", range(0, 50, 25)):
        assert correct_matches(Surf().extract, image, TURN) > 0.9 * correct_matches(sift, image, TURN)


def test_blobs_of_a_real_image_are_found_again_in_a_changed_one(test_data):
    image = kitti_images(test_data, "05", range(1))[0]
    first, second = Surf().extract(image), Surf().extract(changed(image, seed=0))
    expected = first.pixels * 1.01 + [-6, 3]
    nearest = np.linalg.norm(expected[:, None] - second.pixels[None], axis=2).min(axis=1)
    assert np.mean(nearest < 2) > 0.7
