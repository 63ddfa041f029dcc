"""A known camera sees known points: its pose comes back, and its covariance says how well."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from odometry import se3
from odometry.camera import StereoCamera
from slam.localization.absolute_pose import MapMatches, PoseConfig, estimate_camera_pose, refine_pose

CAMERA = StereoCamera(fx=700.0, fy=700.0, cx=600.0, cy=180.0, baseline=0.5, width=1200, height=360)
EXACT = PoseConfig(systematic_rad=0.0, systematic_m=0.0)


def scene(seed: int, points: int = 80, noise_px: float = 0.0) -> tuple[np.ndarray, MapMatches]:
    """T_base_camera (4, 4), drawn, and what the camera sees of exactly known points."""
    rng = np.random.default_rng(seed)
    T_base_camera = se3.exp(rng.normal(size=6) * [0.05, 0.2, 0.05, 1.0, 0.3, 1.5])
    pixels = rng.uniform([0, 0], [CAMERA.width, CAMERA.height], (points, 2))
    seen = CAMERA.triangulate(pixels, CAMERA.fx * CAMERA.baseline / rng.uniform(4, 40, points))
    moved = pixels + rng.normal(size=pixels.shape) * noise_px
    points_base = se3.transform(T_base_camera, seen)
    return T_base_camera, MapMatches(moved, points_base, np.zeros((points, 3, 3)), np.arange(points))


def error(T: np.ndarray, expected: np.ndarray) -> np.ndarray:
    return se3.log(se3.inverse(expected) @ T)


@given(st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_the_pose_of_exact_matches_is_exact(seed: int) -> None:
    T_base_camera, matches = scene(seed)
    found = estimate_camera_pose(CAMERA, matches, EXACT)
    assert found is not None
    assert np.abs(error(found.T_base_camera, T_base_camera)).max() < 1e-6
    assert found.inliers.all()


def test_half_of_the_matches_may_be_wrong() -> None:
    T_base_camera, matches = scene(1, 120)
    rng = np.random.default_rng(2)
    wrong = np.arange(120) % 2 == 0
    matches.pixels[wrong] = rng.uniform([0, 0], [CAMERA.width, CAMERA.height], (60, 2))
    found = estimate_camera_pose(CAMERA, matches, EXACT)
    assert found is not None
    assert np.abs(error(found.T_base_camera, T_base_camera)).max() < 1e-3
    assert found.inliers[~wrong].all()
    assert found.inliers[wrong].sum() <= 3  # by chance


def test_errors_of_the_pose_agree_with_its_covariance() -> None:
    scores = []
    for seed in range(150):
        T_base_camera, matches = scene(seed, noise_px=EXACT.sigma_px)
        found = refine_pose(CAMERA, matches, T_base_camera, EXACT)
        assert found is not None
        off = error(found.T_base_camera, T_base_camera)
        scores.append(off @ np.linalg.solve(found.covariance, off))
    assert 5.0 < np.mean(scores) < 7.0  # chi-square with 6 degrees of freedom; 150 of them: 6 +- 0.28


def test_a_feature_with_two_matches_counts_as_one_measurement() -> None:
    T_base_camera, once = scene(3, noise_px=0.7)
    indices = np.tile(np.arange(len(once)), 2)
    twice = MapMatches(once.pixels[indices], once.points_base[indices], once.noise_base[indices], indices)
    first = refine_pose(CAMERA, once, T_base_camera, EXACT)
    second = refine_pose(CAMERA, twice, T_base_camera, EXACT)
    assert first is not None
    assert second is not None
    np.testing.assert_allclose(second.covariance, first.covariance, rtol=1e-6)


def test_points_that_cannot_be_seen_do_not_count() -> None:
    T_base_camera, matches = scene(4)
    camera_points = np.array([[0.1, 0.0, -5.0], [0.0, 0.0, 1e-4], [0.2, 0.1, 0.0]])
    behind = se3.transform(T_base_camera, camera_points)
    more = MapMatches(
        np.vstack([matches.pixels, np.full((3, 2), 100.0)]),
        np.vstack([matches.points_base, behind]),
        np.zeros((len(matches) + 3, 3, 3)),
        np.arange(len(matches) + 3),
    )
    found = refine_pose(CAMERA, more, T_base_camera, EXACT)
    assert found is not None
    assert not found.inliers[-3:].any()
    assert np.abs(error(found.T_base_camera, T_base_camera)).max() < 1e-6


def test_too_few_or_contradicting_matches_give_no_pose() -> None:
    _, matches = scene(5)
    assert estimate_camera_pose(CAMERA, matches.only(np.arange(len(matches)) < 5), EXACT) is None
    matches.pixels[:] = np.random.default_rng(6).uniform([0, 0], [CAMERA.width, CAMERA.height], matches.pixels.shape)
    found = estimate_camera_pose(CAMERA, matches, EXACT)
    assert found is None or found.inliers.sum() < 15
