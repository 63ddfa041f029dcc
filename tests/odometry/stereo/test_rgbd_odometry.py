"""The odometry of a depth camera on a world with exact truth, and through everything that can go wrong."""

import cv2
import numpy as np
import pytest

from odometry import se3
from odometry.stereo.depth_view import DepthView, DepthViewConfig
from odometry.stereo.rgbd_odometry import RgbdOdometry, RgbdOdometryConfig


def tracked(camera, frames, config=None):
    odometry = RgbdOdometry(camera, config)
    return [odometry.track(image, depth) for image, depth in frames]


def chained(motions):
    poses = [np.eye(4)]
    for motion in motions[1:]:
        poses.append(poses[-1] @ motion.T_previous_current)
    return np.array(poses)


def end_error(motions, step):
    """Error of the last position over the distance."""
    truth = np.linalg.matrix_power(step, len(motions) - 1)
    distance = np.linalg.norm(step[:3, 3]) * (len(motions) - 1)
    return np.linalg.norm(chained(motions)[-1][:3, 3] - truth[:3, 3]) / distance


def assert_finite(motions):
    for motion in motions:
        assert np.isfinite(motion.T_previous_current).all()
        assert np.linalg.eigvalsh(motion.covariance).min() > 0
        assert motion.predicted == bool(motion.reason)


def without_depth(frame):
    return frame[0], np.full_like(frame[1], np.nan)


def test_a_simulated_drive_is_measured_to_a_hundredth(camera, depth_drive, motion_true):
    motions = tracked(camera, depth_drive)
    assert_finite(motions)
    assert not any(m.predicted for m in motions)
    assert end_error(motions, motion_true) < 0.005


@pytest.mark.parametrize("factor", [0.95, 1.05])
def test_the_depth_gives_the_scale(camera, depth_drive, motion_true, factor):
    frames = [(image, depth * np.float32(factor)) for image, depth in depth_drive]
    distance = np.linalg.norm(chained(tracked(camera, frames))[-1][:3, 3])
    true = np.linalg.norm(np.linalg.matrix_power(motion_true, 9)[:3, 3])
    assert distance / true == pytest.approx(factor, abs=0.01)


def test_depths_that_are_too_far_off_the_image_are_worse(camera, depth_drive, motion_true):
    """Control: a depth image shifted by thirty pixels costs accuracy."""
    shifted = [(image, np.roll(depth, 30, axis=1)) for image, depth in depth_drive]
    good, bad = (end_error(tracked(camera, frames), motion_true) for frames in (depth_drive, shifted))
    assert bad > 2 * good


def test_errors_are_about_as_large_as_the_covariance_says(camera, depth_drive, motion_true):
    errors = [
        (se3.log(se3.inverse(m.T_previous_current) @ motion_true), m.covariance)
        for m in tracked(camera, depth_drive)[1:]
    ]
    mean = np.mean([e @ np.linalg.solve(covariance, e) for e, covariance in errors])
    assert 0.1 < mean < 12.0  # the covariance is nine times that of points which err independently


class PointsWithDepth(DepthView):
    """Control: points without depth are left out."""

    def are_usable(self, places):
        return np.isfinite(places[:, 0])


def test_points_without_depth_measure_rotation(world, camera, motion_true):
    turn = se3.exp(np.array([0.0, 0.02, 0.0, 0.0, 0.0, 0.05]))
    frames = []
    for k in range(8):
        image, depth = world.frame(np.linalg.matrix_power(turn, k), seed=k)
        depth[:, 80:] = np.nan
        frames.append((image, depth))
    errors = []
    for view in (DepthView(camera), PointsWithDepth(camera)):
        odometry = RgbdOdometry(camera)
        odometry._second_view = odometry._front_end.second_view = view
        motions = [odometry.track(*frame) for frame in frames]
        assert not any(m.predicted for m in motions)
        off = [se3.log(se3.inverse(turn) @ m.T_previous_current)[:3] for m in motions[1:]]
        errors.append(np.sqrt(np.mean(np.square(off))))
    assert errors[0] < 0.8 * errors[1]


def test_without_any_depth_the_motion_is_predicted_and_the_reason_says_so(camera, depth_drive):
    motions = tracked(camera, [without_depth(frame) for frame in depth_drive[:4]])
    assert_finite(motions)
    assert not motions[0].predicted
    assert all(m.predicted and "have a depth" in m.reason for m in motions[1:])


def test_a_start_without_depth_recovers(camera, depth_drive, motion_true):
    motions = tracked(camera, [*map(without_depth, depth_drive[:2]), *depth_drive[2:]])
    assert [m.predicted for m in motions] == [False, True, True, *[False] * 7]
    step = motions[-1].T_previous_current
    assert np.linalg.norm(step[:3, 3] - motion_true[:3, 3]) < 0.02


def test_a_missing_depth_image_is_measured_from_the_depth_before(camera, depth_drive, motion_true):
    frames = [without_depth(frame) if k in (4, 5) else frame for k, frame in enumerate(depth_drive)]
    motions = tracked(camera, frames)
    assert not any(m.predicted for m in motions)
    assert end_error(motions, motion_true) < 0.01


