"""A motion is doubted for the right reason, in words."""

from dataclasses import replace

import numpy as np
import pytest

from odometry import se3
from odometry.motion_checks import (
    MotionCheckConfig,
    MotionPrediction,
    deviation_in_jumps,
    jump_reason,
    rejection_reason,
    stops_implausibly,
)
from odometry.stereo.two_view_adjustment import TwoViewEstimate

CONFIG = MotionCheckConfig()
GOOD = TwoViewEstimate(
    T_first_second=se3.exp(np.array([0, 0.01, 0, 0, 0, 1.0])),
    covariance=1e-6 * np.eye(6),
    inliers=np.arange(100) < 90,
    noise_px=0.1,
    residual_px=0.1,
    calibration=np.zeros(15),
    information=np.eye(15),
)
CONTESTED = replace(GOOD, inliers=np.arange(100) < 45)


def test_a_good_measurement_is_believed_whatever_was_expected():
    assert rejection_reason(GOOD, MotionPrediction(GOOD.T_first_second), CONFIG) is None
    assert rejection_reason(GOOD, MotionPrediction(se3.exp(np.array([0, 0, 0, 0, 0, 0.1]))), CONFIG) is None
    assert rejection_reason(GOOD, None, CONFIG) is None


@pytest.mark.parametrize(
    ("estimate", "words"),
    [
        (None, "fewer than 20 points"),
        (replace(GOOD, inliers=np.arange(250) < 30), "only 30 of 250 points agree"),
        (replace(GOOD, inliers=np.arange(18) < 18), "only 18 of 18 points agree"),
        (replace(GOOD, noise_px=3.0), "only to 3.0 px"),
        (replace(GOOD, covariance=np.full((6, 6), np.nan)), "did not converge"),
    ],
)
def test_a_weak_measurement_is_doubted(estimate, words):
    assert words in str(rejection_reason(estimate, MotionPrediction(GOOD.T_first_second), CONFIG))


def test_a_contested_measurement_is_believed_only_where_it_was_expected():
    assert rejection_reason(CONTESTED, MotionPrediction(GOOD.T_first_second), CONFIG) is None
    assert rejection_reason(CONTESTED, None, CONFIG) is None
    assert "a jump of 1.0 m" in str(rejection_reason(CONTESTED, MotionPrediction(np.eye(4)), CONFIG))
    turned = GOOD.T_first_second @ se3.exp(np.array([0, 0.2, 0, 0, 0, 0]))
    assert "11.5 degrees" in str(rejection_reason(CONTESTED, MotionPrediction(turned), CONFIG))


def test_a_minority_is_believed_only_where_it_was_expected():
    minority = replace(GOOD, inliers=np.arange(100) < 25)
    assert rejection_reason(minority, MotionPrediction(GOOD.T_first_second), CONFIG) is None
    assert "only 25 of 100 points agree" in str(rejection_reason(minority, None, CONFIG))
    assert "only 25 of 100 points agree" in str(rejection_reason(minority, MotionPrediction(np.eye(4)), CONFIG))


def moving(metres):
    return replace(GOOD, T_first_second=se3.exp(np.array([0, 0, 0, 0, 0, metres])))


def test_a_view_that_stands_still_before_a_driving_camera_is_another_car_until_brakes_could_have_stopped_it():
    driving = moving(1.0).T_first_second
    assert "does not move" in str(rejection_reason(moving(0.0), MotionPrediction(driving, unmeasured_frames=1), CONFIG))
    assert "does not move" in str(rejection_reason(moving(0.0), MotionPrediction(driving, unmeasured_frames=8), CONFIG))
    assert rejection_reason(moving(0.0), MotionPrediction(driving, unmeasured_frames=10), CONFIG) is None
    assert rejection_reason(moving(0.9), MotionPrediction(driving), CONFIG) is None


def test_a_speed_that_was_seen_only_once_says_nothing_about_brakes():
    assert rejection_reason(moving(1.0), MotionPrediction(moving(6.0).T_first_second, distance_m=1.0), CONFIG) is None
    assert "does not move" in str(rejection_reason(moving(1.0), MotionPrediction(moving(6.0).T_first_second), CONFIG))


@pytest.mark.parametrize(
    ("measured", "stops"),
    [
        ([0, 0, 0, 0, 0, 2.0], False),  # as predicted
        ([0, 0, 0, 0, 0, 0.0], True),
        ([0, 0, 0, 0, 0, 1.2], False),  # more than half of it
        ([0, 0, 0, 2.0, 0, 0.1], True),  # sideways
        ([0, 0, 0, 0, 0, -2.0], False),  # a cut in the recording
    ],
)
def test_a_stop_or_a_skid_is_implausible_and_a_cut_is_not(measured, stops):
    predicted = MotionPrediction(se3.exp(np.array([0, 0, 0, 0, 0, 2.0])))
    assert stops_implausibly(se3.exp(np.array(measured, dtype=float)), predicted, CONFIG) == stops


def test_deviations_are_measured_in_jumps():
    shifted, turned = se3.exp(np.array([0, 0, 0, 1.0, 0, 0])), se3.exp(np.array([0, 0.2, 0, 0, 0, 0]))
    assert deviation_in_jumps(shifted, np.eye(4), CONFIG) == pytest.approx(2.0)
    assert deviation_in_jumps(turned, np.eye(4), CONFIG) == pytest.approx(4.0)
    assert jump_reason(shifted, np.eye(4), CONFIG, frames=1) is not None
    assert jump_reason(shifted, np.eye(4), CONFIG, frames=3) is None  # the longer ago, the weaker the prediction
