"""The dense map in the viewer: more of the same recording."""

from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from odometry.camera import StereoCamera
from slam.errors import DataError, OutputError
from slam.mapping.tsdf import EMPTY_SURFACE, Surface
from slam.viewer.dense_recording import PlacedMap, record_dense_map
from slam.viewer.rerun_viewer import RerunViewer

CAMERA = StereoCamera(120.0, 120.0, 79.5, 29.5, 0.5, 160, 60)
TRIANGLE = Surface(np.eye(3, dtype=np.float32), np.array([0, 127, 255], np.uint8), np.array([[0, 1, 2]], np.int32))


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


def test_a_folder_that_is_gone_is_named(run: Path, tmp_path: Path):
    with pytest.raises(OutputError, match=r"gone/dense\.rrd: cannot be written"):
        record_dense_map(tmp_path / "gone" / "dense.rrd", run, CAMERA, maps(TRIANGLE))
