"""A pair is tracked by optical flow, and by descriptors where optical flow cannot reach."""

import numpy as np
import pytest

from odometry import se3
from odometry.klt_tracking import TrackingConfig
from odometry.motion_checks import MotionCheckConfig, MotionPrediction
from odometry.stereo.second_view import RightImage
from odometry.stereo.stereo_frontend import StereoFrontEnd
from odometry.stereo.stereo_self_calibration import Calibration, CalibrationConfig
from odometry.stereo.stereo_tracking import SWAPPED, StereoTracker, match_descriptors
from odometry.stereo.two_view_adjustment import AdjustmentConfig, estimate_motion, ransac_motion


def test_pairs_several_images_apart_are_associated(camera, drive, motion_true):
    tracks = match_descriptors(drive[0], drive[6], RightImage())
    assert len(tracks) > 30
    assert np.all(tracks.ids == -1)
    known = Calibration.unknown(camera, CalibrationConfig(0.01, 0.01, 0.01, 0.01, 0.01))
    guess = ransac_motion(tracks, known)
    estimate = estimate_motion(tracks, known, guess)
    off = se3.log(se3.inverse(np.linalg.matrix_power(motion_true, 6)) @ estimate.T_first_second)
    assert np.linalg.norm(off[3:]) < 0.05


def test_an_image_without_texture_is_associated_with_nothing(drive):
    blank = (np.zeros_like(drive[0][0]),) * 2
    assert len(match_descriptors(drive[0], blank, RightImage())) == 0
    assert len(match_descriptors(blank, drive[0], RightImage())) == 0


@pytest.fixture
def tracker():
    front_end = StereoFrontEnd(TrackingConfig(), RightImage())
    return front_end, StereoTracker(front_end, AdjustmentConfig(), MotionCheckConfig())


def test_the_next_pair_is_followed_with_and_without_a_prediction(camera, drive, motion_true, tracker):
    front_end, stereo = tracker
    view, unknown = front_end.observe(drive[0]), Calibration.unknown(camera, CalibrationConfig(0.01, 0.01, 0.01, 0.01))
    for predicted in (None, MotionPrediction(motion_true)):
        result = stereo.track(view, drive[1], predicted, unknown)
        assert result.reason is None
        assert result.followed
        off = se3.log(se3.inverse(motion_true) @ result.estimate.T_first_second)
        assert np.linalg.norm(off[3:]) < 0.02


def test_a_pair_too_far_away_to_follow_is_matched_by_descriptors(camera, drive, motion_true, tracker):
    front_end, stereo = tracker
    unknown = Calibration.unknown(camera, CalibrationConfig(0.01, 0.01, 0.01, 0.01))
    result = stereo.track(front_end.observe(drive[0]), drive[6], None, unknown)
    assert result.reason is None
    off = se3.log(se3.inverse(np.linalg.matrix_power(motion_true, 6)) @ result.estimate.T_first_second)
    assert np.linalg.norm(off[3:]) < 0.1


def test_swapped_images_and_blank_images_are_rejected_with_their_reason(camera, drive, tracker):
    front_end, stereo = tracker
    view, unknown = front_end.observe(drive[0]), Calibration.unknown(camera, CalibrationConfig())
    assert stereo.track(view, drive[1][::-1], None, unknown).reason == SWAPPED
    blank = stereo.track(view, (np.zeros_like(drive[0][0]),) * 2, None, unknown)
    assert blank.estimate is None
    assert "could be followed" in blank.reason