def test_standing_still_is_measured_as_standing_still(camera, depth_drive):
    motions = tracked(camera, [depth_drive[0]] * 4)
    assert not any(m.predicted for m in motions)
    assert max(np.abs(se3.log(m.T_previous_current)).max() for m in motions) < 1e-4


@pytest.mark.parametrize("fault", ["black", "noise"])
def test_bad_images_are_bridged_and_the_distance_is_kept(camera, depth_drive, motion_true, fault):
    noise = np.random.default_rng(1).integers(0, 256, (camera.height, camera.width), dtype=np.uint8)
    image = np.zeros_like(noise) if fault == "black" else noise
    frames = [(image, depth) if k == 4 else (left, depth) for k, (left, depth) in enumerate(depth_drive)]
    motions = tracked(camera, frames)
    assert_finite(motions)
    assert [k for k, m in enumerate(motions) if m.predicted] == [4]
    assert end_error(motions, motion_true) < 0.015


@pytest.mark.parametrize("wrong", ["shape", "type", "image"])
def test_images_that_are_not_the_cameras_are_refused(camera, depth_drive, wrong):
    image, depth = depth_drive[0]
    frames = {
        "shape": (image, depth[:, :100]),
        "type": (image, depth.astype(np.uint16)),
        "image": (image[:50], depth),
    }
    with pytest.raises(ValueError, match=r"expected the (left|depth) image to be .* as the camera says, got"):
        RgbdOdometry(camera).track(*frames[wrong])


def test_two_runs_agree_to_the_last_bit_on_any_number_of_threads(camera, depth_drive):
    threads = cv2.getNumThreads()
    try:
        runs = []
        for count in (1, 2):
            cv2.setNumThreads(count)
            runs.append(tracked(camera, depth_drive))
    finally:
        cv2.setNumThreads(threads)
    for one, other in zip(*runs, strict=True):
        np.testing.assert_array_equal(one.T_previous_current, other.T_previous_current)
        np.testing.assert_array_equal(one.covariance, other.covariance)


def test_the_callers_buffers_may_be_used_again(camera, depth_drive):
    buffers = [image.copy() for image in depth_drive[0]]
    odometry, motions = RgbdOdometry(camera), []
    for frame in depth_drive:
        for buffer, image in zip(buffers, frame, strict=True):
            buffer[:] = image
        motions.append(odometry.track(*buffers))
    for one, other in zip(motions, tracked(camera, depth_drive), strict=True):
        np.testing.assert_array_equal(one.T_previous_current, other.T_previous_current)


def test_the_disparity_of_the_frame_is_read_and_nothing_is_learned(camera, depth_drive):
    odometry = RgbdOdometry(camera)
    for frame in depth_drive:
        odometry.track(*frame)
    assert not odometry.calibration.coefficients.any()
    pixels = np.random.default_rng(0).uniform([20, 20], [490, 200], (100, 2))
    image, depth = depth_drive[-1]
    expected = DepthView(camera).read(depth, pixels)
    np.testing.assert_allclose(odometry.disparity(image, depth, pixels), expected, atol=1e-9)


def test_the_weight_of_the_depth_follows_its_noise(world, camera, motion_true):
    """Control: a depth that is believed too much drags the motion along."""
    frames = [world.frame(np.linalg.matrix_power(motion_true, k), 3.0, k) for k in range(8)]
    coarse = DepthViewConfig(max_residual_px=10.0)
    trusted = DepthViewConfig(max_residual_px=10.0, disparity_weight=50.0)
    errors = [
        end_error(tracked(camera, frames, RgbdOdometryConfig(depth=depth)), motion_true) for depth in (coarse, trusted)
    ]
    assert errors[0] < errors[1]


def test_drift_is_taken_back_where_the_camera_comes_back(world, camera):
    there_and_back = [*range(7), *range(6)[::-1]]
    poses = [se3.exp(k * np.array([0.0, 0.06, 0.0, 0.05, 0.0, 0.0])) for k in there_and_back]
    frames = [world.frame(T, 0.3, seed) for seed, T in enumerate(poses)]
    errors = []
    for count in (16, 0):
        config = RgbdOdometryConfig(max_earlier_references=count, reference_rotation_rad=0.07)
        motions = tracked(camera, frames, config)
        assert_finite(motions)
        assert not any(m.predicted for m in motions)
        errors.append(np.linalg.norm(chained(motions)[-1][:3, 3]))
    assert errors[0] < 0.7 * errors[1]


def test_images_that_motion_has_blurred_are_measured(camera, depth_drive, motion_true):
    frames = [
        (cv2.blur(image, (15, 1)), depth) if k in (3, 4) else (image, depth)
        for k, (image, depth) in enumerate(depth_drive)
    ]
    motions = tracked(camera, frames)
    assert_finite(motions)
    assert not any(m.predicted for m in motions)
    assert end_error(motions, motion_true) < 0.02
