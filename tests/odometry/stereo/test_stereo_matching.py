"""Disparities are right, without bias, or NaN."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from odometry.klt_tracking import TrackingConfig, detect_corners
from odometry.stereo.stereo_matching import match_disparity, match_right

SHAPE = (240, 480)


def render(disparity, rows=0.0, seed=0):
    """Left and right image of a surface with disparity(u, v), the right one lowered by rows."""
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal((SHAPE[0], SHAPE[1] + 200)), 1.5)
    values = 128 + 40 * noise / noise.std()
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    # The texture belongs to the right image; the left one looks it up where its own match is.
    right = map_coordinates(values, [v - rows, u + 150], order=5)
    left = map_coordinates(values, [v, u + 150 - disparity(u, v)], order=5)
    return tuple(np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in (left, right))


def errors(disparity, rows=0.0):
    left, right = render(disparity, rows)
    pixels = detect_corners(left, np.zeros((0, 2)), TrackingConfig(max_corners=400))
    pixels = pixels[pixels[:, 0] > 90]
    return match_disparity(left, right, pixels) - disparity(pixels[:, 0], pixels[:, 1])


@pytest.mark.parametrize("shift", [0.0, 0.25, 0.5, 3.77, 17.4, 61.6])
def test_constant_disparities_have_no_bias_between_pixels(shift):
    error = errors(lambda u, v: shift + 0.0 * u)
    assert np.isfinite(error).mean() > 0.8
    assert abs(np.nanmean(error)) < 0.01
    assert np.nanmedian(np.abs(error)) < 0.05


def test_a_slanted_surface_has_no_bias():
    error = errors(lambda u, v: 5.0 + 0.06 * v)
    assert np.isfinite(error).mean() > 0.8
    assert abs(np.nanmedian(error)) < 0.02


def test_rows_that_differ_by_a_pixel_do_not_disturb():
    error = errors(lambda u, v: 9.3 + 0.0 * u, rows=1.2)
    assert np.isfinite(error).mean() > 0.75
    assert abs(np.nanmean(error)) < 0.015


def test_the_row_of_the_match_is_found_too():
    left, right = render(lambda u, v: 9.3 + 0.0 * u, rows=0.8)
    pixels = detect_corners(left, np.zeros((0, 2)), TrackingConfig())
    assert np.nanmedian((match_right(left, right, pixels) - pixels)[:, 1]) == pytest.approx(0.8, abs=0.03)


def test_what_the_right_image_does_not_show_is_nan():
    left, _ = render(lambda u, v: 10.0 + 0.0 * u)
    _, other = render(lambda u, v: 10.0 + 0.0 * u, seed=5)
    pixels = detect_corners(left, np.zeros((0, 2)), TrackingConfig())
    assert np.isfinite(match_disparity(left, other, pixels)).mean() < 0.03
    assert np.isnan(match_disparity(left, np.zeros_like(left), pixels)).all()


def test_repeating_patterns_are_not_matched():
    bars = np.tile((np.arange(SHAPE[1]) % 16 < 8) * np.uint8(200), (SHAPE[0], 1))
    assert np.isnan(match_disparity(bars, bars, np.array([[200.0, 100.0], [300.0, 120.0]]))).all()


def test_pixels_outside_or_at_the_edge_are_nan_and_none_give_none():
    left, right = render(lambda u, v: 10.0 + 0.0 * u)
    assert np.isnan(
        match_disparity(left, right, np.array([[-5.0, 10.0], [1e6, 10.0], [0.0, 0.0], [479.0, 239.0]]))
    ).all()
    assert match_disparity(left, right, np.zeros((0, 2))).shape == (0,)
