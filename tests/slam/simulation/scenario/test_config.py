from dataclasses import asdict, replace

import numpy as np
import pytest

from slam.errors import ConfigError
from slam.simulation.scenario.config import DIFFICULTIES, SimulationConfig


def test_the_default_camera_is_that_of_kitti():
    camera = SimulationConfig().camera
    np.testing.assert_allclose(
        [camera.fx, camera.fy, camera.cx, camera.cy, camera.baseline],
        [718.856, 718.856, 607.1928, 185.2157, 0.54],
    )


def test_a_smaller_image_keeps_the_field_of_view():
    big, small = SimulationConfig().camera, SimulationConfig(width=320, height=96).camera
    for edge in (-0.5, 1.0):
        end_big = (big.width - 0.5) if edge > 0 else edge
        end_small = (small.width - 0.5) if edge > 0 else edge
        assert (end_big - big.cx) / big.fx == pytest.approx((end_small - small.cx) / small.fx)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"shape": "spiral"}, "shape .spiral.: expected circle, figure-eight, blocks or the path"),
        ({"laps": 0}, "laps of a simulated drive: expected 1 to 1000, got 0"),
        ({"speed_m_per_s": float("nan")}, "speed_m_per_s .* got nan"),
        ({"lateral_offset_m": 3.0}, "lateral_offset_m .* expected -1.5 to 1.5, got 3"),
        ({"width": 8}, "width .* got 8"),
        ({"difficulty": "hard"}, "difficulty of a simulated drive: expected clean, standard, street, got 'hard'"),
        ({"lens_error_px": 51.0}, "lens_error_px .* expected -50 to 50, got 51"),
    ],
)
def test_the_error_for_an_invalid_configuration_says_what_was_expected(wrong, message):
    with pytest.raises(ConfigError, match=message):
        SimulationConfig(**wrong)


def test_an_error_that_is_named_replaces_that_of_the_difficulty_alone():
    named = SimulationConfig(difficulty="street", lens_error_px=0.0).conditions
    assert named == replace(SimulationConfig(difficulty="street").conditions, lens_error_px=0.0)
    assert named != SimulationConfig(difficulty="street").conditions


def test_each_difficulty_has_at_least_the_errors_of_the_one_below():
    clean, standard, street = (asdict(SimulationConfig(difficulty=name).conditions) for name in DIFFICULTIES)
    errors = [name for name in clean if not name.startswith("max_")]
    assert all(clean[name] <= standard[name] <= street[name] for name in errors)
    assert not any(clean[name] for name in errors)
    assert all(street[name] for name in errors)


def test_random_numbers_of_one_purpose_do_not_depend_on_others():
    config = SimulationConfig(seed=3)
    config.rng(1).normal(size=5)
    assert config.rng(2, 7).normal() == SimulationConfig(seed=3).rng(2, 7).normal()
    assert config.rng(2, 7).normal() != config.rng(2, 8).normal()
