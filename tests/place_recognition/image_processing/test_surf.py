"""SURF finds blobs where they are, and finds them again."""

import cv2
import numpy as np
import pytest
from place_images import changed, gaussian_blob, kitti_images, textured_world

from place_recognition.image_processing.extractors import make_extractor
from place_recognition.image_processing.matching import mutual_matches
from place_recognition.image_processing.surf import Surf, layer_sizes
from place_recognition.image_processing.surf_descriptor_kernels import (
    cell_weights,
    describe_oriented,
    describe_upright,
    orientation,
)
from place_recognition.image_processing.surf_detector_kernels import deinterleave, determinant_row, find_blobs, fit_peak

TURN = np.array([[0.98, -0.05, 9.0], [0.04, 1.02, -6.0], [2e-5, 1e-5, 1.0]])


def correct_matches(name, image, homography):
    """Matches between an image and its warped self that land within three pixels of where they should."""
    extract = make_extractor(name).extract
    seen = cv2.warpPerspective(image, homography, image.shape[::-1], borderMode=cv2.BORDER_REFLECT)
    first, second = extract(image), extract(seen)
    pairs = mutual_matches(first.descriptors, second.descriptors)
    expected = cv2.perspectiveTransform(first.pixels[None], homography)[0]
    return np.sum(np.linalg.norm(expected[pairs[:, 0]] - second.pixels[pairs[:, 1]], axis=1) < 3)


def box(image, top, bottom, left, right):
    return int(image[top:bottom, left:right].sum(dtype=np.int64))


