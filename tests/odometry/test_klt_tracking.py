"""Corners spread, tracks follow, and what cannot be followed is said to be lost."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.ndimage import shift as shifted

from odometry.klt_tracking import (
    TrackingConfig,
    detect_corners,
    is_inside,
    level_pair,
    match_brightness,
    track_points,
)

CONFIG = TrackingConfig(max_corners=200)
NONE = np.zeros((0, 2))


def texture(seed=0, shape=(240, 400)):
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal(shape), 2.0)
    return np.clip(128 + 40 * noise / noise.std(), 0, 255)


def as_image(values):
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def test_corners_keep_their_number_and_their_distance():
    corners = detect_corners(as_image(texture()), NONE, CONFIG)
    apart = np.linalg.norm(corners[:, None] - corners[None], axis=2) + 1e9 * np.eye(len(corners))
    assert 150 <= len(corners) <= CONFIG.max_corners
    assert apart.min() >= CONFIG.min_spacing_px / 2


def test_corners_spread_over_the_image_though_one_half_is_stronger():
    values = texture()
    values[:, :200] = 128 + (values[:, :200] - 128) / 3
    corners = detect_corners(as_image(values), NONE, CONFIG)
    assert 0.35 < np.mean(corners[:, 0] < 200) < 0.65


def test_topping_up_only_fills_what_is_missing():
    image = as_image(texture())
    tracked = detect_corners(image, NONE, CONFIG)[:120]
    new = detect_corners(image, tracked, CONFIG)
    apart = np.linalg.norm(new[:, None] - tracked[None], axis=2)
    assert 0 < len(new) <= CONFIG.max_corners - 120
    assert apart.min() >= CONFIG.min_spacing_px / 2


def test_blank_images_have_no_corners():
    for value in (0, 128, 255):
        assert len(detect_corners(np.full((240, 400), value, np.uint8), NONE, CONFIG)) == 0


def test_a_shifted_image_is_followed_without_bias():
    values, move = texture(), np.array([6.37, -2.81])
    first, second = as_image(values), as_image(shifted(values, move[::-1], order=5, mode="nearest"))
    pixels = detect_corners(first, NONE, CONFIG)
    pixels = pixels[is_inside(pixels, first, 20.0)]
    moved = track_points((first, second), pixels, pixels, CONFIG) - pixels
    kept = np.isfinite(moved[:, 0])
    assert kept.mean() > 0.95
    np.testing.assert_allclose(moved[kept].mean(axis=0), move, atol=0.01)
    np.testing.assert_allclose(np.median(np.abs(moved[kept] - move)), 0, atol=0.03)


def test_nothing_is_followed_into_another_picture():
    first, second = as_image(texture(0)), as_image(texture(1))
    pixels = detect_corners(first, NONE, CONFIG)
    assert np.isfinite(track_points((first, second), pixels, pixels, CONFIG)[:, 0]).mean() < 0.25


def test_following_nothing_gives_nothing():
    image = as_image(texture())
    assert track_points((image, image), NONE, NONE, CONFIG).shape == (0, 2)


def test_a_wide_search_follows_what_moved_too_far_for_the_usual_one():
    coarse = gaussian_filter(np.random.default_rng(5).standard_normal((240, 400)), 12.0)
    values, move = 0.5 * texture() + 64 + 30 * coarse / coarse.std(), np.array([42.0, 0.0])
    first, second = as_image(values), as_image(shifted(values, move[::-1], order=1, mode="nearest"))
    pixels = detect_corners(first, NONE, CONFIG)
    pixels = pixels[is_inside(pixels, first, 60.0)]

    def found(config):
        moved = track_points((first, second), pixels, pixels, config) - pixels
        return np.mean(np.linalg.norm(moved - move, axis=1) < 0.2)

    assert found(CONFIG.widen()) > found(CONFIG) + 0.3


def test_a_good_guess_replaces_reach():
    values, move = texture(), np.array([42.0, 0.0])
    first, second = as_image(values), as_image(shifted(values, move[::-1], order=1, mode="nearest"))
    pixels = detect_corners(first, NONE, CONFIG)
    pixels = pixels[is_inside(pixels, first, 60.0)]
    moved = track_points((first, second), pixels, pixels + move + 0.7, CONFIG) - pixels
    assert np.mean(np.linalg.norm(moved - move, axis=1) < 0.2) > 0.9


def test_pixels_at_the_margin_are_inside_and_those_beyond_are_not():
    image = np.zeros((100, 200), np.uint8)
    corners = np.array([[4.0, 4.0], [195.0, 95.0], [3.9, 50.0], [100.0, 95.1]])
    assert is_inside(corners, image).tolist() == [True, True, False, False]


def test_an_even_image_has_its_brightness_matched_without_amplifying_noise():
    dark, bright = np.full((20, 20), 10, np.uint8), as_image(texture(shape=(20, 20)))
    matched = match_brightness(bright, dark)
    assert matched.std() == 0
    assert abs(float(matched.mean()) - float(bright.mean())) < 1


def test_a_pair_as_good_as_equally_bright_is_left_as_it_is():
    left = as_image(texture(7))
    right = cv2.convertScaleAbs(left, alpha=0.95, beta=4)
    assert level_pair(left, right) is right


@pytest.mark.parametrize(("gain", "offset"), [(0.6, 0), (1.0, 25), (0.6, 25), (0.5, 60)])
def test_another_exposure_is_taken_back(gain, offset):
    left = cv2.convertScaleAbs(as_image(texture(7)), alpha=0.7, beta=20)  # no pixel becomes black or white
    right = cv2.convertScaleAbs(left, alpha=gain, beta=offset)
    levelled = level_pair(left, right)
    assert np.abs(levelled.astype(int) - left).max() <= 2


@pytest.mark.parametrize("value", [0, 128])
def test_a_covered_camera_is_not_made_bright(value):
    blank = np.full((60, 80), value, np.uint8)
    assert level_pair(as_image(texture(7))[:60, :80], blank) is blank
