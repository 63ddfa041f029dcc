"""Textures repeat and stay within brightness; the sensor adds the errors that its configuration names alone."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.simulation.rendering.sensor_model import blur_motion, build_sensor_model, exposure_gain, intrinsics_of
from slam.simulation.rendering.shading import DETAIL, GLOSS, LEAF, TEXTURE
from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.world import facades, textures
from slam.simulation.world.materials import build_materials

CONFIG = SimulationConfig(width=160, height=64)
Paint = Callable[[np.random.Generator], np.ndarray]
PAINTS: dict[str, Paint] = {
    "plaster": textures.plaster,
    "grass": textures.grass,
    "leaves": textures.leaves,
    "bark": textures.bark,
    "road": textures.road,
    "bricks": lambda rng: textures.courses(rng, 30, 12, 4, 0.07),
    "poster": facades.advertisement,
}


@pytest.mark.parametrize("name", PAINTS)
def test_surfaces_reflect_a_part_of_the_light_and_show_something(name: str) -> None:
    image = PAINTS[name](np.random.default_rng(4))
    assert image.shape[0] == image.shape[1]
    assert 0.05 < image.mean() < 0.9
    assert image.std() > 0.01
    assert np.mean((image < 0) | (image > 1)) < 0.02  # clipped when it is packed


@pytest.mark.parametrize("name", ["plaster", "grass"])
def test_textures_repeat_without_a_seam(name: str) -> None:
    image = PAINTS[name](np.random.default_rng(4))
    inner = np.abs(np.diff(image, axis=1)).mean()
    assert np.abs(image[:, 0] - image[:, -1]).mean() < 3 * inner


@settings(max_examples=20, deadline=None)
@given(slope=st.floats(0.2, 2.0), seed=st.integers(0, 99))
def test_noise_has_mean_zero_and_deviation_one(slope: float, seed: int) -> None:
    field = textures.noise(np.random.default_rng(seed), 128, slope)
    assert field.mean() == pytest.approx(0.0, abs=1e-4)
    assert field.std() == pytest.approx(1.0, rel=1e-4)


def test_every_level_of_a_texture_has_the_mean_of_the_finest() -> None:
    image = np.random.default_rng(0).random((64, 64))
    atlas = textures.build_atlas([(image, None), (image[:32, :32], image[32:, :32])])
    sizes, start = (64, 32, 16, 8, 4, 2, 1), 0
    for size in sizes:
        level = atlas.texels[start : start + size * size] / 255
        assert level.mean() == pytest.approx(image.mean(), abs=0.01)
        start += size * size
    np.testing.assert_array_equal(atlas.table, [[6, 0, 0], [5, 1, start]])
    assert (atlas.gloss[:start] == 0).all()


def test_the_material_table_names_textures_that_exist() -> None:
    materials = build_materials(CONFIG)
    used = materials.table[:, [TEXTURE, DETAIL]].astype(int)
    assert 0 <= used.min() <= used.max() < len(materials.atlas.table)
    assert ((materials.table[:, GLOSS] >= 0) & (materials.table[:, GLOSS] <= 1)).all()
    assert set(np.unique(materials.table[:, LEAF])) == {0.0, 1.0}
    ends = materials.atlas.table[:, 2] + [(4 ** (power + 1) - 1) // 3 for power in materials.atlas.table[:, 0]]
    np.testing.assert_array_equal(ends[:-1], materials.atlas.table[1:, 2])  # one after the other, without gaps
    assert ends[-1] == len(materials.atlas.texels) == len(materials.atlas.gloss)


def test_a_panorama_is_brightest_at_the_horizon_and_closes_around() -> None:
    sky = textures.panorama(np.random.default_rng(1), 1024)
    assert sky.shape == (512, 1024)
    assert sky[230].mean() > sky[5].mean()  # haze above the horizon, blue at the zenith
    assert np.abs(sky[:, 0] - sky[:, -1]).mean() < 5 * np.abs(np.diff(sky, axis=1)).mean() + 0.01


def stripes(period: int) -> np.ndarray:
    return np.tile((np.arange(160) % period < period // 2).astype(np.float32), (64, 1))


@settings(max_examples=20, deadline=None)
@given(value=st.floats(0.0, 1.0), x=st.floats(-0.3, 0.3), yaw=st.floats(-0.02, 0.02))
def test_motion_blur_leaves_a_uniform_image_alone(value: float, x: float, yaw: float) -> None:
    image, step = np.full((64, 160), value, np.float32), np.zeros((3, 4))
    step[0, 3], step[0, 2], step[2, 0] = x, yaw, -yaw
    out = blur_motion(image, np.full_like(image, 4.0), step, intrinsics_of(CONFIG.camera))
    np.testing.assert_allclose(out, image, rtol=1e-5, atol=1e-6)


def test_motion_along_an_edge_does_not_blur_it() -> None:
    camera, step = intrinsics_of(CONFIG.camera), np.zeros((3, 4))
    image, depth = stripes(16), np.full((64, 160), 3.0, np.float32)
    step[1, 3] = 0.2  # upwards or downwards: stripes are upright
    np.testing.assert_allclose(blur_motion(image, depth, step, camera)[20:44], image[20:44], atol=1e-6)


def test_a_rotation_blurs_near_and_far_alike() -> None:
    camera, step = intrinsics_of(CONFIG.camera), np.zeros((3, 4))
    step[0, 2], step[2, 0] = 0.05, -0.05
    near, far = (blur_motion(stripes(16), np.full((64, 160), z, np.float32), step, camera) for z in (2.0, 500.0))
    np.testing.assert_array_equal(near, far)


def test_noise_has_the_deviation_of_the_sensor() -> None:
    config = replace(CONFIG, difficulty="standard", rectification_error_px=0.0, lens_error_px=0.0)
    light, depth = np.full((64, 160), 0.4, np.float32), np.full((64, 160), 50.0, np.float32)
    images = [build_sensor_model(config, 0).expose(light, depth, np.eye(4), 1.0, frame) for frame in range(40)]
    centre = np.array(images, float)[:, 24:40, 60:100]
    expected = np.sqrt(1.1**2 + 0.012 * centre.mean() + 1 / 12)  # read noise, shot noise, rounding
    assert centre.std(axis=0).mean() == pytest.approx(expected, rel=0.05)


def test_the_right_camera_is_a_little_brighter_and_corners_are_darker() -> None:
    light, depth = np.full((64, 160), 0.4, np.float32), np.full((64, 160), 50.0, np.float32)
    config = replace(CONFIG, difficulty="standard")
    left, right = (build_sensor_model(config, side).expose(light, depth, np.eye(4), 1.0, 0) for side in (0, 1))
    assert right.mean() / left.mean() == pytest.approx(1.03, abs=0.01)
    assert left[:8, :8].mean() < 0.9 * left[28:36, 76:84].mean()


def test_without_errors_images_are_read_where_they_are() -> None:
    sensor = build_sensor_model(replace(CONFIG, difficulty="clean"), 1)
    x, y = np.meshgrid(np.arange(160), np.arange(64))
    np.testing.assert_array_equal(sensor.map_x, x)
    np.testing.assert_array_equal(sensor.map_y, y)


@settings(max_examples=20, deadline=None)
@given(error=st.floats(0.1, 5.0))
def test_calibration_errors_scale_with_their_configuration(error: float) -> None:
    x = np.meshgrid(np.arange(160), np.arange(64))[0]
    shifts = [
        build_sensor_model(replace(CONFIG, difficulty="standard", rectification_error_px=e, lens_error_px=0.0), 0).map_x
        - x
        for e in (1.0, error)
    ]
    np.testing.assert_allclose(shifts[1], error * shifts[0], atol=1e-4)


def test_the_gain_jumps_now_and_then_and_drifts_slowly_between() -> None:
    light = np.full((8, 8), 0.4, np.float32)
    gains = np.array([exposure_gain(CONFIG, light, time) for time in np.arange(0, 60, 0.1)])
    steps = np.abs(np.diff(gains)) / gains[:-1]
    assert (steps > 0.05).sum() <= 6  # every nine seconds
    assert np.median(steps) < 0.01


def test_an_ideal_sensor_has_a_constant_gain() -> None:
    ideal = replace(CONFIG, difficulty="clean")
    shots = [(value, time) for value in (0.1, 0.9) for time in (0.0, 50.0)]
    gains = {exposure_gain(ideal, np.full((8, 8), value, np.float32), time) for value, time in shots}
    assert len(gains) == 1
