"""The distortion that is left: corrected, learned and forgotten at the rates of its configuration."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from odometry.camera import StereoCamera
from odometry.distortion import LensDistortion, LensDistortionConfig, undistort
from odometry.stereo.stereo_self_calibration import Calibration, CalibrationConfig

CAMERA = StereoCamera(fx=700.0, fy=700.0, cx=600.0, cy=180.0, baseline=0.5, width=1241, height=376)
CONFIG = LensDistortionConfig()


@given(st.floats(-20, 20), st.floats(0.0, 0.8), st.floats(0.0, 6.3))
def test_radial_distortion_moves_pixels_along_the_radius_by_its_cube(radial, radius, angle):
    direction = np.array([np.cos(angle), np.sin(angle)])
    pixel = np.array([CAMERA.cx, CAMERA.cy]) + 700.0 * radius * direction
    moved = undistort(CAMERA, np.array([radial, 0.0, 0.0]), pixel[None])[0] - pixel
    np.testing.assert_allclose(moved, radial * radius**3 * direction, atol=1e-9)


@given(st.integers(0, 10_000))
def test_distortion_is_linear_in_its_coefficients(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 3))
    pixels = rng.uniform([0, 0], [1241, 376], (20, 2))
    together = undistort(CAMERA, a + b, pixels) - pixels
    apart = undistort(CAMERA, a, pixels) + undistort(CAMERA, b, pixels) - 2 * pixels
    np.testing.assert_allclose(together, apart, atol=1e-9)


def test_pixels_at_or_behind_the_image_plane_are_nan():
    lens = LensDistortion.unknown(CAMERA, CONFIG)
    pixels = lens.pixels(np.array([[0.0, 0.0, 1.0], [1.0, 1.0, 0.0], [1.0, 1.0, -2.0]]))
    np.testing.assert_allclose(pixels[0], [CAMERA.cx, CAMERA.cy])
    assert np.isnan(pixels[1:]).all()


def test_information_reduces_the_variance_and_time_brings_it_back():
    lens = LensDistortion.unknown(CAMERA, CONFIG)
    np.testing.assert_allclose(np.sqrt(np.diag(lens.covariance)), [10.0, 5.0, 5.0])
    learned = lens.update(np.array([1.0, 2.0, 3.0]), np.eye(3), CONFIG)
    np.testing.assert_allclose(learned.coefficients, [1, 2, 3])
    np.testing.assert_allclose(np.diag(learned.covariance), [100 / 101, 25 / 26, 25 / 26], rtol=1e-5)
    later = learned.update(learned.coefficients, np.zeros((3, 3)), CONFIG)
    np.testing.assert_allclose(np.diag(later.covariance - learned.covariance), CONFIG.drift_px**2, rtol=1e-6)


def test_one_track_does_not_count_anew_in_every_frame():
    config = CalibrationConfig(drift_px=0.0, frames_per_track=4)
    calibration = Calibration.unknown(CAMERA, config)
    known = np.linalg.inv(calibration.covariance)
    for _ in range(4):  # four frames that show the same tracks give the information of one
        calibration = calibration.update(calibration.coefficients, np.eye(15), config)
    np.testing.assert_allclose(np.linalg.inv(calibration.covariance), known + np.eye(15), rtol=1e-9)


@pytest.mark.parametrize("shift", [-1.5, 0.0, 2.0])
def test_a_constant_offset_of_the_right_image_is_taken_out_of_disparities(shift):
    coefficients = np.zeros(15)
    coefficients[3] = shift  # of columns
    calibration = Calibration(CAMERA, coefficients, np.eye(15))
    pixels = np.array([[100.0, 50.0], [900.0, 300.0]])
    np.testing.assert_allclose(
        calibration.correct_disparity(pixels, np.array([20.0, 5.0])), np.array([20.0, 5.0]) + shift
    )
