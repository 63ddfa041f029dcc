"""An odometry that is restored from a state goes on, bit for bit, as the one that was never disturbed."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from odometry import MonoOdometry, MonoOdometryConfig, StereoOdometry
from odometry.stereo.rgbd_odometry import RgbdOdometry

CASES = ("stereo", "depth camera", "one camera", "one camera of known height")
MISSING = 6  # a pair of blank images: what was lost is part of the state
TIMES = [0.1 * k for k in range(8)] + [1.0, 1.1]  # an image is missing before the last but one


def make(camera, case):
    if case == "stereo":
        return StereoOdometry(camera)
    if case == "depth camera":
        return RgbdOdometry(camera)
    return MonoOdometry(camera, MonoOdometryConfig(camera_height_m=1.65) if "height" in case else None)


def track(odometry, pairs, begin=0):
    frames = list(zip(pairs, TIMES, strict=True))[begin:]
    if isinstance(odometry, StereoOdometry):
        return [odometry.track(*pair, time) for pair, time in frames]
    return [odometry.track(pair[0], time) for pair, time in frames]


def bits(state):
    if isinstance(state, np.ndarray | np.generic):
        return str(state.dtype), state.shape, state.tobytes()
    if isinstance(state, dict):
        return {key: bits(value) for key, value in state.items()}
    return [bits(value) for value in state] if isinstance(state, list | tuple) else repr(state)


@pytest.fixture(scope="module")
def recorded(drive, depth_drive):
    """Pairs of each case, one of them blank."""

    def read(case):
        pairs = depth_drive if case == "depth camera" else drive
        return [*pairs[:MISSING], tuple(map(np.zeros_like, pairs[MISSING])), *pairs[MISSING + 1 :]]

    return read


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("stop", [0, 1, 4, MISSING + 1])
def test_a_restored_odometry_goes_on_with_the_same_bits(camera, recorded, case, stop):
    pairs = recorded(case)
    undisturbed, stopped, restored = (make(camera, case) for _ in range(3))
    expected = track(undisturbed, pairs)
    for k in range(stop):
        pair, time = pairs[k], TIMES[k]
        _ = stopped.track(*pair, time) if isinstance(stopped, StereoOdometry) else stopped.track(pair[0], time)
    restored.restore(copy.deepcopy(stopped.state()))
    motions = track(restored, pairs, stop)
    for motion, other in zip(motions, expected[stop:], strict=True):
        np.testing.assert_array_equal(motion.T_previous_current, other.T_previous_current)
        np.testing.assert_array_equal(motion.covariance, other.covariance)
        assert (motion.predicted, motion.reason) == (other.predicted, other.reason)
    assert bits(restored.state()) == bits(undisturbed.state())


def test_depths_are_the_same_after_a_restoration(camera, drive):
    odometry, restored = MonoOdometry(camera), MonoOdometry(camera)
    for left, _ in drive:
        odometry.track(left)
    restored.restore(copy.deepcopy(odometry.state()))
    pixels = np.random.default_rng(0).uniform([20, 20], [camera.width - 20, camera.height - 20], (50, 2))
    np.testing.assert_array_equal(
        restored.depths(drive[-1][0], pixels).inverse, odometry.depths(drive[-1][0], pixels).inverse
    )


@pytest.mark.parametrize(("case", "other"), [("stereo", "one camera"), ("one camera", "stereo")])
def test_the_state_of_another_odometry_is_refused(camera, drive, case, other):
    odometry = make(camera, case)
    for pair in drive[:3]:
        _ = odometry.track(*pair) if case == "stereo" else odometry.track(pair[0])
    with pytest.raises((KeyError, TypeError, ValueError)):
        make(camera, other).restore(copy.deepcopy(odometry.state()))


def test_the_state_of_another_camera_is_refused(camera, drive):
    odometry = StereoOdometry(camera)
    odometry.track(*drive[0])
    with pytest.raises(ValueError, match="as the camera says"):
        StereoOdometry(replace(camera, width=400)).restore(copy.deepcopy(odometry.state()))
