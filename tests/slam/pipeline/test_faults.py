"""What a run does when the world fails it: one line that says so, and nothing half-written."""

import os
import re
import resource
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
from slam.pipeline import pipeline
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
    with largest_file(100_000):  # the tables fit, the first frames do not
        assert revisit(recording, "--out", tmp_path / "out", "--no-record") == 1
    assert "map.db: the map cannot be written" in only_line(capsys)
    assert list(tmp_path.iterdir()) == []


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
