"""The window finds poses from exact tracks, uses all of its frames, and forgets what has left it."""

import numpy as np
import pytest

from odometry import se3
from odometry.stereo.sliding_window import SlidingWindow, StereoFrameObservations, WindowConfig
from odometry.stereo.stereo_self_calibration import Calibration, CalibrationConfig

STEP = se3.exp(np.array([0.002, 0.015, -0.001, 0.03, -0.01, 0.8]))


@pytest.fixture
def calibration(camera):
    return Calibration.unknown(camera, CalibrationConfig())


def poses(count):
    return [np.linalg.matrix_power(STEP, k) for k in range(count)]


def sightings(camera, count, noise_px=0.0, seed=0):
    """What each frame of a drive past random points shows; the error of a track grows from frame to frame."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-12, -3, 5], [12, 3, 40], (300, 3))
    drift, frames = np.zeros((300, 2)), []
    for T in poses(count):
        seen = camera.project(se3.transform(se3.inverse(T), points))
        visible = np.isfinite(seen).all(axis=1) & (seen[:, 0] > 0) & (seen[:, 0] < camera.width)
        drift += rng.normal(0, noise_px, drift.shape) if noise_px else 0.0
        left = seen[:, [0, 2]] + drift
        right = left - np.stack([seen[:, 0] - seen[:, 1], np.zeros(300)], axis=1)
        right[:, 0] += rng.normal(0, noise_px, 300) if noise_px else 0.0
        frames.append(StereoFrameObservations(np.flatnonzero(visible), left[visible], right[visible]))
    return frames


def off(T):
    return se3.log(se3.inverse(STEP) @ T)


def test_exact_tracks_give_exact_poses_from_a_poor_start(camera, calibration):
    window = SlidingWindow(WindowConfig(max_frames=4, iterations=8))
    first, *others = sightings(camera, 7)
    window.restart(first)
    poor = STEP @ se3.exp(np.array([0.003, -0.004, 0.002, 0.02, -0.02, 0.05]))
    for sighted in others:
        refined = window.refine(sighted, poor, calibration)
        # Each answer continues the pose that was given for the frame before, so errors would add up.
        np.testing.assert_allclose(off(refined), 0.0, atol=1e-6)


def test_what_two_views_got_wrong_is_mended(camera, calibration):
    errors = {"said": [], "refined": []}
    for seed in range(6):
        window, rng = SlidingWindow(), np.random.default_rng(seed)
        first, *others = sightings(camera, 9, noise_px=0.1, seed=seed)
        window.restart(first)
        for sighted in others:
            said = STEP @ se3.exp(rng.normal(0, [2e-3] * 3 + [2e-2] * 3))
            errors["said"].append(np.linalg.norm(off(said)))
            errors["refined"].append(np.linalg.norm(off(window.refine(sighted, said, calibration))))
    assert np.median(errors["refined"]) < 0.5 * np.median(errors["said"])


def test_tracks_of_another_car_do_not_pull_the_window(camera, calibration):
    window = SlidingWindow(WindowConfig(max_frames=4, iterations=8))
    first, *others = sightings(camera, 6)
    window.restart(first)
    for k, sighted in enumerate(others):
        left, right = sighted.left.copy(), sighted.right.copy()
        left[::5] += 6.0 * (k + 1)
        right[::5] += 6.0 * (k + 1)
        refined = window.refine(StereoFrameObservations(sighted.ids, left, right), STEP, calibration)
        np.testing.assert_allclose(off(refined), 0.0, atol=1e-3)


def test_without_common_points_two_views_have_the_last_word(camera, calibration):
    window = SlidingWindow()
    first, second = sightings(camera, 2)
    window.restart(first)
    strangers = StereoFrameObservations(second.ids + 1000, second.left, second.right)
    np.testing.assert_allclose(window.refine(strangers, STEP, calibration), STEP, atol=1e-12)


def test_the_answer_depends_on_no_frame_that_has_left_the_window(camera, calibration):
    frames = sightings(camera, 10, noise_px=0.1)
    answers = []
    for first in (0, 3):
        window = SlidingWindow(WindowConfig(max_frames=3, iterations=25))
        window.restart(frames[first])
        for sighted in frames[first + 1 :]:
            answer = window.refine(sighted, STEP, calibration)
        answers.append(answer)
    np.testing.assert_allclose(*answers, atol=2e-3)
