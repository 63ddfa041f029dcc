import numpy as np
import pytest

from slam.errors import ConfigError
from slam.simulation import RoomConfig


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"motion": "drone"}, r"motion of a simulated room: expected hand, robot, got 'drone'"),
        ({"sensor": "lidar"}, r"sensor of a simulated room: expected mono, stereo, depth, got 'lidar'"),
        ({"difficulty": "street"}, r"difficulty of a simulated room: expected clean, standard, got 'street'"),
        ({"duration_s": 0.0}, r"duration_s of a simulated room: expected 1 to 3600, got 0"),
        ({"duration_s": float("nan")}, r"duration_s of a simulated room: expected 1 to 3600, got nan"),
        ({"pure_rotation_s": -1.0}, r"pure_rotation_s of a simulated room: expected 0 to 600, got -1"),
        ({"pure_rotation_s": 40.0}, r"expected at most half of the duration, 30, got 40"),
        ({"pure_rotation_s": 5.0, "motion": "robot"}, r"expected 0, as a robot turns on the spot anyway"),
        ({"width": 8}, r"width of a simulated room: expected 32 to 4096, got 8"),
        ({"frame_rate_hz": 0.0}, r"frame_rate_hz of a simulated room: expected 1 to 200, got 0"),
        ({"seed": -1}, r"seed of a simulated room"),
        ({"max_frames": -1}, r"max_frames of a simulated room"),
        ({"lens_error_px": 99.0}, r"lens_error_px of a simulated room"),
    ],
)
def test_a_wrong_setting_is_refused_in_one_line(settings: dict[str, object], message: str):
    with pytest.raises(ConfigError, match=message) as error:
        RoomConfig(**settings)
    assert "\n" not in str(error.value)


def test_the_field_of_view_stays_at_another_size():
    full, half = RoomConfig().camera, RoomConfig(width=320, height=240).camera
    assert (full.fx, full.cx, full.cy) == (525.0, 319.5, 239.5)
    assert np.arctan(320 / full.fx) == pytest.approx(np.arctan(160 / half.fx))
    assert half.cx == 159.5


def test_the_number_of_frames_is_duration_times_rate_or_the_limit():
    assert RoomConfig(duration_s=2.0, frame_rate_hz=30.0).frames == 60
    assert RoomConfig(max_frames=7).frames == 7


def test_errors_that_are_named_replace_those_of_the_difficulty():
    assert RoomConfig(lens_error_px=1.5).conditions.lens_error_px == 1.5
    assert RoomConfig().conditions.lens_error_px == 4.0
    assert not RoomConfig(difficulty="clean").conditions.real_sensor
