"""Descriptors associate what following cannot reach."""

import numpy as np

from odometry import se3
from odometry.stereo.stereo_matching import StereoMatchingConfig
from odometry.stereo.stereo_self_calibration import Calibration, CalibrationConfig
from odometry.stereo.stereo_tracking import match_descriptors
from odometry.stereo.two_view_adjustment import estimate_motion, ransac_motion


def test_pairs_several_images_apart_are_associated(camera, drive, motion_true):
    tracks = match_descriptors(drive[0], drive[6], StereoMatchingConfig())
    assert len(tracks) > 30
    assert np.all(tracks.ids == -1)
    known = Calibration.unknown(camera, CalibrationConfig(0.01, 0.01, 0.01, 0.01, 0.01))
    guess = ransac_motion(tracks, known)
    estimate = estimate_motion(tracks, known, guess)
    off = se3.log(se3.inverse(np.linalg.matrix_power(motion_true, 6)) @ estimate.T_first_second)
    assert np.linalg.norm(off[3:]) < 0.05


def test_an_image_without_texture_is_associated_with_nothing(drive):
    blank = (np.zeros_like(drive[0][0]),) * 2
    assert len(match_descriptors(drive[0], blank, StereoMatchingConfig())) == 0
    assert len(match_descriptors(blank, drive[0], StereoMatchingConfig())) == 0