def determinants(image, size, step=1):
    """Those of all rows, step pixels apart."""
    planes = deinterleave(cv2.integral(image), step)
    out = np.ones((-(-image.shape[0] // step), planes.shape[2] - 1), np.float32)
    work = np.empty((4, out.shape[1]), np.int32)
    for y, row in enumerate(out):
        determinant_row(planes, y * step, size, work, row)
    return out


def test_determinants_equal_those_of_directly_summed_boxes():
    image = textured_world(60, seed=1, height=50)
    out = determinants(image, 15)
    for y, x in [(7, 7), (20, 31), (42, 52)]:
        xx = box(image, y - 4, y + 5, x - 7, x + 8) - 3 * box(image, y - 4, y + 5, x - 2, x + 3)
        yy = box(image, y - 7, y + 8, x - 4, x + 5) - 3 * box(image, y - 2, y + 3, x - 4, x + 5)
        xy = box(image, y - 5, y, x - 5, x) + box(image, y + 1, y + 6, x + 1, x + 6)
        xy -= box(image, y - 5, y, x + 1, x + 6) + box(image, y + 1, y + 6, x - 5, x)
        assert out[y, x] == pytest.approx((xx * yy - (0.912 * xy) ** 2) / 15**4, rel=1e-4, abs=1e-3)


def test_determinants_are_zero_where_the_filter_leaves_the_image():
    out = determinants(textured_world(41, seed=1, height=40), 9)
    assert out[4:-4, 4:-4].all()
    out[4:-4, 4:-4] = 0
    assert not out.any()


@pytest.mark.parametrize("step", [2, 4])
@pytest.mark.parametrize("width", [80, 81, 82, 83])
def test_determinants_further_apart_are_some_of_all(step, width):
    image = textured_world(width, seed=1, height=70)
    out, everywhere = determinants(image, 15, step), determinants(image, 15)[::step, ::step]
    np.testing.assert_array_equal(out[:, :-4], everywhere[:, : out.shape[1] - 4])


def test_blobs_are_where_a_plain_search_over_all_layers_finds_them():
    image, sizes = textured_world(160, seed=9, height=120), layer_sizes(0)
    layers = np.stack([determinants(image, size) for size in sizes])
    expected = set()
    for level, y, x in np.argwhere(layers > 10):
        cube = layers[level - 1 : level + 2, y - 1 : y + 2, x - 1 : x + 2]
        if level in (1, 2) and layers[level, y, x] == cube.max() and np.sum(cube == cube.max()) == 1:
            offset = np.array(fit_peak(cube.astype(float)))
            if np.abs(offset).max() <= 1:
                expected.add(tuple(np.round(offset + np.array([x, y, level]), 2)))
    found = find_blobs(deinterleave(cv2.integral(image), 1), sizes, 10.0)
    assert len(expected) > 50
    assert {tuple(row) for row in np.round(found[:, :3].astype(float), 2)} == expected


def test_the_top_of_a_parabola_is_found_and_a_plane_has_none():
    curvature = np.array([[-5.0, 1, 0.5], [1, -4, -1], [0.5, -1, -3]])  # of x, y and level
    top = np.array([0.3, -0.2, 0.4])
    steps = np.stack(np.meshgrid(*3 * [[-1, 0, 1]], indexing="ij"), axis=-1)[..., ::-1] - top
    cube = 100 + 0.5 * np.einsum("...i,ij,...j", steps, curvature, steps)
    np.testing.assert_allclose(fit_peak(cube), top)
    assert fit_peak(np.full((3, 3, 3), 7.0)) == (0, 0, 0)


@pytest.mark.parametrize("sigma", [2.3, 3.0, 3.6, 5.0])
def test_a_gaussian_blob_is_found_where_it_is(sigma):
    features = Surf().extract(gaussian_blob(sigma, center=(70.3, 59.8)))
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


def test_layers_of_the_octaves_are_those_of_the_paper():
    assert [list(layer_sizes(octave)) for octave in range(3)] == [[9, 15, 21, 27], [15, 27, 39, 51], [27, 51, 75, 99]]


def test_matches_of_a_synthetic_image_under_a_homography_are_as_many_as_with_sift():
    world = textured_world(640, seed=7, height=360)
    assert correct_matches("surf", world, TURN) > 0.9 * correct_matches("sift", world, TURN)


def test_matches_of_real_images_under_a_homography_are_as_many_as_with_sift(test_data):
    images = kitti_images(test_data, "05", range(0, 60, 25)) + kitti_images(test_data, "06", range(0, 50, 25))
    surf, sift = (sum(correct_matches(name, image, TURN) for image in images) for name in ("surf", "sift"))
    assert surf >= sift


def test_blobs_of_a_real_image_are_found_again_in_a_changed_one(test_data):
    image = kitti_images(test_data, "05", range(1))[0]
    first, second = Surf().extract(image), Surf().extract(changed(image, seed=0))
    expected = first.pixels * 1.01 + [-6, 3]
    nearest = np.linalg.norm(expected[:, None] - second.pixels[None], axis=2).min(axis=1)
    assert np.mean(nearest < 2) > 0.7


def turned(image, degrees, scale=1.0):
    """A homography that turns an image about its middle."""
    height, width = image.shape
    return np.vstack([cv2.getRotationMatrix2D((width / 2, height / 2), degrees, scale), [0, 0, 1]])


@pytest.mark.parametrize(("degrees", "scale"), [(30, 1.0), (90, 1.0), (180, 1.0), (30, 1.2)])
def test_oriented_features_survive_a_turn_that_upright_ones_do_not(test_data, degrees, scale):
    image = np.ascontiguousarray(kitti_images(test_data, "05", range(1))[0][:, 400:770])
    homography = turned(image, degrees, scale)
    oriented = correct_matches("surf-oriented", image, homography)
    assert oriented > 50
    assert oriented > 5 * correct_matches("surf", image, homography)


@pytest.mark.parametrize("degrees", [0, 33, 90, 135, -120])
def test_the_orientation_of_a_ramp_is_the_direction_in_which_it_rises(degrees):
    y, x = np.mgrid[-64:64, -64:64]
    angle = np.deg2rad(degrees)
    ramp = np.round(128 + np.cos(angle) * x + np.sin(angle) * y).astype(np.uint8)
    found = orientation(cv2.integral(ramp), np.array([64, 64, 2.5], np.float32))
    assert np.rad2deg(np.angle(np.exp(1j * (found - angle)))) == pytest.approx(0, abs=2)


def test_upright_and_oriented_descriptors_agree_where_the_orientation_is_upright():
    half = textured_world(128, seed=2, height=64) // 16 + np.arange(128, dtype=np.uint8)
    image = np.vstack([half, half[::-1]])  # what is the same above and below points along its middle
    integral, points = cv2.integral(image), np.array([[50, 63.5, 2.0], [70, 63.5, 2.0]], np.float32)
    assert np.abs([orientation(integral, point) for point in points]).max() < 1e-6
    upright, oriented = (
        describe(integral, points, cell_weights()) for describe in (describe_upright, describe_oriented)
    )
    assert np.sum(upright * oriented, axis=1).min() > 0.95
