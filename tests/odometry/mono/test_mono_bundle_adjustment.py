"""Geometry of one camera, where the truth is known: lens, triangulation, two views, and the adjusted window."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odometry import se3
from odometry.camera import StereoCamera, triangulate
from odometry.distortion import LensDistortion, LensDistortionConfig
from odometry.inverse_depth_points import FrameObservations
from odometry.mono.mono_bundle_adjustment import MonoBundle, MonoBundleConfig
from odometry.mono.mono_frontend import MonoTracks
from odometry.mono.mono_initialization import Initialization, InitializationConfig, initialize
from odometry.mono.motion_only_bundle_adjustment import PoseEstimationConfig, estimate_pose

STEP = se3.exp(np.array([0.002, 0.03, -0.001, 0.05, -0.01, 0.8]))
seeds = st.integers(0, 10_000)


def lens_of(camera, radial=0.0):
    return LensDistortion(camera, np.array([radial, 0.0, 0.0]), 1e-6 * np.eye(3))


def scene(rng, count=300):
    return rng.uniform([-12, -5, 8], [12, 3, 60], (count, 3))


def views(camera, points, poses, rng, noise=0.0, lens=None):
    """What each camera shows of the points: names and pixels."""
    lens, seen = lens or lens_of(camera), []
    for T in poses:
        pixels = lens.pixels(se3.transform(se3.inverse(T), points))
        inside = ((pixels > 5) & (pixels < [camera.width - 5, camera.height - 5])).all(axis=1)
        ids = np.flatnonzero(inside)
        seen.append(FrameObservations(ids, pixels[ids] + noise * rng.normal(size=(len(ids), 2))))
    return seen


def shared(first, second):
    """The points that two views share, as each shows them."""
    ids = np.intersect1d(first.ids, second.ids)
    return [FrameObservations(ids, seen.pixels[np.searchsorted(seen.ids, ids)]) for seen in (first, second)]


def driven(camera, config, seed=0, count=16, noise=0.0):
    """A bundle after a drive, its poses said to be a little off each time, and the truth."""
    rng = np.random.default_rng(seed)
    truth = [np.linalg.matrix_power(STEP, k) for k in range(count)]
    seen = views(camera, scene(rng, 600), truth, rng, noise)
    bundle = MonoBundle(lens_of(camera), config, LensDistortionConfig())
    bundle.initialize(*shared(seen[0], seen[1]), STEP)
    for k in range(2, count):
        off = se3.exp(rng.normal(0, [1e-3] * 3 + [0.02] * 3))
        bundle.add(seen[k], se3.orthonormalize(bundle.poses[-1] @ STEP @ off))
    return bundle, truth, seen


@given(seeds, st.floats(-15.0, 15.0))
def test_pixels_of_rays_are_the_pixels(seed, radial):
    camera = StereoCamera(fx=718.0, fy=718.0, cx=607.0, cy=185.0, baseline=0.5, width=1241, height=376)
    lens = lens_of(camera, radial)
    pixels = np.random.default_rng(seed).uniform([0, 0], [1241, 376], (50, 2))
    np.testing.assert_allclose(lens.pixels(7.0 * lens.rays(pixels)), pixels, atol=1.0)
    middle = np.abs(pixels - [607, 185]).max(axis=1) < 300
    np.testing.assert_allclose(lens.pixels(lens.rays(pixels[middle])), pixels[middle], atol=0.1)


@given(seeds)
def test_triangulated_depth_is_the_depth(seed):
    rng = np.random.default_rng(seed)
    T = se3.exp(rng.normal(0, [0.1] * 3 + [1.0] * 3))
    points = rng.uniform([-10, -5, 5], [10, 5, 50], (30, 3))
    there = se3.transform(T, points)
    ahead = there[:, 2] > 1.0
    depth, strength = triangulate(
        points[ahead] / points[ahead, 2:], there[ahead] / there[ahead, 2:], np.tile(T, (int(ahead.sum()), 1, 1))
    )
    np.testing.assert_allclose(depth, 1 / points[ahead, 2], atol=1e-9)
    assert (strength > 0).all()


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_two_views_begin_with_their_motion_despite_false_tracks(seed):
    camera = StereoCamera(fx=350.0, fy=350.0, cx=255.5, cy=111.5, baseline=0.5, width=512, height=224)
    rng = np.random.default_rng(seed)
    T = np.linalg.matrix_power(STEP, 4)
    first, second = shared(*views(camera, scene(rng, 500), [np.eye(4), T], rng, noise=0.1))
    second.pixels[:20] = rng.uniform([0, 0], [512, 224], (20, 2))
    found = initialize(lens_of(camera), first.pixels, second.pixels, InitializationConfig())
    assert isinstance(found, Initialization)
    T[:3, 3] /= np.linalg.norm(T[:3, 3])
    off = se3.log(se3.inverse(T) @ found.T_first_second)
    assert np.linalg.norm(off[:3]) < 0.01
    assert np.linalg.norm(off[3:]) < 0.1
    assert found.inliers[:20].mean() < 0.4 < 0.9 < found.inliers[20:].mean()


def test_a_turn_on_the_spot_and_a_handful_of_points_begin_nothing(camera):
    rng = np.random.default_rng(1)
    turn = se3.exp(np.array([0.0, 0.05, 0.0, 0.0, 0.0, 0.0]))
    first, second = shared(*views(camera, scene(rng, 500), [np.eye(4), turn], rng))
    assert isinstance(initialize(lens_of(camera), first.pixels, second.pixels, InitializationConfig()), str)
    assert "not moved far enough" in str(
        initialize(lens_of(camera), first.pixels, first.pixels, InitializationConfig())
    )
    few = first.pixels[:10], second.pixels[:10]
    assert "fewer than 50 points" in str(initialize(lens_of(camera), *few, InitializationConfig()))


def test_exact_views_give_exact_poses_and_depths(camera):
    bundle, truth, seen = driven(camera, MonoBundleConfig(max_frames=8, max_free_frames=4, iterations=4))
    assert len(bundle.poses) == 8
    np.testing.assert_allclose(bundle.poses[-1], truth[-1], atol=2e-3)
    points = bundle.in_camera(seen[-1].ids, bundle.poses[-1])
    expected = bundle.lens.rays(seen[-1].pixels)
    np.testing.assert_allclose(points[:, :2] / points[:, 2:3], expected[:, :2], atol=1e-3)


def test_with_noise_poses_are_near_and_the_noise_is_estimated(camera):
    bundle, truth, _ = driven(camera, MonoBundleConfig(error_correlation=0.0), noise=0.1)
    off = se3.log(se3.inverse(truth[-1]) @ bundle.poses[-1])
    assert np.linalg.norm(off[:3]) < 5e-3
    assert np.linalg.norm(off[3:]) < 0.3
    assert 0.05 < bundle.noise_px < 0.2


def test_no_image_sees_that_a_map_is_rescaled(camera):
    bundle, _, seen = driven(camera, MonoBundleConfig())
    before = bundle.predict(seen[-1].ids, bundle.poses[-1])
    length = np.linalg.norm(bundle.poses[-1][:3, 3] - bundle.poses[-2][:3, 3])
    bundle.rescale(1.7)
    np.testing.assert_allclose(bundle.predict(seen[-1].ids, bundle.poses[-1]), before, atol=1e-9)
    assert np.linalg.norm(bundle.poses[-1][:3, 3] - bundle.poses[-2][:3, 3]) == pytest.approx(1.7 * length)


def test_points_stay_where_they_are_when_the_frame_that_saw_them_first_leaves(camera):
    bundle, _, seen = driven(camera, MonoBundleConfig(max_frames=6, max_free_frames=2), count=6)
    ids = np.intersect1d(np.intersect1d(seen[0].ids, seen[1].ids), seen[-1].ids)
    before = bundle.in_camera(ids, bundle.poses[-1])
    poses = bundle.poses
    bundle.add(seen[-1], poses[-1])  # the same view again: nothing new but that the oldest leaves
    after = bundle.in_camera(ids, poses[-1])
    np.testing.assert_allclose(after[:, :3] / after[:, 3:], before[:, :3] / before[:, 3:], rtol=0.02, atol=0.02)


@pytest.mark.parametrize("place", [0, 2, 5])
def test_points_stay_where_they_are_whichever_frame_leaves(camera, place):
    bundle, _, seen = driven(camera, MonoBundleConfig(), count=6)
    others = [frame.ids for k, frame in enumerate(seen) if k != place]
    ids = np.intersect1d(others[0], others[-1])
    before = bundle.in_camera(ids, bundle.poses[1])
    origin = bundle.poses[1]
    bundle.remove(place)
    after = bundle.in_camera(ids, origin)
    np.testing.assert_allclose(after[:, :3] / after[:, 3:], before[:, :3] / before[:, 3:], rtol=0.02, atol=0.02)


def test_a_frame_that_comes_back_brings_its_landmarks_with_their_depths(camera):
    bundle = driven(camera, MonoBundleConfig(), count=6)[0]
    image = np.zeros((camera.height, camera.width), np.uint8)
    frame = bundle.landmarks_of(0, image)
    before = bundle.in_camera(frame.ids, bundle.poses[-1])
    origin = bundle.poses[-1]
    bundle.remove(0)
    bundle.revisit(frame)
    assert bundle.numbers[0] == frame.number
    after = bundle.in_camera(frame.ids, origin)
    np.testing.assert_allclose(after[:, :3] / after[:, 3:], before[:, :3] / before[:, 3:], rtol=0.02, atol=0.02)


def test_an_image_is_placed_by_points_of_known_depth(camera):
    bundle, truth, seen = driven(camera, MonoBundleConfig(), count=10)
    there = truth[-1] @ STEP
    rng = np.random.default_rng(5)
    ids = seen[-1].ids
    points = bundle.in_camera(ids, there)
    pixels = bundle.lens.pixels(points[:, :3]) + 0.05 * rng.normal(size=(len(ids), 2))
    pixels[:30] += 15.0  # another car
    image = np.zeros((camera.height, camera.width), np.uint8)
    tracks = MonoTracks(image, ids, pixels, pixels, image)
    found = estimate_pose(bundle, tracks, truth[-1], np.eye(4), PoseEstimationConfig())
    off = se3.log(se3.inverse(STEP) @ found.T_first_second)
    assert off @ np.linalg.solve(found.covariance, off) < 40.0
    assert np.linalg.norm(off[:3]) < 1e-3
    assert not found.inliers[:30].any()
    assert found.inliers[30:].mean() > 0.95
