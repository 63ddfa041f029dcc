"""The file of a recording: its parts are kept, numbered in order, and merged into one."""

from pathlib import Path

import pytest
import rerun as rr
from rerun.chunk import RrdReader

from slam.errors import OutputError
from slam.viewer import recording_file
from slam.viewer.recording_file import has_room, merge_recordings, rotate_recording


def record(path: Path, frame: int, run: str = "run") -> None:
    stream = rr.RecordingStream("revisit", recording_id=run, send_properties=False)
    stream.set_sinks(rr.FileSink(str(path)))
    stream.set_time("frame", sequence=frame)
    stream.log("x", rr.Scalars(float(frame)))
    stream.flush(timeout_sec=10.0)
    stream.disconnect()


def test_the_parts_of_a_run_become_one_recording_with_all_frames(tmp_path: Path):
    path = tmp_path / "recording.rrd"
    for frame in range(3):
        rotate_recording(path)
        record(path, frame)
    assert sorted(item.name for item in tmp_path.iterdir()) == [
        "recording.part-000.rrd", "recording.part-001.rrd", "recording.rrd",
    ]  # fmt: skip
    merge_recordings(path)
    assert [item.name for item in tmp_path.iterdir()] == ["recording.rrd"]
    assert sum(chunk.num_rows for chunk in RrdReader(path).stream() if chunk.entity_path == "/x") == 3


def test_a_merge_that_fails_leaves_the_parts_and_says_how_to_open_them(tmp_path: Path, monkeypatch, caplog):
    path = tmp_path / "recording.rrd"
    record(path, 0)
    rotate_recording(path)
    record(path, 1)
    monkeypatch.setattr(recording_file, "_rerun", lambda: str(tmp_path / "no such program"))
    merge_recordings(path)
    assert sorted(item.name for item in tmp_path.iterdir()) == ["recording.part-000.rrd", "recording.rrd"]
    assert "open them together with: rerun *.rrd" in caplog.text


def test_a_folder_that_is_gone_is_named(tmp_path: Path):
    for check in (rotate_recording, has_room):
        with pytest.raises(OutputError, match=r"gone/recording\.rrd: cannot write the recording"):
            check(tmp_path / "gone" / "recording.rrd")
