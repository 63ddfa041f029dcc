"""Images are paired with their nearest partner in time, and poses are interpolated along the motion between them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odometry import se3
from slam.datasets.time_sync import (
    MAX_GAP_S,
    MAX_PAIR_OFFSET_S,
    associate_timestamps,
    interpolate_poses,
    order_timestamps,
)

from .rig import turned

increasing = st.lists(st.floats(0.0, 5.0), min_size=1, max_size=30, unique=True).map(
    lambda times: np.array(sorted(times))
)


@settings(max_examples=100, deadline=None)
@given(left=increasing, right=increasing)
def test_pairs_increase_use_each_image_once_and_are_close(left: np.ndarray, right: np.ndarray) -> None:
    pairs = associate_timestamps(left, right)
    assert (np.diff(pairs, axis=0) > 0).all()
    assert (np.abs(left[pairs[:, 0]] - right[pairs[:, 1]]) <= MAX_PAIR_OFFSET_S).all()


@settings(max_examples=50, deadline=None)
@given(times=increasing)
def test_association_with_itself_pairs_everything(times: np.ndarray) -> None:
    pairs = associate_timestamps(times, times)
    np.testing.assert_array_equal(pairs, np.repeat(np.arange(len(times))[:, None], 2, axis=1))


@settings(max_examples=50, deadline=None)
@given(left=increasing, right=increasing)
def test_left_and_right_may_be_swapped(left: np.ndarray, right: np.ndarray) -> None:
    there, back = associate_timestamps(left, right), associate_timestamps(right, left)
    apart = np.abs(left[:, None] - right[None])
    if len(np.unique(apart)) == apart.size:  # without ties, each image has one nearest partner
        np.testing.assert_array_equal(there, back[:, ::-1])


@pytest.mark.parametrize("empty", [(np.array([]), np.array([1.0])), (np.array([1.0]), np.array([]))])
def test_a_camera_without_images_has_no_pairs(empty: tuple[np.ndarray, np.ndarray]) -> None:
    assert associate_timestamps(*empty).shape == (0, 2)


def test_a_missing_image_leaves_the_other_pairs_alone() -> None:
    times = np.arange(10) / 20
    pairs = associate_timestamps(times, np.delete(times, 4) + 0.001)
    np.testing.assert_array_equal(pairs[:, 0], np.delete(np.arange(10), 4))
    np.testing.assert_array_equal(pairs[:, 1], np.arange(9))


def steady(times: np.ndarray) -> np.ndarray:
    """Poses of a motion with constant velocity and constant rate of rotation about one axis."""
    poses = np.array([turned((0.0, 20.0 * t, 0.0), (1.0 + 2.0 * t, -t, 0.5 * t)) for t in times])
    return np.asarray(poses)


def test_a_steady_motion_is_interpolated_exactly() -> None:
    pose_times, times = np.arange(0.0, 3.0, 0.1), np.linspace(0.05, 2.85, 17)
    result = interpolate_poses(times, pose_times, steady(pose_times))
    expected = steady(times)
    assert (result.frames, result.remark) == (slice(0, 17), "")
    np.testing.assert_allclose(result.poses, se3.inverse(expected[0]) @ expected, atol=1e-12)


def test_poses_at_the_times_of_images_are_kept() -> None:
    times = np.arange(8) / 10
    poses = steady(times)
    result = interpolate_poses(times, times, poses)
    np.testing.assert_allclose(result.poses, se3.inverse(poses[0]) @ poses, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 1000))
def test_interpolated_poses_are_rigid_and_the_first_is_the_origin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pose_times = np.cumsum(rng.uniform(0.02, 0.3, 12))
    poses = np.array([turned(tuple(rng.uniform(-170, 170, 3)), tuple(rng.normal(0, 5, 3))) for _ in pose_times])
    times = np.sort(rng.uniform(pose_times[0], pose_times[-1], 9))
    T = interpolate_poses(times, pose_times, poses).poses
    assert T is not None
    np.testing.assert_allclose(T[0], np.eye(4), atol=1e-9)
    np.testing.assert_allclose(T[:, :3, :3] @ T[:, :3, :3].transpose(0, 2, 1), np.tile(np.eye(3), (9, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(T[:, :3, :3]), 1.0)


def test_images_outside_of_the_measurement_are_left_out() -> None:
    times, pose_times = np.arange(20) / 10, np.arange(0.45, 1.52, 0.1)
    result = interpolate_poses(times, pose_times, steady(pose_times))
    assert result.frames == slice(5, 15)
    assert result.remark == "10 images before or after the ground truth are left out"


def test_a_pause_among_the_images_makes_the_truth_unknown_and_one_outside_does_not() -> None:
    pose_times = np.concatenate([np.arange(0, 1, 0.1), np.arange(1, 2, 0.1) + MAX_GAP_S])
    within = interpolate_poses(np.arange(0.2, 2.0, 0.1), pose_times, steady(pose_times))
    assert within.poses is None
    assert "pauses for" in within.remark
    after = interpolate_poses(np.arange(1.6, 2.3, 0.1), pose_times, steady(pose_times))
    assert after.poses is not None


def test_ground_truth_of_another_day_is_not_used() -> None:
    result = interpolate_poses(np.arange(5.0), np.arange(5.0) + 1e6, steady(np.arange(5.0)))
    assert (result.poses, result.frames) == (None, slice(0, 5))
    assert "another time" in result.remark


@settings(max_examples=100, deadline=None)
@given(stamps=st.lists(st.integers(1, 60), min_size=1, max_size=40), seed=st.integers(0, 9))
def test_images_are_ordered_once_each_whatever_the_order_of_receipt(stamps: list[int], seed: int) -> None:
    times = np.random.default_rng(seed).permutation(stamps) / 10.0
    received = 100.0 + np.arange(len(times)) / 10.0
    order = order_timestamps(times, received)
    assert (np.diff(order.seconds) > 0).all()
    if not any("times of receipt" in remark for remark in order.remarks):
        np.testing.assert_array_equal(order.seconds, np.unique(times))
        np.testing.assert_array_equal(times[order.rows], order.seconds)
    assert bool(order.remarks) == (not np.array_equal(order.rows, np.arange(len(times))) or order.seconds[0] >= 100.0)
