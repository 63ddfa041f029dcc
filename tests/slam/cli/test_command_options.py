"""Each option of a command arrives where it belongs, and one that is not given changes nothing."""

from collections.abc import Callable
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import pytest

import slam.apps.dense
import slam.apps.evaluate
import slam.apps.places
import slam.benchmark.sweep
import slam.pipeline.pipeline
import slam.simulation
from slam.cli import app
from slam.simulation import RoomConfig, SimulationConfig

Call = tuple[tuple[Any, ...], dict[str, Any]]


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> Callable[[object, str, object], list[Call]]:
    """Put a function in the place of one that works, and keep what it is called with."""

    def record(module: object, name: str, result: object) -> list[Call]:
        made: list[Call] = []

        def called(*arguments: Any, **keywords: Any) -> object:
            made.append((arguments, keywords))
            return result

        assert hasattr(module, name)
        monkeypatch.setattr(module, name, called)
        return made

    return record


def run(*words: object) -> None:
    assert app._exit_code(lambda: app.app([str(word) for word in words])) == 0


def test_an_ideal_sensor_is_the_clean_difficulty(calls: Callable[..., list[Call]], tmp_path: Path) -> None:
    made = calls(slam.simulation, "simulate", tmp_path)
    run("simulate", "blocks", "--out", tmp_path, "--ideal-sensor")
    run("simulate", "blocks", "--out", tmp_path, "--difficulty", "clean")
    assert made[0][0][0] == made[1][0][0] == SimulationConfig(shape="blocks", difficulty="clean")


def test_every_option_of_simulate_is_a_field_of_the_drive(calls: Callable[..., list[Call]], tmp_path: Path) -> None:
    made = calls(slam.simulation, "simulate", tmp_path)
    run("simulate", "blocks", "--out", tmp_path)
    given = {
        "--laps": 5, "--length": 333.0, "--seed": 9, "--speed": 7.5, "--frame-rate": 12.0, "--width": 640,
        "--height": 200, "--lateral-offset": 1.25, "--cars-per-360m": 3, "--rectification-error": 0.25,
        "--lens-error": 3.5, "--max-frames": 77,
        "--difficulty": "clean",
    }  # fmt: skip
    flags = ("--reverse", "--change-illumination", "--perceptual-aliasing", "--save-depth")
    run("simulate", "blocks", "--out", tmp_path, *(word for pair in given.items() for word in pair), *flags)
    plain, full = (arguments[0] for arguments, _ in made)
    assert plain == SimulationConfig(shape="blocks")
    values = list(asdict(full).values())
    assert sum(value is True for value in values) == len(flags)
    assert set(given.values()) <= set(values)
    # Each option on its own changes one field, and no two change the same one.
    changed = []
    for words in [*map(list, given.items()), *([flag] for flag in flags)]:
        run("simulate", "blocks", "--out", tmp_path, *words)
        spec = made[-1][0][0]
        (name,) = (field.name for field in fields(spec) if getattr(spec, field.name) != getattr(plain, field.name))
        changed.append(name)
    assert sorted(changed) == sorted(field.name for field in fields(plain) if field.name != "shape")


