"""Landmarks move with the frames that saw them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odometry import se3
from odometry.camera import StereoCamera
from slam.mapping.landmark_map import LandmarkMap, LandmarkMapConfig


def kitti_camera(baseline: float = 0.537) -> StereoCamera:
    return StereoCamera(707.0, 707.0, 601.0, 183.0, baseline, 1226, 370)


def drive(seed: int, count: int) -> np.ndarray:
    return np.stack([se3.exp(xi) for xi in np.random.default_rng(seed).normal(size=(count, 6))])


def points_ahead(seed: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform([-5, -2, 1], [5, 2, 30], (count, 3)), rng.integers(0, 256, count, dtype=np.uint8)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 1000), counts=st.lists(st.integers(0, 5), min_size=1, max_size=5))
def test_the_cloud_is_each_frame_transformed(seed: int, counts: list[int]) -> None:
    landmarks, poses = LandmarkMap(), drive(seed, len(counts))
    expected = []
    for index, count in enumerate(counts):
        points, grey = points_ahead(seed + index, count)
        landmarks.add(index, points, grey)
        expected.append(se3.transform(poses[index], points))
    cloud = landmarks.cloud(poses)
    np.testing.assert_allclose(cloud.points, np.concatenate(expected), atol=1e-5)
    assert len(landmarks) == len(cloud.grey) == sum(counts)


def test_a_corrected_trajectory_moves_the_map_and_rewrites_nothing() -> None:
    landmarks = LandmarkMap()
    landmarks.add(1, *points_ahead(0, 10))
    poses = drive(1, 2)
    before, shift = landmarks.cloud(poses).points, se3.exp(np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0]))
    np.testing.assert_allclose(landmarks.cloud(shift @ poses).points, se3.transform(shift, before), atol=1e-9)
    np.testing.assert_array_equal(landmarks.cloud(poses).points, before)


def test_grey_stays_with_its_point() -> None:
    landmarks = LandmarkMap()
    landmarks.add(0, np.array([[0, 0, 5.0], [0, 0, 99.0], [0, 0, 7.0]]), np.array([10, 20, 30], np.uint8))
    cloud = landmarks.cloud(np.eye(4)[None])
    assert cloud.points[:, 2].tolist() == [5.0, 7.0]
    assert cloud.grey.tolist() == [10, 30]
    assert cloud.grey.dtype == np.uint8


@pytest.mark.parametrize("point", [[0, 0, -1.0], [0, 0, 0.0], [0, 0, np.nan], [np.inf, 0, 5.0], [0, 0, 40.1]])
def test_points_that_cannot_be_are_dropped(point: list[float]) -> None:
    landmarks = LandmarkMap()
    landmarks.add(0, np.array([point]), np.zeros(1, np.uint8))
    assert len(landmarks) == 0


@pytest.mark.parametrize(("baseline", "limit"), [(0.537, 37.97), (0.1, 7.07), (2.0, 40.0)])
def test_a_shorter_baseline_sees_less_far(baseline: float, limit: float) -> None:
    config = LandmarkMapConfig()
    assert config.depth_limit(kitti_camera(baseline)) == pytest.approx(limit, abs=0.01)


def test_depth_at_the_limit_is_as_unsure_as_allowed() -> None:
    camera, config = kitti_camera(), LandmarkMapConfig()
    z = config.depth_limit(camera)
    pixels = np.array([[camera.cx, camera.cy]])
    disparity = camera.fx * camera.baseline / z
    unsure = camera.triangulate(pixels, np.array([disparity - config.disparity_sigma_px]))[0, 2]
    assert (unsure - z) / z == pytest.approx(config.max_relative_sigma, rel=0.1)


def test_an_empty_map_is_an_empty_cloud() -> None:
    cloud = LandmarkMap().cloud(np.eye(4)[None])
    assert cloud.points.shape == (0, 3)
    assert cloud.grey.shape == (0,)


def test_a_frame_without_a_pose_is_an_error() -> None:
    landmarks = LandmarkMap()
    landmarks.add(4, *points_ahead(0, 3))
    with pytest.raises(ValueError, match="expected poses for 5 frames, got 2"):
        landmarks.cloud(drive(0, 2))


def test_a_frame_that_is_removed_leaves_the_others_as_they_are() -> None:
    poses, points = drive(3, 4), np.random.default_rng(0).uniform(1.0, 10.0, (4, 20, 3))
    landmarks, without = LandmarkMap(), LandmarkMap()
    for frame in range(4):
        landmarks.add(frame, points[frame], np.full(20, frame, np.uint8))
        if frame != 2:
            without.add(frame, points[frame], np.full(20, frame, np.uint8))
    landmarks.remove(2)
    landmarks.remove(17)  # it never was there
    np.testing.assert_array_equal(landmarks.cloud(poses).points, without.cloud(poses).points)
    np.testing.assert_array_equal(landmarks.cloud(poses).grey, without.cloud(poses).grey)
    np.testing.assert_array_equal(landmarks.frames, without.frames)
    assert len(landmarks) == 60
