"""frames.csv and loops.csv survive their files, whatever is in them."""

import csv
import math
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.errors import DataError
from slam.io import frames_and_loops_csv
from slam.io.frames_and_loops_csv import (
    FrameTable,
    read_events,
    read_frames,
    read_loops,
    read_stages,
    write_events,
    write_frames,
    write_loops,
    write_stages,
)
from slam.run_result import LoopEventRow, LoopRow, StageRow

numbers = st.floats(allow_infinity=False)
words = st.text(st.characters(codec="utf-8", exclude_characters="\0")).map(lambda s: "".join(s.splitlines()))
loop_rows = st.builds(LoopRow, weight=numbers, residual=numbers, score=numbers, reason=words)


def comparable(row: LoopRow) -> list[object]:
    return ["nan" if isinstance(value, float) and math.isnan(value) else value for value in astuple(row)]


def table(count: int = 3) -> FrameTable:
    rng = np.random.default_rng(1)
    predicted = np.arange(count) == 1
    return FrameTable(
        timestamps=rng.random(count),
        predicted=predicted,
        reasons=tuple('too dark, "black"' if p else "" for p in predicted),
        inliers=rng.integers(0, 200, count),
        tracks=rng.integers(200, 400, count),
        residual_px=np.where(predicted, np.nan, rng.random(count)),
        stage_ms={"odometry": rng.random(count), "features": rng.random(count)},
    )


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("tables") / "table.csv"


@settings(max_examples=25, deadline=None)
@given(rows=st.lists(loop_rows, max_size=5))
def test_the_loop_log_comes_back(file: Path, rows: list[LoopRow]) -> None:
    write_loops(file, rows)
    assert [comparable(row) for row in read_loops(file)] == [comparable(row) for row in rows]


def test_a_reason_of_several_lines_becomes_one(file: Path) -> None:
    write_loops(file, [LoopRow(7, 2, 0.5, True, reason="too few\r\ninliers")])
    assert read_loops(file)[0].reason == "too few inliers"


@pytest.mark.parametrize("count", [0, 1, 3])
def test_frames_come_back(file: Path, count: int) -> None:
    expected = table(count)
    write_frames(file, expected)
    read = read_frames(file)
    assert (len(read), read.reasons) == (count, expected.reasons)
    for name in ("timestamps", "predicted", "inliers", "tracks", "residual_px"):
        np.testing.assert_array_equal(getattr(read, name), getattr(expected, name))
    np.testing.assert_equal(dict(read.stage_ms), dict(expected.stage_ms))


def test_the_loop_log_has_the_documented_columns(file: Path) -> None:
    write_loops(file, [])
    columns = "query,match,score,accepted,matches,inliers,verified,in_graph,weight,residual,truth,reason"
    assert file.read_text() == columns + "\n"


def test_frames_have_a_column_for_every_stage(file: Path) -> None:
    stages = {"odometry": np.ones(2), "pose graph": np.ones(2)}
    small = table(2)
    write_frames(file, FrameTable(**vars(small) | {"stage_ms": stages}))
    with file.open() as lines:
        header = next(csv.reader(lines))
    assert header == [*frames_and_loops_csv.FRAME_COLUMNS, "odometry_ms", "pose_graph_ms"]


def test_what_is_unknown_is_an_empty_cell(file: Path) -> None:
    write_loops(file, [LoopRow(query=7, match=2, score=0.5, accepted=True)])
    assert file.read_text().splitlines()[1] == "7,2,0.5,true,0,0,false,false,,,,"


def test_numpy_values_are_written_like_plain_ones(file: Path) -> None:
    write_loops(file, [LoopRow(np.int64(7), 2, np.float64(0.1), np.bool_(True), truth=np.bool_(False))])
    assert file.read_text().splitlines()[1] == "7,2,0.1,true,0,0,false,false,,,false,"


def test_the_status_of_a_frame_is_a_word(file: Path) -> None:
    write_frames(file, table())
    with file.open() as lines:
        assert [row["status"] for row in csv.DictReader(lines)] == ["measured", "predicted", "measured"]


def test_tables_of_runs_before_the_errors_of_loops_are_read(file: Path) -> None:
    write_stages(file, [StageRow(9, 2, 40, x_m=1.5, translation_error_m=0.25, rotation_error_deg=0.5)])
    assert read_stages(file)[0].translation_error_m == 0.25
    with file.open(newline="") as lines:
        cells = [row[:-2] for row in csv.reader(lines)]
    with file.open("w", newline="") as lines:
        csv.writer(lines).writerows(cells)
    (row,) = read_stages(file)
    assert (row.query, row.match, row.x_m) == (9, 2, 1.5)
    assert math.isnan(row.translation_error_m)


def test_the_columns_of_the_stages_and_of_the_events(file: Path) -> None:
    """Scripts depend on these names; docs/files.md gives their units."""
    write_stages(file, [])
    assert file.read_text() == (
        "query,match,epipolar_inliers,epipolar_verified,x_m,y_m,z_m,rotation_deg,position_sigma_m,rotation_sigma_deg,"
        "gate_sigma,gate_passed,gate_reason,translation_error_m,rotation_error_deg\n"
    )
    write_events(file, [])
    assert file.read_text() == "query,match,frame,in_graph,reason\n"


@settings(max_examples=25, deadline=None)
@given(events=st.lists(st.builds(LoopEventRow, reason=words), max_size=4))
def test_events_come_back(file: Path, events: list[LoopEventRow]) -> None:
    write_events(file, events)
    assert read_events(file) == tuple(events)


HEADER = ",".join(frames_and_loops_csv.LOOP_COLUMNS)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"loops.csv: expected the columns query, .*found no query"),
        ("query,match\n", r"loops.csv: .*found no score"),
        (
            HEADER + "\n7,x,0,true,0,0,true,true,,,,\n",
            r"loops.csv, row 7: expected match as a run writes it, found 'x'",
        ),
        (
            HEADER + "\n7,2,0,yes,0,0,true,true,,,,\n",
            r"loops.csv, row 7: expected accepted as a run writes it, found 'yes'",
        ),
        (HEADER + "\n7,2\n", r"loops.csv, row 7: expected accepted as a run writes it, found ''"),
    ],
)
def test_a_damaged_loop_log_is_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "loops.csv").write_text(text)
    with pytest.raises(DataError, match=message):
        read_loops(tmp_path / "loops.csv")


def test_a_missing_table_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"frames.csv: expected a table of a run"):
        read_frames(tmp_path / "frames.csv")
