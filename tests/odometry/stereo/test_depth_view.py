"""Disparities are read from a depth image between its pixels, and not where it has holes or edges."""

import numpy as np
import pytest

from odometry.camera import StereoCamera
from odometry.stereo.depth_view import DepthView, DepthViewConfig

CAMERA = StereoCamera(525.0, 525.0, 319.5, 239.5, 0.075, 640, 480)
PIXELS = np.random.default_rng(1).uniform([10, 10], [629, 469], (300, 2))


def plane(normal, distance):
    """Depth image of the plane normal @ X = distance, and the disparity at pixels."""
    n = np.asarray(normal, dtype=float)
    u, v = np.meshgrid(np.arange(640), np.arange(480))

    def disparity(column, row):
        rays = n[0] * (column - CAMERA.cx) / CAMERA.fx + n[1] * (row - CAMERA.cy) / CAMERA.fy + n[2]
        return CAMERA.fx * CAMERA.baseline * rays / distance

    depth = CAMERA.fx * CAMERA.baseline / disparity(u, v)
    return depth.astype(np.float32), disparity(*PIXELS.T)


def test_a_slanted_plane_is_read_exactly_between_the_pixels():
    depth, expected = plane([0.5, -0.3, 0.8], 2.0)
    read = DepthView(CAMERA).read(depth, PIXELS)
    np.testing.assert_allclose(read, expected, atol=1e-4)
    nearest = CAMERA.fx * CAMERA.baseline / depth[tuple(np.rint(PIXELS[:, ::-1]).astype(int).T)]
    assert np.abs(nearest - expected).max() > 0.01  # control


def test_the_noise_of_a_window_is_averaged():
    depth, expected = plane([0.0, 0.0, 1.0], 2.0)
    noisy = CAMERA.fx * CAMERA.baseline / depth + np.random.default_rng(0).normal(0, 0.3, depth.shape)
    read = DepthView(CAMERA).read((CAMERA.fx * CAMERA.baseline / noisy).astype(np.float32), PIXELS)
    assert 0.03 < (read - expected).std() < 0.09  # 0.3 over the root of 25 pixels


@pytest.mark.parametrize("hole", [np.nan, 0.0, np.inf, -1.0])
def test_holes_have_no_disparity_and_small_ones_do_no_harm(hole):
    depth, expected = plane([0.0, 0.2, 1.0], 2.0)
    rng = np.random.default_rng(0)
    depth[rng.random(depth.shape) < 0.05] = hole
    depth[100:200, 100:200] = hole
    read = DepthView(CAMERA).read(depth, PIXELS)
    inside = np.all((PIXELS > 103) & (PIXELS < 196), axis=1)
    outside = np.any((PIXELS < 97) | (PIXELS > 202), axis=1)
    assert inside.sum() > 5
    assert np.isnan(read[inside]).all()
    np.testing.assert_allclose(read[outside], expected[outside], atol=1e-4)


def test_edges_have_no_disparity():
    depth, _ = plane([0.0, 0.0, 1.0], 1.5)
    depth[:, 320:] = 2.5
    at = np.stack([np.full(50, 320.0) + np.linspace(-1.9, 0.9, 50), np.linspace(50, 400, 50)], axis=1)
    assert np.isnan(DepthView(CAMERA).read(depth, at)).all()
    assert np.isfinite(DepthView(CAMERA).read(depth, at + np.array([5.0, 0.0]))).all()
    tolerant = DepthView(CAMERA, DepthViewConfig(max_residual_px=100.0)).read(depth, at)
    between = CAMERA.fx * CAMERA.baseline / tolerant
    assert ((between > 1.55) & (between < 2.45)).any()  # control: depths at which nothing is


def test_pixels_outside_the_image_have_no_disparity():
    depth, _ = plane([0.0, 0.0, 1.0], 2.0)
    pixels = np.array([[-50.0, 10.0], [700.0, 10.0], [10.0, 1e9], [np.nan, 10.0], [np.inf, 3.0]])
    assert np.isnan(DepthView(CAMERA).read(depth, pixels)).all()
    assert len(DepthView(CAMERA).read(depth, np.zeros((0, 2)))) == 0


def test_the_place_in_the_right_image_is_the_pixel_less_its_disparity():
    depth, expected = plane([0.0, 0.1, 1.0], 2.0)
    depth[:240] = np.nan
    places = DepthView(CAMERA).find((np.zeros((480, 640), np.uint8), depth), PIXELS)
    below = PIXELS[:, 1] > 245
    np.testing.assert_allclose(PIXELS[below, 0] - places[below, 0], expected[below], atol=1e-4)
    np.testing.assert_array_equal(places[below, 1], PIXELS[below, 1])
    assert np.isnan(places[PIXELS[:, 1] < 235]).all()
