"""A configuration survives its file, and a wrong one is named."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from odometry.camera import StereoCamera
from place_recognition.paradigms.registry import with_exclusion
from slam.components import build_components, exclude_by_preset, override_config, read_checked_config
from slam.config import RunConfig, changed_settings, read_config, to_toml
from slam.errors import ConfigError


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "settings.toml"
    path.write_text(text)
    return path


def test_a_written_configuration_is_read_back(tmp_path: Path):
    config = replace(RunConfig(), seed=7, robust="none", save_recording=False)
    assert read_config(written(tmp_path, to_toml(config))) == config


def test_settings_that_differ_from_the_defaults_are_known_and_lead_the_file(tmp_path: Path):
    config = override_config(RunConfig(seed=7), {"mono": True, "camera_height": 1.65})
    changes = changed_settings(config)
    assert [(change.name, change.value, change.default) for change in changes] == [
        ("seed", 7, 0),
        ("mono", True, False),
        ("mono_odometry.odometry.camera_height_m", 1.65, 0.0),
    ]
    lines = to_toml(config).splitlines()
    assert lines[1:4] == [f"# {change}" for change in changes]
    assert "seed = 7 (default 0)" in lines[1]


def test_defaults_differ_in_nothing_and_a_name_of_two_lines_stays_a_comment(tmp_path: Path):
    assert changed_settings(RunConfig()) == ()
    odd = RunConfig(mask="one\ntwo\u2028three")
    assert read_config(written(tmp_path, to_toml(odd))) == odd


def test_an_empty_file_is_the_default(tmp_path: Path):
    assert read_config(written(tmp_path, "")) == RunConfig()


def test_one_nested_setting_changes_only_itself(tmp_path: Path):
    config = read_config(written(tmp_path, "[key_frames]\nmin_distance_m = 3\n"))
    assert config.key_frames.min_distance_m == 3.0
    assert replace(config, key_frames=RunConfig().key_frames) == RunConfig()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("paradigms = 'x'", r"settings\.toml: unknown setting 'paradigms'; known here: .*paradigm"),
        ("seed = 'one'", r"settings\.toml: seed: expected int, found 'one'"),
        ("seed = true", r"settings\.toml: seed: expected int, found True"),
        ("[key_frames]\nfar = 1", r"key_frames: unknown setting 'far'"),
        ("seed = = 1", r"settings\.toml: expected a TOML file"),
    ],
)
def test_the_error_for_a_wrong_setting_names_file_and_setting(tmp_path: Path, text: str, message: str):
    with pytest.raises(ConfigError, match=message):
        read_config(written(tmp_path, text))


def test_a_missing_file_is_named(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"nothing\.toml: expected a TOML file"):
        read_config(tmp_path / "nothing.toml")


def test_the_settings_of_one_camera_are_read_back(tmp_path: Path):
    config = replace(RunConfig(), mono=True)
    odometry = replace(config.mono_odometry.odometry, camera_height_m=1.65)
    config = replace(config, mono_odometry=replace(config.mono_odometry, odometry=odometry))
    assert read_config(written(tmp_path, to_toml(config))) == config
    assert config.pose_graph_for_camera().scale_drift > 0
    assert RunConfig().pose_graph_for_camera() == RunConfig().pose_graph


def test_a_setting_of_place_recognition_overrides_that_alone():
    changed = override_config(RunConfig(), {"features": "sift", "seed": 7})
    assert changed == replace(
        RunConfig(), seed=7, place_recognition=replace(RunConfig().place_recognition, features="sift")
    )


def test_a_preset_is_read_back_and_the_settings_of_the_methods_stay_in_the_file(tmp_path: Path):
    config = override_config(RunConfig(), {"preset": "published"})
    assert config.place_recognition == replace(RunConfig().place_recognition, preset="published")
    assert read_config(written(tmp_path, to_toml(config))) == config


def test_an_unknown_preset_of_a_file_is_named_with_it(tmp_path: Path):
    with pytest.raises(
        ConfigError, match=r"settings\.toml: unknown preset 'chapter': expected one of default, published"
    ):
        read_checked_config(written(tmp_path, "[place_recognition]\npreset = 'chapter'\n"))


@pytest.mark.parametrize(
    ("paradigm", "preset", "frames"),
    [
        ("sequence-histograms", "published", 80),
        ("tracked-words", "published", 0),
        ("sequence-histograms", "default", 0),
    ],
)
def test_a_preset_excludes_its_time_by_the_times_of_the_recording(paradigm: str, preset: str, frames: int):
    config = override_config(RunConfig(), {"paradigm": paradigm, "preset": preset})
    changed = exclude_by_preset(config, 0.5 * np.arange(200))
    assert changed.place_recognition == with_exclusion(config.place_recognition, frames)
    own = replace(config, place_recognition=with_exclusion(config.place_recognition, 7))
    assert exclude_by_preset(own, 0.5 * np.arange(200)) == own


def test_the_components_of_a_preset_have_its_features():
    camera = StereoCamera(300.0, 300.0, 160.0, 60.0, 0.5, 320, 120)
    kinds = {
        paradigm: build_components(
            camera, override_config(RunConfig(), {"paradigm": paradigm, "preset": "published"})
        ).features.kind
        for paradigm in ("dynamic-sequences", "tracked-words")
    }
    assert kinds == {"dynamic-sequences": "brief-256", "tracked-words": "surf-upright-64"}


def test_no_setting_leaves_a_configuration_as_it_is():
    assert override_config(RunConfig(mono=True), {}) == RunConfig(mono=True)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"paradigm": "none"}, "unknown paradigm 'none'"),
        ({"features": "none"}, "unknown local features 'none'"),
        ({"preset": "none"}, "unknown preset 'none': expected one of default, published"),
        ({"camera_height": 1.65}, "--camera-height: .*add --mono"),
        ({"mono": True, "camera_height": -1.0}, "--camera-height: "),
    ],
)
def test_a_setting_that_cannot_work_is_refused(settings: dict[str, object], message: str):
    with pytest.raises(ConfigError, match=message):
        override_config(RunConfig(), settings)


def test_the_height_of_a_single_camera_is_a_setting_of_its_odometry():
    changed = override_config(RunConfig(), {"mono": True, "camera_height": 1.65})
    assert changed.mono_odometry.odometry.camera_height_m == 1.65
    assert changed.odometry == RunConfig().odometry
