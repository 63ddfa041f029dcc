"""The adjustment finds the motion, knows how well, and withstands far points, outliers, bad calibrations."""

from dataclasses import replace

import numpy as np
import pytest

from odometry import se3
from odometry.stereo.stereo_self_calibration import Calibration, CalibrationConfig
from odometry.stereo.two_view_adjustment import StereoTracks, estimate_motion, ransac_motion

MOTION = se3.exp(np.array([0.004, 0.02, -0.003, 0.05, -0.02, 0.9]))
EXACT = CalibrationConfig(radial_px=1e-3, decentering_px=1e-3, offset_px=1e-3, slope_px=1e-3, curvature_px=1e-3)
OPEN = CalibrationConfig()


def spoiled(tracks, share, rng):
    """The tracks with a share of them moved anywhere."""
    bad = rng.random(len(tracks)) < share
    second = tracks.second_left + bad[:, None] * rng.uniform(-40, 40, (len(tracks), 2))
    right = tracks.second_right + bad[:, None] * rng.uniform(-40, 40, (len(tracks), 2))
    return StereoTracks(tracks.first_left, tracks.first_right, second, right, tracks.ids), bad


def error(estimate):
    return se3.log(se3.inverse(estimate.T_first_second) @ MOTION)


def test_exact_measurements_give_the_exact_motion(camera, simulate):
    tracks = simulate(camera, MOTION, np.random.default_rng(0), noise_px=0.0)
    estimate = estimate_motion(tracks, Calibration.unknown(camera, EXACT), np.eye(4))
    np.testing.assert_allclose(estimate.T_first_second, MOTION, atol=1e-7)
    assert estimate.inliers.all()


@pytest.mark.parametrize("calibration", [EXACT, OPEN], ids=["known", "unknown"])
def test_errors_are_as_large_as_the_covariance_says(camera, simulate, calibration):
    rng, nees = np.random.default_rng(1), []
    for _ in range(120):
        estimate = estimate_motion(simulate(camera, MOTION, rng), Calibration.unknown(camera, calibration), MOTION)
        nees.append(error(estimate) @ np.linalg.solve(estimate.covariance, error(estimate)))
    assert 4.0 < np.mean(nees) < 9.0


def test_errors_stay_so_among_outliers(camera, simulate):
    rng, nees = np.random.default_rng(2), []
    for _ in range(60):
        tracks, _ = spoiled(simulate(camera, MOTION, rng), 0.25, rng)
        estimate = estimate_motion(tracks, Calibration.unknown(camera, EXACT), MOTION)
        nees.append(error(estimate) @ np.linalg.solve(estimate.covariance, error(estimate)))
    assert 3.0 < np.mean(nees) < 12.0


@pytest.mark.parametrize("depths", [(6.0, 20.0), (30.0, 300.0)], ids=["near", "far"])
def test_the_distance_has_no_bias_whatever_the_depth(camera, simulate, depths):
    rng = np.random.default_rng(3)
    unknown = Calibration.unknown(camera, EXACT)
    errors = [error(estimate_motion(simulate(camera, MOTION, rng, depths=depths), unknown, MOTION)) for _ in range(150)]
    mean, deviation = np.mean(errors, axis=0), np.std(errors, axis=0) / np.sqrt(len(errors))
    assert np.all(np.abs(mean) < 3.5 * deviation)


def test_outliers_are_named(camera, simulate):
    rng = np.random.default_rng(4)
    tracks, bad = spoiled(simulate(camera, MOTION, rng), 0.3, rng)
    estimate = estimate_motion(tracks, Calibration.unknown(camera, EXACT), np.eye(4))
    assert np.mean(estimate.inliers[~bad]) > 0.9
    assert np.mean(estimate.inliers[bad]) < 0.1