def test_every_option_of_a_room_is_a_field_of_it(calls: Callable[..., list[Call]], tmp_path: Path) -> None:
    made = calls(slam.simulation, "simulate_room", tmp_path)
    given = {
        "--motion": "robot", "--sensor": "stereo", "--duration": 33.0, "--pure-rotation": 7.0, "--seed": 9,
        "--frame-rate": 12.0, "--width": 320, "--height": 200, "--rectification-error": 0.25, "--lens-error": 3.5,
        "--max-frames": 77, "--difficulty": "clean",
    }  # fmt: skip
    run("simulate", "room", "--out", tmp_path)
    plain = made[0][0][0]
    assert plain == RoomConfig()
    changed = []
    for name, value in given.items():
        run("simulate", "room", "--out", tmp_path, name, value)
        config = made[-1][0][0]
        (field,) = (field.name for field in fields(plain) if getattr(config, field.name) != getattr(plain, field.name))
        assert getattr(config, field) == value
        changed.append(field)
    assert sorted(changed) == sorted(field.name for field in fields(plain))
    run("simulate", "room", "--out", tmp_path, "--ideal-sensor")
    assert made[-1][0][0] == RoomConfig(difficulty="clean")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("room", "--laps", 0), "--laps: it is an option of a drive, not of a room; leave it out"),
        (("room", "--length", 300), "--length: it is an option of a drive"),
        (("room", "--speed", 3), "--speed: it is an option of a drive"),
        (("room", "--lateral-offset", 0.0), "--lateral-offset: it is an option of a drive"),
        (("room", "--reverse"), "--reverse: it is an option of a drive"),
        (("room", "--change-illumination"), "--change-illumination: it is an option of a drive"),
        (("room", "--perceptual-aliasing"), "--perceptual-aliasing: it is an option of a drive"),
        (("room", "--cars-per-360m", 2), "--cars-per-360m: it is an option of a drive"),
        (("room", "--save-depth"), "--save-depth: it is an option of a drive"),
        (("blocks", "--motion", "hand"), "--motion: it is an option of a room, not of a drive; leave it out"),
        (("blocks", "--sensor", "mono"), "--sensor: it is an option of a room"),
        (("blocks", "--duration", 10), "--duration: it is an option of a room"),
        (("blocks", "--pure-rotation", 0), "--pure-rotation: it is an option of a room"),
        (("room", "--difficulty", "street"), "difficulty of a simulated room: expected clean, standard, got 'street'"),
    ],
)
def test_an_option_that_means_nothing_is_refused_in_one_line(
    words: tuple[object, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = app._exit_code(lambda: app.app(["simulate", *map(str, words), "--out", str(tmp_path / "a")]))
    said = capsys.readouterr().err
    assert code == app.EXIT_USAGE
    assert message in said
    assert said.count("\n") == 1
    assert not (tmp_path / "a").exists()


def test_options_of_dense_are_not_exchanged(calls: Callable[..., list[Call]], tmp_path: Path) -> None:
    made = calls(slam.apps.dense, "build_dense_map", "done")
    run("dense", tmp_path, "--voxel-size", 0.3, "--max-depth", 12.5, "--overwrite")
    options = made[0][0][0]
    assert (options.run, options.voxel_m, options.max_depth_m, options.overwrite) == (tmp_path, 0.3, 12.5, True)


def test_options_of_evaluate_loops_are_the_rule(calls: Callable[..., list[Call]], tmp_path: Path) -> None:
    made = calls(slam.apps.evaluate, "evaluate_loops", "text")
    words = ("evaluate", "loops", tmp_path / "matches.csv", tmp_path / "poses.txt")
    run(*words)
    plain = made[0][0][0]
    assert plain.rule == type(plain.rule)()  # the defaults of the help are those of the rule
    rule = {"--max-distance": 7.5, "--max-angle": 30.0, "--min-time-gap": 4.25, "--min-distance": 60.0}
    run(*words, "--frame-tolerance", 3, "--fps", 2.0, "--one-to-one", *(word for pair in rule.items() for word in pair))
    options = made[1][0][0]
    assert (options.frame_tolerance, options.fps) == (3, 2.0)
    assert list(vars(options.rule).values()) == [7.5, 30.0, 4.25, 60.0, True]


def test_options_of_a_run_that_are_not_given_leave_the_settings_alone(
    calls: Callable[..., list[Call]], tmp_path: Path
) -> None:
    made = calls(slam.pipeline.pipeline, "run_pipeline", False)
    run("run", tmp_path, "--out", tmp_path / "out")
    options, settings = made[0][0][:2]
    assert settings == {}
    assert (options.source, options.out, options.topics, options.resume) == (tmp_path, tmp_path / "out", (), False)


def test_options_of_a_run_arrive(calls: Callable[..., list[Call]], tmp_path: Path) -> None:
    made = calls(slam.pipeline.pipeline, "run_pipeline", False)
    reading = {
        "--sequence": "05",
        "--format": "kitti",
        "--fps": 5.0,
        "--map": tmp_path / "m",
        "--config": tmp_path / "c",
    }
    settings = {
        "--paradigm": "pixel-sequences",
        "--features": "orb",
        "--preset": "published",
        "--robust": "gnc",
        "--seed": 4,
        "--descriptor": "hog",
    }
    words = [word for pair in (reading | settings).items() for word in pair]
    topics = ("--image-topic", "/left", "--image-topic", "/right")
    run("run", tmp_path, "--out", tmp_path / "out", "--resume", "--mono", "--camera-height", 1.5, *topics, *words)
    options, changed = made[0][0][:2]
    assert (options.sequence, options.format, options.fps) == ("05", "kitti", 5.0)
    assert (options.map_file, options.config, options.topics) == (tmp_path / "m", tmp_path / "c", ("/left", "/right"))
    assert options.resume
    assert {key: changed[key.strip("-")] for key in settings} == settings
    assert (changed["mono"], changed["camera_height"]) == (True, 1.5)


def test_named_files_are_found_from_any_folder_when_a_run_is_resumed(
    calls: Callable[..., list[Call]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    made = calls(slam.pipeline.pipeline, "run_pipeline", False)
    names = ("--paradigm", "file:m.csv", "--features", "onnx:f.onnx", "--descriptor", "onnx:d.onnx")
    run("run", tmp_path, "--out", tmp_path / "out", *names)
    settings = made[0][0][1]
    assert settings["paradigm"] == f"file:{tmp_path / 'm.csv'}"
    assert (settings["features"], settings["descriptor"]) == (f"onnx:{tmp_path}/f.onnx", f"onnx:{tmp_path}/d.onnx")


def test_what_a_run_does_not_write_is_switched_off(calls: Callable[..., list[Call]], tmp_path: Path) -> None:
    made = calls(slam.pipeline.pipeline, "run_pipeline", False)
    run("run", tmp_path, "--out", tmp_path / "out", "--no-record")
    run("run", tmp_path, "--out", tmp_path / "out", "--no-map")
    first, second = (arguments[1] for arguments, _ in made)
    assert list(first.values()) == list(second.values()) == [False]
    assert set(first) != set(second)


def test_an_interrupted_run_ends_with_its_exit_code(calls: Callable[..., list[Call]], tmp_path: Path) -> None:
    calls(slam.pipeline.pipeline, "run_pipeline", True)
    assert app._exit_code(lambda: app.app(["run", str(tmp_path), "--out", str(tmp_path)])) == 130


def test_options_of_places_arrive(calls: Callable[..., list[Call]], tmp_path: Path) -> None:
    made = calls(slam.apps.places, "recognize_places", False)
    words = ("places", tmp_path, "--paradigm", "pixel-sequences", "--out", tmp_path / "out")
    run(*words)
    run(*words, "--exclude", 40, "--fps", 10, "--seed", 3, "--features", "orb", "--format", "images", "--json",
        "--preset", "published")  # fmt: skip
    (plain, *_), (full, *_, json) = (arguments for arguments, _ in made)
    changed = {"exclude": 40.0, "fps": 10.0, "seed": 3, "features": "orb", "format": "images"}
    changed["preset"] = "published"
    assert full == replace(plain, **changed)
    assert json


@pytest.mark.parametrize(("succeeded", "code"), [(True, 0), (False, 1)])
def test_a_benchmark_with_failures_ends_with_their_exit_code(
    calls: Callable[..., list[Call]], tmp_path: Path, succeeded: bool, code: int
) -> None:
    made = calls(slam.benchmark.sweep, "run_benchmark", succeeded)
    words = ["benchmark", "town.toml", "--out", str(tmp_path), "--workers", "3"]
    assert app._exit_code(lambda: app.app(words)) == code
    options = made[0][0][0]
    assert (options.config, options.out, options.workers, options.scheduler) == (Path("town.toml"), tmp_path, 3, None)
