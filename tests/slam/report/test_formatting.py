import io

import numpy as np
import pytest
from rich.console import Console

from slam.report.formatting import (
    MISSING,
    find_note,
    format_value,
    loop_outcome,
    metric_value,
    stage_times,
    summary_table,
)
from slam.run_result import LoopRow

from . import fabricate

WHOLE = fabricate.record()


def printed(record) -> str:
    console = Console(width=140, record=True, file=io.StringIO())
    console.print(summary_table(record))
    return console.export_text()


def test_values_are_found_by_their_dotted_key():
    assert metric_value({"a": {"b": 3}}, "a.b") == 3
    assert metric_value({"a": None}, "a.b") is None
    assert metric_value({"a": float("nan")}, "a") is None


def test_a_note_on_a_group_holds_for_its_values():
    metrics = {"notes": {"odometry": "no ground truth", "odometry.ate_m": "one pose"}}
    assert find_note(metrics, "odometry.ate_m") == "one pose"
    assert find_note(metrics, "odometry.t_rel_percent") == "no ground truth"
    assert find_note(metrics, "corrected.ate_m") == ""


@pytest.mark.parametrize(
    ("found", "shown"),
    [(None, MISSING), (float("inf"), MISSING), (1.234, "1.23 m"), (7, "7 m"), (True, "yes")],
)
def test_values_are_written_for_people(found, shown):
    assert format_value(found, 2, " m") == shown


def test_shares_of_the_stages_add_up_and_the_sum_is_no_stage():
    times = stage_times(fabricate.replace(WHOLE, stage_ms={**WHOLE.stage_ms, "total": np.ones(200)}))
    assert "total" not in [stage.name for stage in times]
    assert sum(stage.share for stage in times) == pytest.approx(1.0)


def test_frames_in_which_a_stage_did_not_run_do_not_count():
    ms = np.array([0.0, 10.0, np.nan, 20.0])
    (stage,) = stage_times(fabricate.replace(WHOLE, stage_ms={"optimise": ms, "never": np.zeros(4)}))
    assert stage.median == 15.0


@pytest.mark.parametrize(
    ("accepted", "verified", "in_graph", "word"),
    [(True, True, True, "kept"), (True, True, False, "dropped"), (True, False, False, "unverified"),
     (False, False, False, "unlikely")],
)  # fmt: skip
def test_the_outcome_of_a_match_is_one_word(accepted, verified, in_graph, word):
    assert loop_outcome(LoopRow(9, 1, 0.5, accepted, verified=verified, in_graph=in_graph)) == word


def test_the_summary_names_estimates_errors_loops_and_speed():
    shown = printed(WHOLE)
    for words in (
        "corrected",
        "0.83",
        "SE(3)",
        "19 proposed, 13 verified, 13 kept",
        "21.3 per second",
        "read ",
    ):
        assert words in shown


def test_the_summary_of_a_drive_without_truth_has_dashes():
    shown = printed(fabricate.without_truth(WHOLE))
    assert "no ground truth" in shown
    assert MISSING in shown


def test_brackets_in_a_name_are_not_taken_for_markup():
    assert "[bold]x" in printed(fabricate.replace(WHOLE, name="[bold]x"))
