"""One camera on a world with exact truth, on real drives, and through what can go wrong. Scale is free."""

import cv2
import numpy as np
import pytest

from odometry import MonoOdometry, MonoOdometryConfig, se3

from ..stereo.test_stereo_odometry import assert_finite, blank, chained, noise


def tracked(camera, images, times=None):
    odometry = MonoOdometry(camera)
    return [odometry.track(image, time) for image, time in zip(images, times or [None] * len(images), strict=True)]


def lefts(pairs):
    return [left for left, _ in pairs]


def unit_of(motions, truth):
    """Length of a metre in the unit of the motions, by both paths (N, 4, 4), and the error of the last pose."""
    poses, truth = chained(motions), se3.inverse(truth[0]) @ truth
    distances = [np.linalg.norm(np.diff(each[:, :3, 3], axis=0), axis=1).sum() for each in (poses, truth)]
    unit = distances[0] / distances[1]
    return unit, np.linalg.norm(poses[-1][:3, 3] / unit - truth[-1][:3, 3]) / distances[1]


@pytest.fixture(scope="module")
def true_poses(drive, motion_true):
    return np.array([np.linalg.matrix_power(motion_true, k) for k in range(len(drive))])


def test_a_simulated_drive_is_measured_up_to_one_scale(camera, drive, motion_true, true_poses):
    motions = tracked(camera, lefts(drive))
    assert_finite(motions)
    unit, error = unit_of(motions, true_poses)
    assert error < 0.01
    assert not any(m.predicted for m in motions[3:])
    for motion in motions[4:]:
        off = se3.log(se3.inverse(motion_true) @ motion.T_previous_current)
        assert np.linalg.norm(off[:3]) < 1e-3
        distance = np.linalg.norm(motion.T_previous_current[:3, 3]) / np.linalg.norm(motion_true[:3, 3])
        assert distance == pytest.approx(unit, rel=0.02)


