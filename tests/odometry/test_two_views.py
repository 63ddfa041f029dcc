"""The adjustment finds the motion, knows how well, and withstands far points, outliers, rectifications."""

import numpy as np
import pytest

from odometry import se3
from odometry.rectification import Rectification, RectificationConfig
from odometry.two_views import StereoTracks, estimate_motion, ransac_motion

MOTION = se3.exp(np.array([0.004, 0.02, -0.003, 0.05, -0.02, 0.9]))
EXACT = RectificationConfig(offset_px=1e-3, slope_px=1e-3, curvature_px=1e-3)
OPEN = RectificationConfig()


def spoiled(tracks, share, rng):
    """The tracks with a share of them moved anywhere."""
    bad = rng.random(len(tracks)) < share
    second = tracks.second_left + bad[:, None] * rng.uniform(-40, 40, (len(tracks), 2))
    right = tracks.second_right + bad[:, None] * rng.uniform(-40, 40, (len(tracks), 2))
    return StereoTracks(tracks.first_left, tracks.first_right, second, right), bad


def error(estimate):
    return se3.log(se3.inverse(estimate.T_first_second) @ MOTION)


def test_exact_measurements_give_the_exact_motion(camera, simulate):
    tracks = simulate(camera, MOTION, np.random.default_rng(0), noise_px=0.0)
    estimate = estimate_motion(tracks, Rectification.unknown(camera, EXACT), np.eye(4))
    np.testing.assert_allclose(estimate.T_first_second, MOTION, atol=1e-7)
    assert estimate.inliers.all()


@pytest.mark.parametrize("rectification", [EXACT, OPEN], ids=["known", "unknown"])
def test_errors_are_as_large_as_the_covariance_says(camera, simulate, rectification):
    rng, nees = np.random.default_rng(1), []
    for _ in range(120):
        estimate = estimate_motion(simulate(camera, MOTION, rng), Rectification.unknown(camera, rectification), MOTION)
        nees.append(error(estimate) @ np.linalg.solve(estimate.covariance, error(estimate)))
    assert 4.0 < np.mean(nees) < 9.0


def test_errors_stay_so_among_outliers(camera, simulate):
    rng, nees = np.random.default_rng(2), []
    for _ in range(60):
        tracks, _ = spoiled(simulate(camera, MOTION, rng), 0.25, rng)
        estimate = estimate_motion(tracks, Rectification.unknown(camera, EXACT), MOTION)
        nees.append(error(estimate) @ np.linalg.solve(estimate.covariance, error(estimate)))
    assert 3.0 < np.mean(nees) < 12.0


@pytest.mark.parametrize("depths", [(6.0, 20.0), (30.0, 300.0)], ids=["near", "far"])
def test_the_way_has_no_bias_whatever_the_depth(camera, simulate, depths):
    rng = np.random.default_rng(3)
    unknown = Rectification.unknown(camera, EXACT)
    errors = [error(estimate_motion(simulate(camera, MOTION, rng, depths=depths), unknown, MOTION)) for _ in range(150)]
    mean, deviation = np.mean(errors, axis=0), np.std(errors, axis=0) / np.sqrt(len(errors))
    assert np.all(np.abs(mean) < 3.5 * deviation)


def test_outliers_are_named(camera, simulate):
    rng = np.random.default_rng(4)
    tracks, bad = spoiled(simulate(camera, MOTION, rng), 0.3, rng)
    estimate = estimate_motion(tracks, Rectification.unknown(camera, EXACT), np.eye(4))
    assert np.mean(estimate.inliers[~bad]) > 0.9
    assert np.mean(estimate.inliers[bad]) < 0.1


def test_a_rectification_error_is_learned_and_no_longer_stretches_the_way(camera, simulate):
    rng, learned = np.random.default_rng(5), Rectification.unknown(camera, OPEN)
    for _ in range(40):
        tracks = simulate(camera, MOTION, rng, offset_px=(0.8, -0.5))
        estimate = estimate_motion(tracks, learned, MOTION)
        learned = learned.learned(estimate.rectification, estimate.information, OPEN)
    centre = np.array([[camera.cx, camera.cy]])
    np.testing.assert_allclose(learned.errors(centre), [[0.8, -0.5]], atol=0.06)
    np.testing.assert_allclose(learned.correct(centre, np.array([9.2])), [10.0], atol=0.06)
    assert np.linalg.norm(error(estimate)[3:]) < 0.01
    blind = estimate_motion(tracks, Rectification.unknown(camera, EXACT), MOTION)
    assert error(blind)[5] < -0.02  # too long


def test_a_good_calibration_is_left_alone(camera, simulate):
    rng, learned = np.random.default_rng(6), Rectification.unknown(camera, OPEN)
    for _ in range(40):
        estimate = estimate_motion(simulate(camera, MOTION, rng), learned, MOTION)
        learned = learned.learned(estimate.rectification, estimate.information, OPEN)
    assert np.abs(learned.errors(np.array([[100.0, 50.0], [400.0, 180.0]]))).max() < 0.1


def test_minimal_samples_find_a_motion_far_from_any_guess_and_always_the_same(camera, simulate):
    rng = np.random.default_rng(7)
    tracks, _ = spoiled(simulate(camera, MOTION, rng), 0.4, rng)
    unknown = Rectification.unknown(camera, EXACT)
    first, second = ransac_motion(tracks, unknown), ransac_motion(tracks, unknown)
    np.testing.assert_array_equal(first, second)
    assert np.linalg.norm(se3.log(se3.inverse(first) @ MOTION)) < 0.2


def test_points_that_all_lie_in_one_place_do_not_crash(camera):
    same = np.full((30, 2), 100.0)
    tracks = StereoTracks(same, same - [5, 0], same, same - [5, 0])
    unknown = Rectification.unknown(camera, EXACT)
    assert np.isfinite(estimate_motion(tracks, unknown, np.eye(4)).covariance).all()
    ransac_motion(tracks, unknown)
