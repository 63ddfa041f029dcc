"""Gaps in the time stamps are counted in images."""

import numpy as np
import pytest

from odometry.motion import FrameCounter, Motion, extrapolation_covariance


def counted(stamps):
    ticks = FrameCounter()
    return [ticks.frames_since_last(stamp) for stamp in stamps]


def test_regular_images_are_one_apart_despite_jitter():
    assert counted([0.0, 0.1, 0.21, 0.3, 0.398]) == [1, 1, 1, 1, 1]


def test_a_gap_counts_the_images_that_are_missing():
    assert counted([0.0, 0.1, 0.2, 0.8, 0.9]) == [1, 1, 1, 6, 1]


def test_a_gap_does_not_change_what_is_usual():
    assert counted([0.0, 0.1, 3.1, 3.2, 3.5]) == [1, 1, 30, 1, 3]


@pytest.mark.parametrize("stamp", [None, float("nan"), 0.2, -5.0])
def test_stamps_that_say_nothing_count_as_one_image(stamp):
    assert counted([0.0, 0.1, 0.2, stamp]) == [1, 1, 1, 1]


def test_the_interval_is_the_usual_one_and_a_tenth_where_unknown():
    ticks = FrameCounter()
    assert ticks.interval_s == pytest.approx(0.1)
    for stamp in (0.0, 0.5, 1.0, 2.0):
        ticks.frames_since_last(stamp)
    assert ticks.interval_s == pytest.approx(0.5)


def test_an_image_that_was_not_measured_is_the_less_certain_the_longer_ago_the_last_measurement_is():
    once, thrice = (extrapolation_covariance(0.02, 0.2, images) for images in (1, 3))
    np.testing.assert_allclose(np.sqrt(np.diag(once)), [0.02] * 3 + [0.2] * 3)
    np.testing.assert_allclose(thrice, 9 * once)


def test_a_counter_that_is_restored_counts_on():
    stamps = [0.0, 0.1, 0.2, 0.7, 0.8, 1.3]
    first, second = FrameCounter(), FrameCounter()
    for stamp in stamps[:3]:
        first.frames_since_last(stamp)
    second.restore(first.state())
    rest = [(first.frames_since_last(stamp), second.frames_since_last(stamp)) for stamp in stamps[3:]]
    assert rest == [(5, 5), (1, 1), (5, 5)]
    assert first.interval_s == second.interval_s


def test_a_motion_without_tracks_has_empty_arrays():
    motion = Motion(np.eye(4), np.eye(6), True, "dark")
    assert motion.pixels_previous.shape == motion.pixels_current.shape == (0, 2)
    assert motion.inliers.shape == (0,)
    assert np.isnan(motion.residual_px)
