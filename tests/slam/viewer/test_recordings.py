"""The file of a recording: its parts are kept, numbered in order, and merged into one.

The dense map in the viewer: more of the same recording.
"""

from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from odometry.camera import StereoCamera
from slam.errors import DataError, OutputError
from slam.mapping.tsdf import EMPTY_SURFACE, Surface
from slam.viewer import recordings
from slam.viewer.recordings import PlacedMap, has_room, merge_recordings, record_dense_map, rotate_recording
from slam.viewer.rerun_viewer import RerunViewer

CAMERA = StereoCamera(120.0, 120.0, 79.5, 29.5, 0.5, 160, 60)
TRIANGLE = Surface(
    np.eye(3, dtype=np.float32), np.diag([10, 127, 255]).astype(np.uint8), np.array([[0, 1, 2]], np.int32)
)


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
    monkeypatch.setattr(recordings, "_rerun", lambda: str(tmp_path / "no such program"))
    merge_recordings(path)
    assert sorted(item.name for item in tmp_path.iterdir()) == ["recording.part-000.rrd", "recording.rrd"]
    assert "open them together with: rerun *.rrd" in caplog.text


def test_a_folder_that_is_gone_is_named(tmp_path: Path):
    for check in (rotate_recording, has_room):
        with pytest.raises(OutputError, match=r"gone/recording\.rrd: cannot write the recording"):
            check(tmp_path / "gone" / "recording.rrd")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    RerunViewer(tmp_path / "recording.rrd", CAMERA).close()
    return tmp_path / "recording.rrd"


def maps(*surfaces: Surface) -> list[PlacedMap]:
    return [PlacedMap(state, iter(surfaces), np.zeros((2, 3))) for state in ("before", "after")]


def test_a_viewer_takes_both_files_for_one_recording(run: Path, tmp_path: Path):
    record_dense_map(tmp_path / "dense.rrd", run, CAMERA, maps(TRIANGLE))
    first, second = (RrdReader(path).recordings() for path in (run, tmp_path / "dense.rrd"))
    assert [(one.application_id, one.recording_id) for one in first] == [
        (one.application_id, one.recording_id) for one in second
    ]


def test_each_submap_is_there_in_both_states_and_none_is_empty(run: Path, tmp_path: Path):
    record_dense_map(tmp_path / "dense.rrd", run, CAMERA, maps(TRIANGLE, EMPTY_SURFACE, TRIANGLE))
    paths = {piece.entity_path for piece in RrdReader(tmp_path / "dense.rrd").stream()}
    assert {path for path in paths if path.startswith("/world")} == {
        f"/world/dense_{state}/{name}"
        for state in ("before", "after")
        for name in ("path", "submap_0000", "submap_0002")
    }


def test_two_runs_are_two_recordings(run: Path, tmp_path: Path):
    RerunViewer(tmp_path / "other.rrd", CAMERA).close()
    ids = {RrdReader(path).recordings()[0].recording_id for path in (run, tmp_path / "other.rrd")}
    assert len(ids) == 2


@pytest.mark.parametrize("content", [b"", b"not a recording", b"RRF2"])
def test_what_is_no_recording_is_named(tmp_path: Path, content: bytes):
    (tmp_path / "x.rrd").write_bytes(content)
    with pytest.raises(DataError, match=r"x\.rrd: expected a recording of the rerun viewer"):
        record_dense_map(tmp_path / "dense.rrd", tmp_path / "x.rrd", CAMERA, maps(TRIANGLE))
    assert [path.name for path in tmp_path.iterdir()] == ["x.rrd"]


def test_the_folder_of_a_dense_map_that_is_gone_is_named(run: Path, tmp_path: Path):
    with pytest.raises(OutputError, match=r"gone/dense\.rrd: cannot be written"):
        record_dense_map(tmp_path / "gone" / "dense.rrd", run, CAMERA, maps(TRIANGLE))
