import dataclasses

import numpy as np
import pytest

from slam.simulation.rendering.sensor_model import blur_motion, build_sensor_model, exposure_gain, intrinsics_of
from slam.simulation.scenario.config import SimulationConfig

CONFIG = SimulationConfig(width=160, height=64)


def test_a_standing_camera_does_not_blur():
    image = np.random.default_rng(0).random((64, 160), dtype=np.float32)
    out = blur_motion(image, np.full_like(image, 5.0), np.zeros((3, 4)), intrinsics_of(CONFIG.camera))
    np.testing.assert_array_equal(out, image)


def test_near_objects_blur_more_than_far_ones():
    stripes = np.tile((np.arange(160) % 16 < 8).astype(np.float32), (64, 1))
    step = np.zeros((3, 4))
    step[0, 3] = 0.2  # sideways
    near, far = (
        blur_motion(stripes, np.full_like(stripes, z), step, intrinsics_of(CONFIG.camera)) for z in (3.0, 200.0)
    )
    assert near[:, 20:140].std() < 0.8 * far[:, 20:140].std()


def test_an_ideal_camera_only_measures_light():
    sensor = build_sensor_model(dataclasses.replace(CONFIG, ideal_sensor=True), 0)
    light = np.linspace(0, 1, 64 * 160, dtype=np.float32).reshape(64, 160)
    grey = sensor.expose(light, np.full_like(light, 9.0), np.eye(4), 1.0, 0)
    np.testing.assert_array_equal(grey, np.rint(light * 255))


def test_the_calibration_error_stays_within_half_its_size_in_each_camera():
    config = SimulationConfig(rectification_error_px=1.0, lens_error_px=0.0)
    for side in (0, 1):
        sensor = build_sensor_model(config, side)
        x, y = np.meshgrid(np.arange(config.width), np.arange(config.height))
        assert np.abs(sensor.map_x - x).max() == pytest.approx(0.5, abs=1e-3)
        assert np.abs(sensor.map_y - y).max() == pytest.approx(0.5, abs=1e-3)


def test_the_lens_error_is_the_same_in_both_cameras_and_nothing_on_the_axis():
    left, right = (build_sensor_model(SimulationConfig(rectification_error_px=0.0), side) for side in (0, 1))
    np.testing.assert_array_equal(left.map_x, right.map_x)
    np.testing.assert_array_equal(left.map_y, right.map_y)
    camera = SimulationConfig().camera
    row, column = round(camera.cy), round(camera.cx)
    assert abs(left.map_x[row, column] - column) < 1e-3


@pytest.mark.parametrize("lens_error_px", [3.0, 6.0])
def test_the_lens_error_grows_with_the_cube_of_the_angle_once_its_lopsided_part_cancels(lens_error_px: float):
    config = SimulationConfig(rectification_error_px=0.0, lens_error_px=lens_error_px)
    sensor, camera = build_sensor_model(config, 0), config.camera
    row, steps = round(camera.cy), np.array([100, 300, 500])
    right, left = round(camera.cx) + steps, round(camera.cx) - steps
    shrunk = ((sensor.map_x[row, right] - right) - (sensor.map_x[row, left] - left)) / 2
    np.testing.assert_allclose(shrunk, -lens_error_px * (steps / camera.fx) ** 3, atol=0.03)


def test_noise_differs_between_frames_and_sides_but_not_between_runs():
    light = np.full((64, 160), 0.4, np.float32)
    depth = np.full_like(light, 20.0)
    shots = [build_sensor_model(CONFIG, 0).expose(light, depth, np.eye(4), 1.0, frame) for frame in (3, 4, 3)]
    assert (shots[0] != shots[1]).any()
    np.testing.assert_array_equal(shots[0], shots[2])


def test_exposure_works_against_the_light():
    dark, bright = np.full((8, 8), 0.1, np.float32), np.full((8, 8), 0.8, np.float32)
    assert exposure_gain(CONFIG, dark, 1.0) > exposure_gain(CONFIG, bright, 1.0)
