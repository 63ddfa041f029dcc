"""The promise of the first page, on a small simulated drive: two laps drift apart, and closing loops joins them."""

import json
from pathlib import Path

import pytest
from rich.console import Console

from slam.run import RunOptions, run_recorded
from slam.storage.tables import read_loops


@pytest.fixture(scope="module")
def circle(circle_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a run over two laps of 160 m, images at half of KITTI's size."""
    out, quiet = tmp_path_factory.mktemp("circle") / "run", Console(quiet=True)
    run_recorded(RunOptions(circle_drive, None, out), {"record": False}, quiet, quiet)
    return out


@pytest.fixture(scope="module")
def metrics(circle: Path) -> dict:
    return json.loads((circle / "metrics.json").read_text())


def test_the_second_lap_is_recognised_and_no_false_loop_is_kept(metrics: dict):
    assert metrics["loops"]["false"] == 0
    assert metrics["loops"]["recall"] > 0.5


def test_closing_the_loops_corrects_the_trajectory(metrics: dict):
    assert metrics["corrected"]["ate_m"] < metrics["odometry"]["ate_m"]


def test_closing_the_loops_joins_the_laps(metrics: dict):
    """What both laps share no loop can see, and it is most of so small an error; the drift between them goes."""
    assert metrics["corrected"]["end_error_m"] < 0.4 * metrics["odometry"]["end_error_m"]


def test_the_recogniser_is_judged_beside_the_trajectory(metrics: dict):
    assert metrics["places"]["recall_at_100_precision"] > 0.5
    assert metrics["places"]["truth_rows"] > 100


def test_every_belief_has_a_row_with_a_reason(circle: Path):
    rows = read_loops(circle / "loops.csv")
    assert all(row.reason for row in rows)
    assert [row.query for row in rows] == sorted({row.query for row in rows})


def test_all_that_was_kept_was_first_proved(circle: Path):
    assert all(row.accepted and row.verified for row in read_loops(circle / "loops.csv") if row.in_graph)
