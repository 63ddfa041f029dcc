"""The calibration error of a pair, and its inverse."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from odometry.camera import StereoCamera
from odometry.stereo.stereo_self_calibration import NUM_COEFFICIENTS, Calibration, CalibrationConfig

KITTI = StereoCamera(718.856, 718.856, 607.19, 185.22, 0.54, 1241, 376)
WIDE = CalibrationConfig()


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_unrectify_undoes_rectify_for_far_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    prior = WIDE.prior(KITTI)
    calibration = Calibration(KITTI, rng.normal(size=NUM_COEFFICIENTS) * np.sqrt(np.diag(prior)), prior)
    pixels = rng.uniform([0, 0], [KITTI.width, KITTI.height], (50, 2))
    left, right = calibration.rectify(*calibration.unrectify(pixels))
    np.testing.assert_allclose(left, pixels, atol=1e-6)
    np.testing.assert_allclose(right, pixels, atol=1e-6)


def random_calibration(seed: int) -> Calibration:
    prior = WIDE.prior(KITTI)
    coefficients = np.random.default_rng(seed).normal(size=NUM_COEFFICIENTS) * np.sqrt(np.diag(prior))
    return Calibration(KITTI, coefficients, prior)


def test_a_camera_of_half_the_resolution_has_half_the_error() -> None:
    half = StereoCamera(359.428, 359.428, 303.6, 92.6, 0.54, 620, 188)
    whole, small = (np.sqrt(np.diag(CalibrationConfig().prior(camera))) for camera in (KITTI, half))
    np.testing.assert_allclose(small, whole / 2)


def test_without_any_image_nothing_is_corrected() -> None:
    unknown, pixels = Calibration.unknown(KITTI, CalibrationConfig()), np.array([[100.0, 50.0], [900.0, 300.0]])
    np.testing.assert_array_equal(unknown.undistort(pixels), pixels)
    np.testing.assert_array_equal(unknown.correct_disparity(pixels, np.array([3.0, 7.0])), [3.0, 7.0])


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_a_corrected_disparity_is_that_of_the_rectified_pixels(seed: int) -> None:
    rng, calibration = np.random.default_rng(seed), random_calibration(seed)
    left, disparity = rng.uniform([0, 0], [KITTI.width, KITTI.height], (50, 2)), rng.uniform(0, 80, 50)
    straight_left, straight_right = calibration.rectify(left, left - np.column_stack([disparity, np.zeros(50)]))
    corrected = calibration.correct_disparity(left, disparity)
    np.testing.assert_allclose(corrected, straight_left[:, 0] - straight_right[:, 0], atol=1e-9)


def test_a_frame_without_information_only_adds_drift() -> None:
    config, before = CalibrationConfig(), random_calibration(3)
    after = before.update(before.coefficients, np.zeros((NUM_COEFFICIENTS, NUM_COEFFICIENTS)), config)
    grown = after.covariance - before.covariance
    np.testing.assert_allclose(grown, config.drift_px**2 * np.eye(NUM_COEFFICIENTS), atol=1e-9)


def test_each_frame_makes_the_calibration_more_certain_up_to_the_drift() -> None:
    config = CalibrationConfig()
    calibration, information = random_calibration(4), 1e6 * np.eye(NUM_COEFFICIENTS)
    for _ in range(50):
        calibration = calibration.update(calibration.coefficients, information, config)
    sigma = np.sqrt(np.diag(calibration.covariance))
    assert (sigma < 0.01).all()
    assert (sigma >= config.drift_px).all()
    np.testing.assert_array_equal(calibration.covariance, calibration.covariance.T)