def test_a_rectification_error_is_learned_and_no_longer_stretches_the_distance(camera, simulate):
    rng, learned = np.random.default_rng(5), Calibration.unknown(camera, OPEN)
    for _ in range(40):
        tracks = simulate(camera, MOTION, rng, offset_px=(0.8, -0.5))
        estimate = estimate_motion(tracks, learned, MOTION)
        learned = learned.update(estimate.calibration, estimate.information, OPEN)
    center = np.array([[camera.cx, camera.cy]])
    np.testing.assert_allclose(learned.rectify(center, center)[1], center - [0.8, -0.5], atol=0.06)
    np.testing.assert_allclose(learned.correct_disparity(center, np.array([9.2])), [10.0], atol=0.06)
    assert np.linalg.norm(error(estimate)[3:]) < 0.01
    blind = estimate_motion(tracks, Calibration.unknown(camera, EXACT), MOTION)
    assert error(blind)[5] < -0.02  # too long


def test_a_good_calibration_is_left_alone(camera, simulate):
    rng, learned = np.random.default_rng(6), Calibration.unknown(camera, OPEN)
    for _ in range(40):
        estimate = estimate_motion(simulate(camera, MOTION, rng), learned, MOTION)
        learned = learned.update(estimate.calibration, estimate.information, OPEN)
    places = np.array([[100.0, 50.0], [400.0, 180.0]])
    left, right = learned.rectify(places, places)
    assert np.abs(right - left).max() < 0.1
    assert np.abs(left - places).max() < 1.0


def distorted(tracks, lens):
    """The tracks as cameras show them whose `straighten` would undo the lens (3,), pixels."""
    truth = replace(Calibration.unknown(lens.camera, OPEN), coefficients=lens.coefficients)

    def bent(places):
        shown = places
        for _ in range(20):  # the inverse of a small displacement, by iteration
            shown = places - (truth.undistort(shown) - shown)
        return shown

    places = (tracks.first_left, tracks.first_right, tracks.second_left, tracks.second_right)
    return StereoTracks(*map(bent, places), tracks.ids)


def test_a_distortion_that_both_lenses_share_is_learned_and_no_longer_bends_the_path(camera, simulate):
    rng, learned = np.random.default_rng(8), Calibration.unknown(camera, OPEN)
    lens = replace(learned, coefficients=np.concatenate([[-8.0, 3.0, -2.0], np.zeros(12)]))
    errors = []
    for _ in range(60):
        tracks = distorted(simulate(camera, MOTION, rng, noise_px=0.1), lens)
        estimate = estimate_motion(tracks, learned, MOTION)
        learned = learned.update(estimate.calibration, estimate.information, OPEN)
        errors.append(error(estimate))
    np.testing.assert_allclose(learned.coefficients[:3], lens.coefficients[:3], atol=1.5)
    blind = [
        error(
            estimate_motion(distorted(simulate(camera, MOTION, rng), lens), Calibration.unknown(camera, EXACT), MOTION)
        )
        for _ in range(20)
    ]
    assert np.linalg.norm(np.mean(errors[-20:], axis=0)) < 0.3 * np.linalg.norm(np.mean(blind, axis=0))


def test_minimal_samples_find_a_motion_far_from_any_guess_and_always_the_same(camera, simulate):
    rng = np.random.default_rng(7)
    tracks, _ = spoiled(simulate(camera, MOTION, rng), 0.4, rng)
    unknown = Calibration.unknown(camera, EXACT)
    first, second = ransac_motion(tracks, unknown), ransac_motion(tracks, unknown)
    np.testing.assert_array_equal(first, second)
    assert np.linalg.norm(se3.log(se3.inverse(first) @ MOTION)) < 0.2


def test_points_that_all_lie_in_one_place_do_not_crash(camera):
    same = np.full((30, 2), 100.0)
    tracks = StereoTracks(same, same - [5, 0], same, same - [5, 0], np.arange(30))
    unknown = Calibration.unknown(camera, EXACT)
    assert np.isfinite(estimate_motion(tracks, unknown, np.eye(4)).covariance).all()
    ransac_motion(tracks, unknown)
