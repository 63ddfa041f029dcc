"""Runs that are killed, stopped or lose their source, and continue with --resume."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

from slam.config import read_config
from slam.errors import ConfigError, DataError, OutputError
from slam.io.run_folder import unfinished
from slam.map_database.database import MapDatabase
from slam.map_database.replay import source_of
from slam.map_database.resume import find_resumable_run
from slam.pipeline.pipeline import RunOptions, run_pipeline
from slam.pipeline.visualization import RunVisualizer
from slam.system import FrameResult

QUIET = Console(quiet=True)
TIMED = {"frames.csv", "report.html", "run.log", "map.db", "metrics.json"}
TIMES = {
    "source",
    "recording",
    "command",
    "timing_ms",
    "frames_per_second",
    "wall_seconds",
    "peak_memory_mb",
    "memory_mb",
}
FRAMES = 150
WITHOUT_RECORDING = {"save_recording": False}


@pytest.fixture(scope="module")
def drive(circle_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every second frame of the circle: 150 frames that come back after 80."""
    source, root = circle_drive / "sequences" / "00", tmp_path_factory.mktemp("half") / "drive"
    target = root / "sequences" / "00"
    for camera in ("image_0", "image_1"):
        (target / camera).mkdir(parents=True)
        for index in range(FRAMES):
            (target / camera / f"{index:06d}.png").symlink_to(source / camera / f"{2 * index:06d}.png")
    shutil.copy(source / "calib.txt", target)
    (target / "times.txt").write_text("".join(f"{0.2 * index:e}\n" for index in range(FRAMES)))
    poses = (circle_drive / "poses" / "00.txt").read_text().splitlines()[: 2 * FRAMES : 2]
    (root / "poses").mkdir()
    (root / "poses" / "00.txt").write_text("\n".join(poses) + "\n")
    return root


def run(source: Path, out: Path, resume: bool = False, **settings: object) -> bool:
    return run_pipeline(RunOptions(source=source, out=out, resume=resume), WITHOUT_RECORDING | settings, QUIET, QUIET)


