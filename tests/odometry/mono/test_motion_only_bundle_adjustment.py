"""The pose of one image from points of known and unknown depth."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odometry import se3
from odometry.camera import StereoCamera
from odometry.distortion import LensDistortion, LensDistortionConfig
from odometry.inverse_depth_points import Points
from odometry.mono.mono_bundle_adjustment import MonoBundle, MonoBundleConfig
from odometry.mono.mono_frontend import MonoTracks
from odometry.mono.motion_only_bundle_adjustment import PoseEstimationConfig, estimate_pose

CAMERA = StereoCamera(fx=350.0, fy=350.0, cx=255.5, cy=111.5, baseline=0.5, width=512, height=224)
LENS = LensDistortion.unknown(CAMERA, LensDistortionConfig())
TRUTH = se3.exp(np.array([0.01, -0.02, 0.005, 0.1, -0.05, 0.6]))


def problem(rng, depths, noise_px=0.0, information=1e6):
    """A map of one frame with points at depths (N,), and the tracks of an image at TRUTH."""
    n = len(depths)
    pixels = rng.uniform([20, 20], [490, 200], (n, 2))
    bundle = MonoBundle(LENS, MonoBundleConfig(), LensDistortionConfig())
    bundle.poses = np.eye(4)[None]
    ids = np.arange(n)
    bundle.points = Points(ids, np.zeros(n, np.int64), pixels, 1.0 / depths, np.full(n, information))
    points = LENS.rays(pixels) * depths[:, None]
    seen = LENS.pixels(se3.transform(se3.inverse(TRUTH), points)) + rng.normal(0, noise_px, (n, 2))
    image = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    return bundle, MonoTracks(image, ids, seen, seen, image)


def estimate(bundle, tracks, T_guess=None):
    return estimate_pose(bundle, tracks, np.eye(4), np.eye(4) if T_guess is None else T_guess, PoseEstimationConfig())


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6))
def test_exact_points_give_the_exact_pose(seed):
    rng = np.random.default_rng(seed)
    found = estimate(*problem(rng, rng.uniform(5, 40, 80)))
    np.testing.assert_allclose(found.T_first_second, TRUTH, atol=1e-5)
    assert found.inliers.all()


def test_points_at_infinity_give_the_rotation_alone():
    far = estimate(*problem(np.random.default_rng(0), np.full(80, 1e6)), TRUTH)
    assert se3.angle(se3.inverse(TRUTH) @ far.T_first_second) < 1e-5
    deviation = np.sqrt(np.diag(far.covariance))
    assert deviation[:3].max() < 1e-3
    assert deviation[3:].min() > 1.0


def test_tracks_of_another_car_are_outliers_and_do_not_pull_the_pose():
    bundle, tracks = problem(np.random.default_rng(1), np.random.default_rng(2).uniform(5, 40, 100))
    tracks.pixels[:30] += [15.0, 4.0]
    found = estimate(bundle, tracks, TRUTH)
    assert not found.inliers[:30].any()
    assert found.inliers[30:].all()
    np.testing.assert_allclose(found.T_first_second, TRUTH, atol=1e-4)


@pytest.mark.parametrize("noise_px", [0.1, 0.4])
def test_the_noise_is_estimated_and_the_covariance_covers_the_error(noise_px):
    rng = np.random.default_rng(3)
    nees = []
    for _ in range(40):
        found = estimate(*problem(rng, rng.uniform(5, 40, 150), noise_px), TRUTH)
        error = se3.log(se3.inverse(found.T_first_second) @ TRUTH)
        nees.append(error @ np.linalg.solve(found.covariance, error))
        assert found.noise_px == pytest.approx(noise_px, rel=0.5)
    assert 3.0 < np.mean(nees) < 12.0  # six degrees of freedom


def test_points_without_a_known_depth_constrain_the_direction_only():
    known = estimate(*problem(np.random.default_rng(4), np.full(60, 12.0), 0.1), TRUTH)
    unknown = estimate(*problem(np.random.default_rng(4), np.full(60, 12.0), 0.1, information=0.0), TRUTH)
    assert np.trace(unknown.covariance[3:, 3:]) > 10 * np.trace(known.covariance[3:, 3:])
