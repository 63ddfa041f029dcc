"""A run with a depth camera: its settings, its odometry as the system uses it, and its landmarks."""

from dataclasses import replace

import numpy as np
import pytest

from odometry.camera import StereoCamera
from slam.components import build_components, build_odometry
from slam.config import RunConfig, parse_config, to_toml
from slam.datasets.dataset import Frame
from slam.system import Slam
from slam.visual_odometry import MonocularVisualOdometry, RgbdVisualOdometry, StereoVisualOdometry

CAMERA = StereoCamera(262.5, 262.5, 159.5, 119.5, 0.075, 320, 240)
DEPTH = RunConfig().with_depth_of(True)


def frames(count):
    """Frames of a textured wall at 1.5 m, along which the camera moves by 1 cm a frame."""
    rng = np.random.default_rng(0)
    wall = np.kron(rng.integers(0, 255, (80, 200)), np.ones((4, 4))).astype(np.uint8)
    step = 0.01 * CAMERA.fx / 1.5
    found = []
    for k in range(count):
        left = np.ascontiguousarray(wall[: CAMERA.height, round(k * step) : round(k * step) + CAMERA.width])
        depth = np.full(left.shape, 1.5, np.float32)
        found.append(Frame(k, k / 30, left, None, depth=depth))
    return found


def test_settings_of_a_depth_camera_are_used_for_it_alone():
    street, depth, mono = RunConfig(), DEPTH, RunConfig(mono=True).with_depth_of(True)
    assert not street.with_depth_of(False).depth
    assert not mono.depth
    assert depth.with_depth_of(False) == street
    for config in (street, mono):
        assert config.key_frames_for_camera() == config.key_frames
        assert config.places_for_camera() == config.place_recognition
    assert depth.key_frames_for_camera() == depth.rgbd.key_frames
    assert depth.pose_graph_for_camera().nodes.min_distance_m < street.pose_graph_for_camera().nodes.min_distance_m
    assert depth.places_for_camera().view.min_distance_m < street.places_for_camera().view.min_distance_m


def test_settings_of_a_depth_camera_survive_a_file():
    assert parse_config(to_toml(DEPTH), "text") == DEPTH
    assert "# depth = True (default False)" in to_toml(DEPTH)


@pytest.mark.parametrize(
    ("config", "kind"),
    [(DEPTH, RgbdVisualOdometry), (RunConfig(), StereoVisualOdometry), (RunConfig(mono=True), MonocularVisualOdometry)],
)
def test_the_odometry_is_that_of_the_sensor(config, kind):
    odometry = build_odometry(CAMERA, config)
    assert type(odometry) is kind
    assert odometry.has_metric_scale == (not config.mono)


def test_disparities_are_those_of_the_frame_tracked_last():
    odometry, pixels = build_odometry(CAMERA, DEPTH), np.array([[100.0, 100.0], [200.5, 80.2]])
    first, second = frames(2)
    odometry.track(first)
    odometry.track(replace(second, depth=np.full_like(first.depth, 3.0)))
    expected = CAMERA.fx * CAMERA.baseline / 3.0
    np.testing.assert_allclose(odometry.disparity(second.left, None, pixels), expected, rtol=1e-6)


def test_a_frame_without_its_depth_image_has_no_disparities_and_a_motion_all_the_same():
    odometry = build_odometry(CAMERA, DEPTH)
    first, second, third = frames(3)
    odometry.track(first)
    motion = odometry.track(replace(second, depth=None))
    assert np.isfinite(motion.T_previous_current).all()
    assert not motion.predicted
    assert np.isnan(odometry.disparity(second.left, None, np.array([[100.0, 100.0]]))).all()
    odometry.track(third)
    assert np.isfinite(odometry.disparity(third.left, None, np.array([[100.0, 100.0]]))).all()


def test_the_landmarks_of_a_frame_have_the_depth_that_was_measured():
    slam, results = Slam(build_components(CAMERA, DEPTH)), []
    for frame in frames(12):
        results.append(slam.process(frame))
    assert not any(result.motion.predicted for result in results)
    assert len(results[-1].landmarks) > 50
    np.testing.assert_allclose(results[-1].landmarks.points[:, 2], 1.5, rtol=1e-5)
    assert results[-1].T_world_camera[0, 3] == pytest.approx(0.11, abs=0.01)
    assert [result.is_key_frame for result in results].count(True) == 1  # 0.11 m
