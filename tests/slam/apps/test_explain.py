"""`revisit explain` tells what happened to a loop, and helps where there is nothing to tell."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from slam.apps.explain import explain_loop
from slam.cli import app
from slam.errors import DataError
from slam.io.frames_and_loops_csv import write_events, write_loops, write_stages
from slam.io.metrics import write_metrics
from slam.run_result import LoopEventRow, LoopRow, StageRow

CLOSED = LoopRow(
    40, 7, 12.5, True, 120, 80, True, True, 0.97, 1.4, True, "kept with weight 0.97: 1.4 sigma from the optimised map"
)
ROWS = [
    LoopRow(20, 2, 1.25, False, reason="not accepted: score 1.2 is below the recogniser's threshold", truth=False),
    LoopRow(30, 5, 9.0, True, 30, 9, reason="9 landmarks agree with one relative pose, expected at least 20"),
    CLOSED,
    replace(CLOSED, query=50, in_graph=False, weight=0.0, residual=9.5, truth=False, reason="left out: 9.5 sigma"),
]
STAGES = [
    StageRow(20, 2, 5, False),
    StageRow(30, 5, 45, True),
    StageRow(40, 7, 60, True, 0.5, -0.25, -3.0, 2.5, 0.031, 0.11, 1.7, True, "drift explains 4.0 m"),
    StageRow(50, 7, None, True, 0.5, 0.0, 0.0, 0.0, 0.03, 0.1, 9.5, False, "drift does not explain 40.0 m"),
]  # fmt: skip
EVENTS = [
    LoopEventRow(40, 7, 40, False, "waits"),
    LoopEventRow(40, 7, 42, True, "joined"),
    LoopEventRow(50, 7, 50, False, "drift does not explain 40.0 m"),
]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    write_metrics(folder / "metrics.json", {"frames": 60, "places": {"paradigm": "tracked-words"}})
    write_loops(folder / "loops.csv", ROWS)
    write_stages(folder / "loop_stages.csv", STAGES)
    write_events(folder / "loop_events.csv", EVENTS)
    return folder


def stage(text: str, name: str) -> str:
    """The explanation of one stage."""
    (line,) = (line for line in text.splitlines() if line.strip().startswith(name))
    return line.strip().removeprefix(name).strip()


def test_a_closed_loop_is_explained_stage_by_stage_with_its_numbers(run: Path) -> None:
    text = explain_loop(run, 40)
    assert text.startswith("Frame 40 with frame 7: closed.")
    assert stage(text, "recogniser") == "tracked-words: score 12.5, accepted as a revisit"
    assert stage(text, "epipolar check") == "60 matches agree with one epipolar geometry, enough"
    assert "80 of 120 landmark matches agree" in stage(text, "relative pose")
    assert "0.50 right, 0.25 up, 3.00 back m and turned 2.50 deg" in stage(text, "relative pose")
    assert "one sigma 0.031 m, 0.110 deg" in stage(text, "relative pose")
    assert stage(text, "drift gate") == "passed: drift explains 4.0 m"
    assert stage(text, "online graph") == "frame 40: waits"
    assert "frame 42: joined" in text
    assert "weight 0.97, residual 1.40 sigma" in stage(text, "final map")
    assert stage(text, "ground truth") == "a true revisit"


def test_a_belief_that_was_not_accepted_stops_at_the_recogniser(run: Path) -> None:
    text = explain_loop(run, 20)
    assert "not closed" in text
    assert "below the recogniser's threshold" in stage(text, "recogniser")
    assert stage(text, "epipolar check") == "5 matches agree with one epipolar geometry, too few"
    assert [stage(text, name) for name in ("drift gate", "online graph", "final map")] == ["not reached"] * 3


def test_a_match_that_geometry_does_not_verify_has_a_reason(run: Path) -> None:
    relative_pose = stage(explain_loop(run, 30), "relative pose")
    assert "9 landmarks agree with one relative pose, expected at least 20" in relative_pose


def test_a_loop_that_the_gate_rejects_is_explained_with_its_distance(run: Path) -> None:
    text = explain_loop(run, 50)
    assert stage(text, "drift gate") == "rejected: drift does not explain 40.0 m"
    assert "left out: 9.5 sigma" in stage(text, "final map")


def test_another_match_than_the_best_is_answered_with_the_best(run: Path) -> None:
    text = explain_loop(run, 40, 2)
    assert "best match for frame 40 was 7, not 2" in text
    assert "Frame 2 was the match of 20" in text
    assert "Frame 40 with frame 7: closed." in text
    assert explain_loop(run, 40, 7) == explain_loop(run, 40)


def test_a_frame_without_a_belief_is_answered_with_its_neighbours(run: Path) -> None:
    text = explain_loop(run, 33)
    assert "found no earlier frame" in text
    assert "20 (not accepted), 30 (not verified by geometry), 40 (closed)" in text


def test_a_run_without_any_match_is_explained(run: Path, tmp_path: Path) -> None:
    (tmp_path / "metrics.json").write_bytes((run / "metrics.json").read_bytes())
    write_loops(tmp_path / "loops.csv", [])
    write_stages(tmp_path / "loop_stages.csv", [])
    write_events(tmp_path / "loop_events.csv", [])
    assert "No frame of this run has a match" in explain_loop(tmp_path, 3)


@pytest.mark.parametrize(
    ("query", "match", "message"),
    [
        (60, None, "expected a query from 0 to 59, the frames of this run, got 60"),
        (-1, None, "expected a query from 0 to 59"),
        (40, 40, "expected a match from 0 to 39, before the query, got 40"),
        (40, -3, "expected a match from 0 to 39"),
    ],
)
def test_frames_that_are_not_in_the_run_are_errors(run: Path, query: int, match: int | None, message: str) -> None:
    with pytest.raises(DataError, match=re.escape(message)):
        explain_loop(run, query, match)


def test_a_folder_without_a_run_is_an_error_with_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"nowhere: expected the folder of a run .* revisit run SOURCE --out"):
        explain_loop(tmp_path / "nowhere", 3)


@pytest.mark.parametrize("name", ["metrics.json", "loop_stages.csv", "loop_events.csv"])
def test_a_missing_file_is_named(run: Path, tmp_path: Path, name: str) -> None:
    for file in run.iterdir():
        if file.name != name:
            (tmp_path / file.name).write_bytes(file.read_bytes())
    with pytest.raises(DataError, match=re.escape(name)):
        explain_loop(tmp_path, 40)


def test_the_command_prints_what_is_to_tell(run: Path) -> None:
    result = CliRunner().invoke(app.app, ["explain", str(run), "40"])
    assert result.exit_code == 0
    assert result.output.rstrip("\n") == explain_loop(run, 40)