@pytest.fixture(scope="module")
def undisturbed(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("undisturbed") / "run"
    run(drive, out)
    return out


def results(out: Path) -> dict[str, object]:
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["graph"].pop("seconds") > 0
    files = {path.name: path.read_bytes() for path in out.iterdir() if path.name not in TIMED}
    return files | {name: value for name, value in metrics.items() if name not in TIMES}


def map_of(out: Path) -> list[bytes]:
    with MapDatabase.open(out / "map.db") as store:
        tables = ("frame", "landmark", "loop", "checkpoint_array")
        columns = "image, T_previous_camera, T_world_camera, covariance", "*", "*", "*"
        return [repr([tuple(row) for row in store._connection.execute(f"SELECT {some} FROM {table}")]).encode()
                for table, some in zip(tables, columns, strict=True)]  # fmt: skip


def assert_as_undisturbed(out: Path, undisturbed: Path) -> None:
    found, expected = results(out), results(undisturbed)
    assert found.keys() == expected.keys()
    assert [name for name in expected if found[name] != expected[name]] == []
    assert map_of(out) == map_of(undisturbed)
    assert unfinished(out) == []


def test_a_killed_run_can_be_resumed(drive: Path, undisturbed: Path, tmp_path: Path):
    out = tmp_path / "o'ut <b> 街"
    command = [
        sys.executable,
        "-c",
        "from slam.cli.app import main; main()",
        "run",
        str(drive),
        "--out",
        str(out),
        "--no-record",
    ]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    while process.poll() is None and not _frames(out):
        time.sleep(0.1)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert 100 <= _frames(out) <= FRAMES
    assert not (out / "metrics.json").exists()
    with pytest.raises(OutputError, match=r"stopped after .* continue it with --resume"):
        run(drive, out)
    run(drive, out, resume=True)
    assert_as_undisturbed(out, undisturbed)


def _frames(out: Path) -> int:
    try:
        stopped = find_resumable_run(out)
    except DataError:  # it is just being made
        return 0
    return stopped.frames if stopped else 0


def test_a_run_whose_source_disappeared_can_be_resumed_once_it_is_back(drive: Path, undisturbed: Path, tmp_path: Path):
    source, out = tmp_path / "drive", tmp_path / "out"
    shutil.copytree(drive, source, symlinks=True)
    image = source / "sequences" / "00" / "image_1" / "000120.png"
    there = image.readlink()
    image.unlink()
    image.write_bytes(b"gone")
    with pytest.raises(DataError, match=r"000120.png.* 100 frames are kept in .*out: continue with --resume"):
        run(source, out)
    image.unlink()
    image.symlink_to(there)
    run(source, out, resume=True)
    assert_as_undisturbed(out, undisturbed)


def interrupting(index: int) -> Callable[[RunVisualizer, FrameResult], object]:
    """RunVisualizer.show, with an interruption from the keyboard at a frame."""
    original = RunVisualizer.show

    def interrupt(self: RunVisualizer, processed: FrameResult) -> object:
        if processed.frame.index == index:
            signal.raise_signal(signal.SIGINT)
        return original(self, processed)

    return interrupt


def test_an_interrupted_run_can_be_resumed(
    drive: Path, undisturbed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    out = tmp_path / "out"
    with monkeypatch.context() as patched:
        patched.setattr("slam.pipeline.visualization.RunVisualizer.show", interrupting(60))
        assert run(drive, out)
    assert json.loads((out / "metrics.json").read_text())["interrupted"]
    # The frame whose odometry was under way when the interruption came is the last one.
    assert json.loads((out / "metrics.json").read_text())["frames"] in (61, 62)
    assert not run(drive, out, resume=True)
    assert_as_undisturbed(out, undisturbed)


def test_a_run_with_the_published_preset_can_be_resumed(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    slow = tmp_path / "slow"  # 0.55 s between frames: the loop of 80 frames is older than the 40 s of the preset
    shutil.copytree(drive, slow, symlinks=True)
    times = slow / "sequences" / "00" / "times.txt"
    times.write_text("".join(f"{0.55 * index:e}\n" for index in range(FRAMES)))
    chosen = {"paradigm": "dynamic-sequences", "preset": "published"}
    run(slow, tmp_path / "whole", **chosen)
    metrics = json.loads((tmp_path / "whole" / "metrics.json").read_text())
    assert metrics["preset"] == "published"
    assert read_config(tmp_path / "whole" / "config.toml").place_recognition.preset == "published"
    pairs = [line.split(",")[:2] for line in (tmp_path / "whole" / "loops.csv").read_text().splitlines()[1:]]
    ages = [int(query) - int(match) for query, match in pairs if match]
    assert len(ages) > 5
    assert min(ages) >= 73
    with monkeypatch.context() as patched:
        patched.setattr("slam.pipeline.visualization.RunVisualizer.show", interrupting(115))
        assert run(slow, tmp_path / "out", **chosen)
    with pytest.raises(ConfigError, match="other settings"):
        run(slow, tmp_path / "out", resume=True, preset="default")
    assert not run(slow, tmp_path / "out", resume=True)
    assert_as_undisturbed(tmp_path / "out", tmp_path / "whole")


def test_a_complete_run_has_nothing_to_resume(drive: Path, undisturbed: Path):
    before = results(undisturbed)
    assert not run(drive, undisturbed, resume=True)
    assert results(undisturbed) == before


def test_a_run_is_resumed_with_its_own_settings_and_dataset_only(
    drive: Path, undisturbed: Path, circle_drive: Path, tmp_path: Path
):
    out = tmp_path / "out"
    left = out / ".unfinished-1"
    left.mkdir(parents=True)
    shutil.copy(undisturbed / "map.db", left)
    with pytest.raises(ConfigError, match="other settings"):
        run(drive, out, resume=True, paradigm="global-descriptor")
    with pytest.raises(DataError, match="expected the dataset from which it was made"):
        run(circle_drive, out, resume=True)
    (left / "map.db").write_bytes(b"SQLite format 3\0 and then nothing")
    with pytest.raises(DataError, match=r"map\.db: expected a map database, found a damaged one"):
        run(drive, out, resume=True)


def test_without_a_map_nothing_can_be_resumed(drive: Path, tmp_path: Path):
    run(drive, tmp_path / "out", save_map=False)
    assert not (tmp_path / "out" / "map.db").exists()


def test_the_same_loops_are_found_again_without_odometry(undisturbed: Path, tmp_path: Path):
    again = source_of(undisturbed)
    options = RunOptions(source=again.path, sequence=again.sequence, out=tmp_path / "again", reuse_map=undisturbed)
    run_pipeline(options, WITHOUT_RECORDING, QUIET, QUIET)
    found, expected = results(tmp_path / "again"), results(undisturbed)
    expected.pop("calibration.toml")  # nothing new was learned of it
    assert [name for name in expected if found[name] != expected[name]] == []


def test_other_loops_are_found_with_another_paradigm(undisturbed: Path, circle_drive: Path, tmp_path: Path):
    again = source_of(undisturbed)
    options = RunOptions(source=again.path, sequence=again.sequence, out=tmp_path / "other", reuse_map=undisturbed)
    run_pipeline(options, WITHOUT_RECORDING | {"paradigm": "global-descriptor"}, QUIET, QUIET)
    metrics = json.loads((tmp_path / "other" / "metrics.json").read_text())
    assert metrics["places"]["paradigm"] == "global-descriptor"
    name = "trajectory_odometry.txt"
    assert (tmp_path / "other" / name).read_bytes() == (undisturbed / name).read_bytes()
    elsewhere = RunOptions(source=circle_drive, out=tmp_path / "never", reuse_map=undisturbed)
    with pytest.raises(DataError, match="expected the dataset from which it was made"):
        run_pipeline(elsewhere, WITHOUT_RECORDING, QUIET, QUIET)