def test_depth_of_any_pixels_agrees_with_the_world(camera, drive, true_poses):
    odometry = MonoOdometry(camera)
    motions = [odometry.track(left) for left in lefts(drive)]
    unit, _ = unit_of(motions, true_poses)
    rng = np.random.default_rng(3)
    pixels = rng.uniform([20, 20], [camera.width - 20, camera.height - 20], (400, 2))
    depths = odometry.depths(drive[-1][0], pixels)
    sure = depths.baseline > 0.1 * unit
    assert sure.sum() > 50
    metres = 1 / depths.inverse[sure] / unit
    rays = np.column_stack([(pixels[sure] - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(sure.sum())])
    z = se3.transform(true_poses[-1], metres[:, None] * rays)[:, 2]
    panels = np.array([11.0, 14.0, 16.0, 17.0, 20.0, 26.0, 60.0])
    assert np.median(np.abs(z[:, None] / panels - 1).min(axis=1)) < 0.03
    near = np.abs(z - 11.0) < 1.5  # the nearest panel: 2.2 m to each side of (4.5, 2)
    x, y = se3.transform(true_poses[-1], metres[near, None] * rays[near])[:, :2].T
    assert near.sum() > 5
    assert np.mean((np.abs(x - 4.5) < 2.4) & (np.abs(y - 2.0) < 2.4)) > 0.9


def test_standing_still_is_measured_and_waits_for_a_first_step(camera, drive, true_poses):
    motions = tracked(camera, [drive[0][0]] * 3 + lefts(drive[1:]))
    assert_finite(motions)
    assert not any(m.predicted for m in motions[:3])
    assert all(np.abs(se3.log(m.T_previous_current)).max() < 1e-6 for m in motions[:3])
    assert not motions[-1].predicted
    _, error = unit_of(motions[2:], true_poses)
    assert error < 0.02


def test_standing_still_later_is_measured_as_standing_still(camera, drive):
    motions = tracked(camera, lefts(drive[:5]) + [drive[4][0]] * 4)
    assert not any(m.predicted for m in motions[5:])
    assert max(np.abs(se3.log(m.T_previous_current)).max() for m in motions[5:]) < 1e-3


def test_turning_on_the_spot_is_measured_and_shows_no_depth(camera, world):
    poses = [se3.exp(np.array([0.0, 0.02 * k, 0.0, 0.0, 0.0, 0.0])) for k in range(5)]
    odometry = MonoOdometry(camera)
    motions = [odometry.track(world.pair(T)[0]) for T in poses]
    assert_finite(motions)
    assert not any(m.predicted for m in motions)
    T = chained(motions)[-1]
    assert se3.angle(se3.inverse(poses[-1]) @ T) < 1e-3
    assert not T[:3, 3].any()
    assert np.isnan(odometry.depths(world.pair(poses[-1])[0], np.full((3, 2), 100.0)).inverse).all()


@pytest.mark.parametrize("fault", ["black", "white", "noise"])
@pytest.mark.parametrize("length", [1, 3])
def test_bad_images_are_bridged_and_the_distance_is_kept(camera, drive, true_poses, fault, length):
    bad = {"black": blank(camera, 0), "white": blank(camera, 255), "noise": noise(camera, 1)}[fault]
    images = lefts(drive)
    motions = tracked(camera, images[:5] + [bad] * length + images[5 + length :])
    assert_finite(motions)
    assert all(m.predicted for m in motions[5 : 5 + length])
    assert not motions[-1].predicted
    _, error = unit_of(motions, true_poses)
    assert error < 0.02


def test_dropped_images_are_one_long_motion(camera, drive, motion_true, true_poses):
    images, times = lefts(drive), [0.1 * k for k in range(len(drive))]
    motions = tracked(camera, images[:5] + images[7:], times[:5] + times[7:])
    assert not motions[5].predicted
    kept = np.concatenate([true_poses[:5], true_poses[7:]])
    _, error = unit_of(motions, kept)
    assert error < 0.02


def test_a_map_that_is_lost_for_good_begins_again_at_the_speed_before(camera, drive, world, motion_true):
    """A cut in the recording: what comes after shows nothing of what was before, and drives as fast."""
    elsewhere = type(world)(camera, seed=11)
    after = [elsewhere.pair(np.linalg.matrix_power(motion_true, k))[0] for k in range(6)]
    motions = tracked(camera, lefts(drive[:6]) + after)
    assert_finite(motions)
    assert motions[6].predicted
    assert not motions[-1].predicted
    distances = [np.linalg.norm(m.T_previous_current[:3, 3]) for m in motions]
    assert distances[-1] == pytest.approx(distances[5], rel=0.1)


def test_a_lens_that_distorts_is_learned_in_a_bend(camera, world, motion_true):
    """Radial distortion of 8 pixels at 45 degrees, put into the images by resampling."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=np.float64), np.arange(camera.height, dtype=np.float64))
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    maps = [(a + -8.0 * (x * x + y * y) * b).astype(np.float32) for a, b in ((u, x), (v, y))]
    bend = se3.exp(np.array([0.0, 0.03, 0.0, 0.05, 0.0, 0.4]))
    odometry = MonoOdometry(camera)
    for k in range(12):
        image = world.pair(np.linalg.matrix_power(bend, k))[0]
        odometry.track(cv2.remap(image, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE))
    assert -14.0 < odometry.bundle.lens.coefficients[0] < -3.0


@pytest.mark.parametrize("name", ["05", "06"])
def test_real_drives_are_followed_up_to_one_scale(clip, name):
    camera, pairs, truth = clip(name)
    motions = tracked(camera, lefts(pairs))
    assert_finite(motions)
    assert sum(m.predicted for m in motions) <= 3
    poses, truth = chained(motions), se3.inverse(truth[0]) @ truth
    unit, _ = unit_of(motions, truth)
    error = np.linalg.norm(poses[:, :3, 3] / unit - truth[:, :3, 3], axis=1).max()
    distance = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1).sum()
    assert error < 0.02 * distance
    halves = [unit_of(part, where)[0] for part, where in ((motions[:31], truth[:31]), (motions[31:], truth[30:]))]
    assert halves[0] == pytest.approx(unit, rel=0.03)


def test_the_same_images_give_the_same_bits_with_any_number_of_threads(camera, drive):
    results = []
    for threads in (1, 2):
        before = cv2.getNumThreads()
        cv2.setNumThreads(threads)
        results.append(chained(tracked(camera, lefts(drive))))
        cv2.setNumThreads(before)
    np.testing.assert_array_equal(*results)


def test_the_window_does_not_grow_with_the_drive(camera, drive):
    odometry = MonoOdometry(camera)
    there_and_back = lefts(drive) + lefts(drive)[-2::-1]
    for image in there_and_back * 2:
        odometry.track(image)
    assert len(odometry.bundle.poses) <= 12
    assert len(odometry.bundle.points) < 12 * 450


def test_an_image_of_another_size_is_refused(camera):
    with pytest.raises(ValueError, match=r"expected an image of \(224, 512\) uint8 as the camera says, got \(10, 10\)"):
        MonoOdometry(camera).track(np.zeros((10, 10), np.uint8))


@pytest.mark.parametrize("name", ["05", "06"])
def test_the_height_above_the_road_gives_metres(clip, name):
    camera, pairs, truth = clip(name, 40)
    odometry = MonoOdometry(camera, MonoOdometryConfig(camera_height_m=1.65))
    motions = [odometry.track(left) for left, _ in pairs]
    unit, _ = unit_of(motions, truth)
    assert unit == pytest.approx(1.0, abs=0.08)


def test_a_truck_ahead_that_keeps_its_distance_is_not_followed(camera, world):
    """It looks infinitely far away, from where no motion is seen: the distance goes on, not the truck."""
    ahead = se3.exp(np.array([0.0, 0.0, 0.0, 0.03, -0.01, 0.4]))
    truth = np.array([np.linalg.matrix_power(ahead, k) for k in range(15)])
    images = [world.pair(T)[0] for T in truth]
    truck = cv2.normalize(cv2.GaussianBlur(noise(camera, 5), (0, 0), 2.0), None, 20, 235, cv2.NORM_MINMAX)
    rows, columns = slice(10, camera.height - 10), slice(camera.width // 8, 7 * camera.width // 8)
    for image in images[6:9]:
        image[rows, columns] = truck[rows, columns]
    motions = tracked(camera, images)
    assert_finite(motions)
    assert not motions[-1].predicted
    unit, _ = unit_of(motions[:6], truth[:6])
    assert np.linalg.norm(chained(motions)[-1][:3, 3] / unit - truth[-1][:3, 3]) < 0.1 * truth[-1][2, 3]


def test_scale_survives_a_turn_on_the_spot(camera, world, motion_true):
    turn, poses = se3.exp(np.array([0.0, -0.02, 0.0, 0.0, 0.0, 0.0])), [np.eye(4)]
    for k in range(16):
        poses.append(poses[-1] @ (turn if 6 <= k < 11 else motion_true))
    motions = tracked(camera, [world.pair(T)[0] for T in poses])
    distances = np.array([np.linalg.norm(m.T_previous_current[:3, 3]) for m in motions])
    assert distances[7:12].max() < 0.01 * distances[6]
    np.testing.assert_allclose(distances[12:], distances[6], rtol=0.05)
