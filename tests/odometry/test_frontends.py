"""Both front ends number their tracks, keep the points of before, and follow points to where they are."""

import cv2
import numpy as np
import pytest

from odometry import se3
from odometry.camera import StereoCamera
from odometry.klt_tracking import TrackingConfig
from odometry.mono.mono_frontend import MonoFrontEnd
from odometry.stereo.second_view import RightImage
from odometry.stereo.sliding_window import StereoFrameObservations
from odometry.stereo.stereo_frontend import StereoFrontEnd
from odometry.stereo.stereo_odometry import StereoOdometry
from odometry.stereo.stereo_self_calibration import Calibration, CalibrationConfig


@pytest.fixture
def stereo():
    return StereoFrontEnd(TrackingConfig(), RightImage())


@pytest.fixture
def mono():
    return MonoFrontEnd(TrackingConfig())


def test_every_stereo_track_has_a_number_of_its_own(stereo, drive):
    first, second = (stereo.observe(pair).points for pair in drive[:2])
    numbers = np.concatenate([first.ids, second.ids])
    np.testing.assert_array_equal(numbers, np.arange(len(numbers)))


def test_points_that_are_kept_come_first_and_stay_as_they_are(stereo, drive):
    points = stereo.observe(drive[0]).points
    kept = StereoFrameObservations(points.ids[:50], points.left[:50], points.right[:50])
    topped = stereo.observe(drive[0], kept).points
    assert len(topped.ids) > 100
    for name in ("ids", "left", "right"):
        np.testing.assert_array_equal(getattr(topped, name)[:50], getattr(kept, name))
    assert topped.ids[50] == points.ids[-1] + 1


def test_an_observation_keeps_its_images_when_the_caller_uses_its_buffers_again(stereo, mono, drive):
    left, right = (image.copy() for image in drive[0])
    view, tracks = stereo.observe((left, right)), mono.observe(left)
    left[:], right[:] = 0, 0
    np.testing.assert_array_equal(view.pair[0], drive[0][0])
    np.testing.assert_array_equal(view.pair[1], drive[0][1])
    np.testing.assert_array_equal(tracks.image, drive[0][0])


def test_stereo_points_are_found_where_the_motion_puts_them(stereo, drive, camera, motion_true):
    calibration = Calibration.unknown(camera, CalibrationConfig())
    view = stereo.observe(drive[0])
    tracks = stereo.follow(view, drive[1], motion_true, calibration)
    assert len(tracks) > 0.7 * len(view.points.ids)
    points = camera.triangulate(tracks.first_left, tracks.first_left[:, 0] - tracks.first_right[:, 0])
    expected = camera.project(se3.transform(se3.inverse(motion_true), points))
    assert np.median(np.abs(expected[:, [0, 2]] - tracks.second_left)) < 0.3
    assert np.median(np.abs(expected[:, 1] - tracks.second_right[:, 0])) < 0.3
    assert set(tracks.ids) <= set(view.points.ids)


def test_swapped_images_are_noticed_and_right_ones_are_not(stereo, drive):
    assert not stereo.is_swapped(drive[0])
    assert stereo.is_swapped(drive[0][::-1])
    grey = np.full_like(drive[0][0], 100)
    assert not stereo.is_swapped((grey, grey))  # without corners there is no evidence


def test_mono_tracks_are_numbered_and_keep_their_places_in_the_reference_frame(mono, drive):
    first = mono.observe(drive[0][0])
    followed = mono.follow(first, drive[1][0], first.pixels, wide=True)
    tracks = followed.tracks
    assert 0.5 * len(first) < len(tracks) <= len(first)
    index = np.searchsorted(first.ids, tracks.ids)
    np.testing.assert_array_equal(tracks.reference_pixels, first.pixels[index])
    np.testing.assert_array_equal(followed.before, first.pixels[index])
    renewed = mono.observe(drive[1][0], tracks)
    np.testing.assert_array_equal(renewed.reference_pixels, renewed.pixels)
    np.testing.assert_array_equal(renewed.ids[: len(tracks)], tracks.ids)
    assert renewed.ids[len(tracks)] == first.ids[-1] + 1


def test_a_selection_of_tracks_keeps_all_their_columns(mono, drive):
    tracks = mono.observe(drive[0][0])
    chosen = np.arange(len(tracks)) % 3 == 0
    some = tracks.select(chosen)
    assert len(some) == chosen.sum()
    np.testing.assert_array_equal(some.ids, tracks.ids[chosen])
    np.testing.assert_array_equal(some.pixels, tracks.pixels[chosen])
    np.testing.assert_array_equal(some.reference_pixels, tracks.reference_pixels[chosen])


def test_points_of_unknown_place_are_looked_for_where_they_were(mono, drive):
    first = mono.observe(drive[0][0])
    followed = mono.follow(first, drive[0][0], np.full_like(first.pixels, np.nan))
    assert len(followed.tracks) > 0.9 * len(first)
    np.testing.assert_allclose(followed.tracks.pixels, followed.before, atol=0.1)


def test_no_corner_is_chosen_or_kept_where_the_mask_is_black(stereo, mono, drive):
    height, width = drive[0][0].shape
    mask = np.full((height, width), 255, np.uint8)
    mask[:, : width // 2] = 0
    pair, tracks = stereo.observe(drive[0]), mono.observe(drive[0][0])
    half = width / 2 - 1
    assert (pair.points.left[:, 0] < half).sum() > 20
    stereo.mask = mono.mask = mask
    calibration = Calibration.unknown(StereoCamera(350, 350, 255.5, 111.5, 0.5, width, height), CalibrationConfig())
    followed = stereo.follow(pair, drive[1], np.eye(4), calibration)
    assert len(followed) > 20
    assert (followed.second_left[:, 0] > half).all()
    assert (mono.follow(tracks, drive[1][0], tracks.pixels).tracks.pixels[:, 0] > half).all()
    assert (stereo.observe(drive[1]).points.left[:, 0] > half).all()
    assert (mono.observe(drive[1][0]).pixels[:, 0] > half).all()


@pytest.mark.parametrize("masked", [True, False], ids=["masked", "control"])
def test_a_bonnet_stops_the_motion_unless_it_is_masked(clip, masked):
    camera, pairs, poses = clip("05", 20)
    mask = np.full((camera.height, camera.width), 255, np.uint8)
    mask[-100:] = 0
    cells = np.random.default_rng(1).integers(0, 255, (15, camera.width // 6)).astype(np.uint8)
    strip = cv2.resize(cells, (camera.width, 90), interpolation=cv2.INTER_CUBIC)
    odometry, T = StereoOdometry(camera), np.eye(4)
    for left, right in pairs:
        left, right = left.copy(), right.copy()
        left[-90:] = right[-90:] = strip
        T = T @ odometry.track(left, right, mask=mask if masked else None).T_previous_current
    truth = np.linalg.inv(poses[0]) @ poses[len(pairs) - 1]
    assert (np.linalg.norm(T[:3, 3] - truth[:3, 3]) < 0.3) == masked
