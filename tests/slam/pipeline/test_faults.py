"""What a run does when the world fails it: one line that says so, and nothing half-written."""

import json
import os
import re
import resource
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from odometry.camera import StereoCamera
from place_recognition.growing_array import SpillFile
from slam import run_log
from slam.cli import app
from slam.errors import OutputError
from slam.io.metrics import read_metrics
from slam.io.trajectory_files import read_tum
from slam.pipeline import pipeline, result_files
from slam.pose_graph.pose_graph import PoseGraph
from slam.system import Slam
from slam.viewer import recordings, rerun_viewer

from ..datasets.layouts import taken, write_folders

FRAMES = 8


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folders(tmp_path_factory.mktemp("recording") / "drive", taken("ideal", FRAMES), fps=20)


def revisit(*arguments: object) -> int:
    return app._exit_code(lambda: app.app(["run", *map(str, arguments)]))


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """No file can grow beyond a size: to those who write, a disk that is full."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def only_line(capsys: pytest.CaptureFixture[str]) -> str:
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("revisit: ")]
    return line


def test_the_error_for_a_dataset_that_disappears_names_it_and_keeps_the_earlier_run(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, out, driven = shutil.copytree(recording, tmp_path / "drive"), tmp_path / "out", []
    out.mkdir()
    (out / "metrics.json").write_text("of the earlier run")

    def pull_out_the_disk(processed: object) -> None:
        driven.append(processed)
        shutil.rmtree(drive, ignore_errors=True)

    monkeypatch.setattr(pipeline, "log_frame", pull_out_the_disk)
    assert revisit(drive, "--out", out, "--no-record", "--overwrite") == 1
    assert 0 < len(driven) < FRAMES
    assert only_line(capsys).endswith(
        ".png: expected an image, found none; was the recording moved, or its disk taken out?"
    )
    assert [(item.name, item.read_text()) for item in out.iterdir()] == [("metrics.json", "of the earlier run")]


def test_a_full_disk_is_one_line_and_leaves_nothing_behind(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with largest_file(500):
        assert revisit(recording, "--out", tmp_path / "out", "--no-record", "--no-map") == 1
    assert "cannot be written, File too large; choose another folder or make room" in only_line(capsys)
    assert list(tmp_path.iterdir()) == []


def test_what_a_full_disk_has_no_room_for_is_left_out_and_named_and_the_rest_is_written(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert revisit(recording, "--out", tmp_path / "whole", "--no-record") == 0
    with largest_file(100_000):  # the tables fit, the first frames and the report do not
        assert revisit(recording, "--out", tmp_path / "out", "--no-record") == 1
    whole, out = ({item.name for item in (tmp_path / name).iterdir()} for name in ("whole", "out"))
    assert whole - out == {"map.db", "report.html"}
    assert out < whole
    shown = capsys.readouterr().err
    lost = "last checkpoint of map.db, report.html cannot be written; all else is there; make room and run it again"
    assert shown.splitlines()[-1] == f"revisit: {tmp_path / 'out'}: {lost}"
    warnings = read_metrics(tmp_path / "out" / "metrics.json")["warnings"]
    assert isinstance(warnings, list)
    for name in ("last checkpoint of map.db", "report.html"):
        (one,) = [warning for warning in warnings if warning.startswith(f"{name}: left out, ")]
        assert f"warning: {one}" in shown
        assert ".unfinished" not in one


def disk_of(free: int) -> Callable[[object], tuple[int, int, int]]:
    """Stand for shutil.disk_usage on a disk with so many bytes left."""
    usage = shutil.disk_usage("/")
    return lambda _folder: usage._replace(free=free)


def test_without_room_for_the_recording_the_run_goes_on(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    assert revisit(recording, "--out", tmp_path / "whole", "--no-map") == 0
    names = {item.name for item in (tmp_path / "whole").iterdir()}
    assert "recording.rrd" in names
    monkeypatch.setattr(recordings.shutil, "disk_usage", disk_of(recordings.RESERVE_BYTES))
    assert revisit(recording, "--out", tmp_path / "out", "--no-map") == 0
    assert "recording.rrd: it is left out, as the disk has less than 200 MB left" in caplog.text
    assert {item.name for item in (tmp_path / "out").iterdir()} == names - {"recording.rrd"}
    assert read_metrics(tmp_path / "out" / "metrics.json")["frames"] == FRAMES


def test_a_full_disk_ends_the_recording_and_its_beginning_can_be_read(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    free = iter([2, 2, 2, 2])  # of the reserve: at the start, then for each frame
    monkeypatch.setattr(recordings, "has_room", has_room := lambda _path: next(free, 0) > 1)
    monkeypatch.setattr(rerun_viewer, "has_room", has_room)
    assert revisit(recording, "--out", tmp_path / "out", "--no-map") == 0
    assert "recording.rrd: it ends before frame 3, as the disk has less than 200 MB left" in caplog.text
    chunks = RrdReader(tmp_path / "out" / "recording.rrd").stream()
    assert sum(chunk.num_rows for chunk in chunks if chunk.entity_path == "/world/camera") == 3
    assert read_metrics(tmp_path / "out" / "metrics.json")["frames"] == FRAMES


def test_a_recording_that_cannot_be_written_to_its_end_is_removed_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    viewer = rerun_viewer.RerunViewer(tmp_path / "recording.rrd", StereoCamera(120.0, 120.0, 79.5, 29.5, 0.5, 160, 60))

    def fail(timeout_sec: float) -> None:
        raise RuntimeError("File-writer thread shut down prematurely")

    monkeypatch.setattr(viewer._recording, "flush", fail)
    with pytest.raises(OutputError, match=r"recording\.rrd: expected room for the recording, found none"):
        viewer.close()
    assert list(tmp_path.iterdir()) == []


def test_a_temporary_disk_that_is_full_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    def remember() -> None:
        file = SpillFile(np.dtype([("x", "f8", 100)]), in_memory=2)
        for _ in range(10):
            file.append(np.zeros((), file.dtype))

    with largest_file(1000):
        assert app._exit_code(remember) == 1
    assert re.search(r"older images in .* point TMPDIR at a larger disk", only_line(capsys))


def test_other_errors_of_the_system_keep_their_traceback() -> None:
    def fail() -> None:
        raise FileNotFoundError(2, "a bug")

    with pytest.raises(FileNotFoundError):
        app._exit_code(fail)


def test_a_log_that_finds_no_room_does_not_end_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with largest_file(2000), run_log.log_to_file(tmp_path / "run.log"):
        for _ in range(100):
            run_log.log.info("frame 1: motion predicted")
    assert (tmp_path / "run.log").stat().st_size <= 2000
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("out", ["file/out", 300 * "x", "nobody/out"])
def test_a_folder_that_cannot_be_written_is_refused_before_the_run(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], out: str
) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "nobody").mkdir(mode=0o500)
    if os.access(tmp_path / "nobody", os.W_OK) and out.startswith("nobody"):
        pytest.skip("whoever runs this may write everywhere")
    assert revisit(recording, "--out", tmp_path / out) == 1
    assert only_line(capsys).startswith(f"revisit: {tmp_path / out}: ")
    assert sorted(item.name for item in tmp_path.iterdir()) == ["file", "nobody"]


FAILURES = {
    "covariances": (PoseGraph, "covariances", "corrected covariances", set()),
    "final optimisation": (PoseGraph, "optimize", "final optimisation", set()),
    "late answers": (Slam, "verify_late_beliefs", "late answers of the recogniser", set()),
    "errors": (result_files, "evaluate_places", "evaluation of places", set()),
    "picture": (result_files, "draw_before_after", "before_after.png", {"before_after.png"}),
    "graph": (result_files, "chain_graph", "pose_graph_before.g2o", {"pose_graph_before.g2o", "pose_graph_after.g2o"}),
    "map": (result_files, "write_cloud", "map_before.ply", {"map_before.ply", "map_after.ply"}),
    "report": (result_files, "write_report", "report.html", {"report.html"}),
    "recording": (rerun_viewer.RerunViewer, "finish", "end of the recording", set()),
}


@pytest.mark.parametrize("stage", FAILURES)
def test_what_fails_after_the_last_frame_costs_its_own_result_alone(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], stage: str
) -> None:
    owner, name, what, lost = FAILURES[stage]

    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("Indeterminate linear system\ndetected")

    monkeypatch.setattr(owner, name, fail)
    assert revisit(recording, "--out", tmp_path / "out", "--no-map") == 0
    names = {item.name for item in (tmp_path / "out").iterdir()}
    wanted = {"metrics.json", "config.toml", "trajectory_corrected.tum", "frames.csv", "loops.csv", "report.html"}
    assert (wanted | {"before_after.png", "pose_graph_after.g2o", "map_after.ply", "recording.rrd"}) - names == lost & (
        wanted | {"before_after.png", "pose_graph_after.g2o", "map_after.ply"}
    )
    warnings = read_metrics(tmp_path / "out" / "metrics.json")["warnings"]
    assert isinstance(warnings, list)
    named = [text for text in warnings if text.startswith(what)]
    assert len(named) == 1
    assert named[0].endswith("left out, Indeterminate linear system detected")
    assert f"warning: {named[0]}" in capsys.readouterr().err
    if "report.html" not in lost:
        assert what in (tmp_path / "out" / "report.html").read_text()
    _, poses = read_tum(tmp_path / "out" / "trajectory_corrected.tum")
    assert len(poses) == FRAMES
    assert "Traceback" in (tmp_path / "out" / "run.log").read_text()


@pytest.mark.parametrize("command", ["run", "places"])
def test_a_fault_that_check_finds_stops_a_command_in_the_same_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    drive = taken("ideal", FRAMES)
    dark = replace(drive, pairs=[(left // 12, right // 12) for left, right in drive.pairs])
    folder = write_folders(tmp_path / "drive", dark, fps=20)
    assert app._exit_code(lambda: app.app(["check", str(folder), "--json"])) == 1
    reasons = json.loads(capsys.readouterr().out)["reasons"]["places"]
    options = ["--paradigm", "pixel-sequences"] if command == "places" else []
    assert app._exit_code(lambda: app.app([command, str(folder), "--out", str(tmp_path / "out"), *options])) == 1
    line = only_line(capsys)
    assert line.startswith(f"revisit: {folder}: light: {reasons[0]}")
    assert all(reason in line for reason in reasons)
    assert not (tmp_path / "out").exists()


def test_a_run_that_measured_nothing_ends_with_an_error_and_all_its_results(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, noise = taken("ideal", FRAMES), np.random.default_rng(1)
    pairs = [tuple(noise.integers(0, 255, image.shape, np.uint8) for image in pair) for pair in drive.pairs]
    folder = write_folders(tmp_path / "drive", replace(drive, pairs=pairs), fps=20)
    assert revisit(folder, "--out", tmp_path / "out", "--no-record", "--no-map") == 1
    said = f"0 of {FRAMES - 1} motions measured, {FRAMES - 1} predicted, mostly: "
    assert f"{folder}: expected motions that the images show, found {said}" in only_line(capsys)
    metrics = read_metrics(tmp_path / "out" / "metrics.json")
    assert metrics["motions"]["measured"] == 0  # type: ignore[index]
    assert metrics["motions"]["predicted"] == FRAMES - 1  # type: ignore[index]
    assert any(said in warning for warning in metrics["warnings"])  # type: ignore[attr-defined]
    assert said in (tmp_path / "out" / "report.html").read_text()


def test_a_run_knows_its_recording_from_anywhere_and_no_other_for_it(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = shutil.copytree(recording, tmp_path / "drive")
    monkeypatch.chdir(tmp_path)
    assert revisit("drive", "--out", "out", "--no-record") == 0
    metrics = read_metrics(tmp_path / "out" / "metrics.json")
    assert metrics["source"] == metrics["recording"]["path"] == str(drive)  # type: ignore[index]
    names = sorted(drive.glob("left/*"))
    texts = [name.read_bytes() for name in names]
    for name, text in zip(names, reversed(texts), strict=True):  # same camera, same times, other images
        name.write_bytes(text)
    dense = ["dense", str(tmp_path / "out")]
    again = ["reprocess", str(tmp_path / "out"), "--out", str(tmp_path / "again")]
    for command, words in ((dense, "expected the drive"), (again, "expected the dataset")):
        assert app._exit_code(lambda command=command: app.app(command)) == 1
        assert words in only_line(capsys)
    shutil.rmtree(drive)
    for command, remedy in ((dense, "revisit dense"), (again, "--source")):
        assert app._exit_code(lambda command=command: app.app(command)) == 1
        line = only_line(capsys)
        assert f"{drive}: expected the recording of" in line
        assert remedy in line
