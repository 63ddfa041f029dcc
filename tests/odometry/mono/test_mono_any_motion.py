"""One camera that turns on the spot, stands, looks back, and starts again: what is measured, and what is said."""

import copy

import numpy as np
import pytest

from odometry import MonoOdometry, se3
from odometry.camera import StereoCamera
from odometry.mono.mono_config import MonoOdometryConfig
from odometry.mono.motion_only_bundle_adjustment import PoseEstimate
from odometry.motion_checks import MotionPrediction

AHEAD = se3.exp(np.array([0.002, 0.004, -0.001, 0.03, -0.01, 0.4]))


def turn(angle_rad):
    return se3.exp(np.array([0.0, angle_rad, 0.0, 0.0, 0.0, 0.0]))


def chain(steps):
    poses = [np.eye(4)]
    for step in steps:
        poses.append(poses[-1] @ step)
    return poses


def track(camera, world, poses):
    odometry = MonoOdometry(camera)
    return [odometry.track(world.pair(T)[0]) for T in poses]


def length(motion):
    return float(np.linalg.norm(motion.T_previous_current[:3, 3]))


def test_turning_away_from_all_known_depths_and_back_keeps_the_scale(camera, world):
    """The image is 72 degrees wide: after 63 degrees to the side little is left of what had depth."""
    away = [turn(0.055)] * 20
    poses = chain([AHEAD] * 8 + away + [turn(-0.055)] * 20 + [AHEAD] * 6)
    motions = track(camera, world, poses)
    assert not any(m.predicted for m in motions[4:])
    before = np.mean([length(m) for m in motions[5:9]])
    after = np.mean([length(m) for m in motions[-4:]])
    assert after == pytest.approx(before, rel=0.05)
    assert sum(length(m) for m in motions[9:49]) < 0.03 * before
    T = chain([m.T_previous_current for m in motions[1:]])[-1]
    assert se3.angle(se3.inverse(poses[-1]) @ T) < 5e-3


def test_reference_frames_of_a_slow_turn_keep_a_baseline(camera, world):
    """The window is full before the turn ends: frames with little parallax leave, and the first one stays."""
    step = se3.pose(turn(0.025)[:3, :3], np.array([0.12, 0.0, 0.12]))
    odometry = MonoOdometry(camera)
    for T in chain([AHEAD] * 6 + [step] * 24):
        odometry.track(world.pair(T)[0])
    numbers = odometry.bundle.numbers
    assert len(numbers) == 12
    assert numbers[0] == 0
    assert numbers[-1] > 11  # no number is given again


def test_a_state_while_turned_away_goes_on_with_the_same_bits(camera, world):
    poses = chain([AHEAD] * 6 + [turn(0.055)] * 12 + [turn(-0.055)] * 12 + [AHEAD] * 2)
    images = [world.pair(T)[0] for T in poses]
    odometry, restored = MonoOdometry(camera), MonoOdometry(camera)
    for image in images[:18]:
        odometry.track(image)
    restored.restore(copy.deepcopy(odometry.state()))
    for image in images[18:]:
        one, other = odometry.track(image), restored.track(image)
        np.testing.assert_array_equal(one.T_previous_current, other.T_previous_current)
        np.testing.assert_array_equal(one.covariance, other.covariance)


def test_small_images_are_enough(world):
    small = StereoCamera(fx=110.0, fy=110.0, cx=79.5, cy=59.5, baseline=0.5, width=160, height=120)
    seen = type(world)(small, seed=3)
    motions = track(small, seen, chain([turn(0.02)] * 4 + [AHEAD] * 12 + [turn(0.02)] * 4))
    assert sum(m.predicted for m in motions) <= 2
    lengths = np.array([length(m) for m in motions[10:17]])
    assert lengths.std() < 0.1 * lengths.mean()


def test_a_lost_camera_is_found_again_in_its_own_map(camera, world):
    """It drives ahead, is covered while it goes back and turns a little, and sees again what it saw before."""
    poses = chain([AHEAD] * 16)
    covered = [np.zeros((camera.height, camera.width), np.uint8)] * 6
    aside = se3.pose(turn(0.05)[:3, :3], np.array([0.3, 0.1, 0.2]))
    images = [world.pair(T)[0] for T in poses] + covered + [world.pair(poses[6] @ aside)[0]]
    odometry = MonoOdometry(camera)
    motions = [odometry.track(image) for image in images]
    assert all(m.predicted for m in motions[17:23])
    assert not motions[-1].predicted
    estimated = chain([m.T_previous_current for m in motions[1:]])
    unit = np.linalg.norm(estimated[16][:3, 3]) / np.linalg.norm(poses[16][:3, 3])
    off = se3.inverse(poses[6] @ aside)
    T = estimated[-1].copy()
    T[:3, 3] /= unit
    assert np.linalg.norm((off @ T)[:3, 3]) < 0.15
    assert se3.angle(off @ T) < 0.01


@pytest.mark.parametrize(
    ("tracks", "angle_rad", "is_uncertain"), [(60, 0.4, True), (60, 0.01, False), (300, 0.4, False)]
)
def test_a_jump_by_few_points_is_as_uncertain_as_it_differs_from_the_prediction(
    camera, tracks, angle_rad, is_uncertain
):
    """Frames may be missing, or few points may be wrong together: loops decide which, if they can."""
    odometry = MonoOdometry(camera)
    inliers = np.ones(tracks, bool)
    measured = PoseEstimate(AHEAD @ turn(angle_rad), 1e-8 * np.eye(6), inliers, 0.2, 0.2, np.zeros(tracks))
    found = odometry._add_jump_variance(measured, MotionPrediction(AHEAD))
    deviation = np.sqrt(MonoOdometryConfig().covariance_scale * found.covariance[1, 1])
    assert deviation == pytest.approx(angle_rad if is_uncertain else 3e-4, rel=0.01)
    np.testing.assert_array_equal(found.T_first_second, measured.T_first_second)
