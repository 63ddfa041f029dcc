"""The summary of a run, on paper and in the terminal, shows the recogniser beside the trajectory."""

import io
from dataclasses import replace

from rich.console import Console

from slam.report.formatting import summary_table
from slam.report.html_report import render_report
from slam.run_result import RunRecord

from .fabricate import record


def record_with_recall() -> RunRecord:
    whole = record()
    places = {"recall_at_100_precision": 0.875, "average_precision": 0.9375}
    return replace(whole, metrics=whole.metrics | {"places": places})


def shown(drive: RunRecord) -> str:
    page = io.StringIO()
    Console(width=200, file=page).print(summary_table(drive))
    return " ".join(page.getvalue().split())  # without line breaks


def test_the_terminal_shows_the_recall_at_full_precision():
    assert "places: R@P100 0.875" in shown(record_with_recall())


def test_the_terminal_shows_revisit_events_and_how_late_answers_come():
    whole = record_with_recall()
    more = {"events": {"found": 3, "count": 4}, "delay_frames": {"median": 15.0, "max": 20.0}}
    whole.metrics["places"] |= more
    assert "revisit events: 3 of 4 found; an answer comes 15 images late (median)" in shown(whole)


def test_the_terminal_is_silent_about_a_recall_that_is_not_known():
    assert "R@P100" not in shown(replace(record(), metrics={}))


def test_the_report_shows_the_recogniser_by_itself():
    page = " ".join(render_report(record_with_recall(), None, {}).split())
    assert "R@P100 0.875, average precision 0.938." in page


def with_loop_errors_and_settings() -> RunRecord:
    whole = record()
    errors = {
        "translation_error_m": {"median": 0.0125, "p95": 0.25, "max": 1.5},
        "rotation_error_deg": {"median": 0.03, "p95": 0.5, "max": 2.25},
    }
    changed = {"changed_settings": {"robust": {"value": "gnc", "default": "pcm+gnc"}}}
    return replace(whole, metrics=whole.metrics | {"loops": whole.metrics["loops"] | errors} | changed)


WORDS = ("median / 95 % / max: 0.013 / 0.250 / 1.500 m, 0.030 / 0.500 / 2.250 deg", "robust = gnc (default pcm+gnc)")


def test_the_terminal_shows_the_errors_of_the_loops_and_the_settings_that_differ():
    drawn = shown(with_loop_errors_and_settings())
    assert f"error of the kept loops, {WORDS[0]}" in drawn
    assert f"not the default: {WORDS[1]}" in drawn
    assert "error of the kept loops" not in shown(record())
    assert "not the default" not in shown(record())


def test_the_report_shows_the_errors_of_the_loops_and_the_settings_that_differ():
    page = " ".join(render_report(with_loop_errors_and_settings(), None, {"robust": "gnc"}).split())
    assert WORDS[0] in page
    assert WORDS[1] in page.split('id="changed"')[1]
    plain = " ".join(render_report(record(), None, {"robust": "pcm+gnc"}).split())
    assert "All settings have their defaults." in plain
    assert "Relative poses compared" not in plain
