import dataclasses

import cv2
import numpy as np
import pytest

from slam.simulation.rendering.sensor_model import blur_motion, build_sensor_model, exposure_gain, intrinsics_of
from slam.simulation.scenario.config import DIFFICULTIES, Difficulty, SimulationConfig

CONFIG = SimulationConfig(width=160, height=64)
STANDARD = SimulationConfig(difficulty="standard")  # without the errors that each camera has of its own


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
    sensor = build_sensor_model(dataclasses.replace(CONFIG, difficulty="clean"), 0)
    light = np.linspace(0, 1, 64 * 160, dtype=np.float32).reshape(64, 160)
    grey = sensor.expose(light, np.full_like(light, 9.0), np.eye(4), 1.0, 0)
    np.testing.assert_array_equal(grey, np.rint(light * 255))


def test_the_calibration_error_stays_within_half_its_size_in_each_camera():
    config = dataclasses.replace(STANDARD, rectification_error_px=1.0, lens_error_px=0.0)
    for side in (0, 1):
        sensor = build_sensor_model(config, side)
        x, y = np.meshgrid(np.arange(config.width), np.arange(config.height))
        assert np.abs(sensor.map_x - x).max() == pytest.approx(0.5, abs=1e-3)
        assert np.abs(sensor.map_y - y).max() == pytest.approx(0.5, abs=1e-3)


def test_the_lens_error_is_the_same_in_both_cameras_and_nothing_on_the_axis():
    left, right = (
        build_sensor_model(dataclasses.replace(STANDARD, rectification_error_px=0.0), side) for side in (0, 1)
    )
    np.testing.assert_array_equal(left.map_x, right.map_x)
    np.testing.assert_array_equal(left.map_y, right.map_y)
    camera = SimulationConfig().camera
    row, column = round(camera.cy), round(camera.cx)
    assert abs(left.map_x[row, column] - column) < 1e-3


@pytest.mark.parametrize("lens_error_px", [3.0, 6.0])
def test_the_lens_error_grows_with_the_cube_of_the_angle_once_its_lopsided_part_cancels(lens_error_px: float):
    config = dataclasses.replace(STANDARD, rectification_error_px=0.0, lens_error_px=lens_error_px)
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


@pytest.fixture
def errors(monkeypatch):
    """Make a configuration with some errors of the calibration and no others."""

    def make(seed=0, **given):
        level = Difficulty(**given)
        monkeypatch.setitem(DIFFICULTIES, "clean", level)
        return SimulationConfig(seed=seed, difficulty="clean")

    return make


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("side", [0, 1])
def test_images_are_those_of_a_camera_with_another_focal_length_and_principal_point(errors, seed, side):
    config = errors(seed, focal_error_percent=0.5, principal_point_error_px=3.0)
    sensor, camera = build_sensor_model(config, side), config.camera
    points = np.array([[-4.0, 1.0, 9.0], [3.0, -0.5, 7.0], [0.0, 0.0, 5.0], [0.8, 0.3, 20.0]])
    x, y = (points[:, :2] / points[:, 2:]).T
    # The believed camera shows a point here; the pixel of the image that is read there is where it appears.
    believed = np.stack([camera.fx * x + camera.cx, camera.fy * y + camera.cy], axis=1)
    shown = np.array([pixel_that_reads(sensor, point) for point in believed])
    focal = (shown[0] - shown[1]) / np.stack([x, y], axis=1)[[0, 1]].T.dot([1.0, -1.0])
    np.testing.assert_allclose(focal, focal[0], rtol=1e-4)
    assert abs(focal[0] / camera.fx - 1) == pytest.approx(0.005, rel=1e-2)
    assert np.linalg.norm(shown[2] - [camera.cx, camera.cy]) == pytest.approx(3.0, abs=1e-3)


def pixel_that_reads(sensor, point):
    """Pixel (2,) of the image that is read at a point (2,): the maps are nearly linear, so two steps are enough."""
    at = np.array(point)
    for _ in range(5):
        read = [
            cv2.remap(m, *at[:, None, None].astype(np.float32), cv2.INTER_LINEAR) for m in (sensor.map_x, sensor.map_y)
        ]
        at = at + point - np.ravel(read)
    return at


def test_both_cameras_have_the_same_focal_length_and_principal_point(errors):
    config = errors(focal_error_percent=0.5, principal_point_error_px=3.0)
    left, right = (build_sensor_model(config, side) for side in (0, 1))
    np.testing.assert_array_equal(left.map_x, right.map_x)
    np.testing.assert_array_equal(left.map_y, right.map_y)


def test_the_local_error_has_its_size_in_each_camera_and_no_polynomial_describes_it(errors):
    config = errors(local_error_px=0.2)
    x, y = np.meshgrid(np.linspace(-1, 1, config.width), np.linspace(-1, 1, config.height))
    shifts = [build_sensor_model(config, side).map_x - np.arange(config.width) for side in (0, 1)]
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1).reshape(-1, 6)
    for shift in shifts:
        assert np.sqrt(np.mean(shift**2)) == pytest.approx(0.2, abs=1e-3)
        rest = shift.ravel() - terms @ np.linalg.lstsq(terms, shift.ravel(), rcond=None)[0]
        assert rest.std() > 0.1
    assert abs(np.corrcoef(shifts[0].ravel(), shifts[1].ravel())[0, 1]) < 0.6


def test_the_right_camera_wanders_slowly_and_the_left_one_stays(errors):
    config = errors(rig_drift_px=0.5)
    ramp = np.tile(np.linspace(0.0, 0.9, config.width, dtype=np.float32), (config.height, 1))
    slope = 0.9 / (config.width - 1)
    depth = np.full_like(ramp, 9.0)
    left, right = (build_sensor_model(config, side) for side in (0, 1))
    still = [left.displace(ramp, frame) for frame in (0, 400)]
    np.testing.assert_array_equal(*still)
    np.testing.assert_allclose(still[0], ramp, atol=1e-6)
    centre = (slice(180, 196), slice(600, 640))
    moved = np.array([(right.displace(ramp, k) - ramp)[centre].mean() / slope for k in range(0, 3000, 10)])
    assert np.sqrt(np.mean(moved**2)) == pytest.approx(0.5, rel=0.3)
    steps = [(right.displace(ramp, k + 1) - right.displace(ramp, k))[centre].mean() / slope for k in range(0, 300, 10)]
    assert np.sqrt(np.mean(np.square(steps))) < 0.5 * 0.5
    shots = [right.expose(ramp, depth, np.eye(4), 1.0, 7) for _ in range(2)]
    np.testing.assert_array_equal(*shots)


def test_each_camera_has_a_brightness_of_its_own_in_each_image(errors):
    config = errors(exposure_jitter_percent=5.0)
    light = np.full((8, 8), 0.5, np.float32)
    sensors = [build_sensor_model(dataclasses.replace(config, width=32, height=24), side) for side in (0, 1)]
    shots = [[s.expose(light, light, np.eye(4), 1.0, frame).mean() for s in sensors] for frame in range(200)]
    left, right = np.log(np.array(shots) / 127.5).T
    assert [left.std(), right.std()] == pytest.approx([0.05, 0.05], rel=0.15)
    assert abs(np.corrcoef(left, right)[0, 1]) < 0.2
    assert abs(np.corrcoef(left[1:], left[:-1])[0, 1]) < 0.2
    assert sensors[0].expose(light, light, np.eye(4), 1.0, 3).mean() == shots[3][0]
