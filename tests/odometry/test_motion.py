"""Gaps in the time stamps are counted in images."""

import pytest

from odometry.motion import FrameCounter


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
