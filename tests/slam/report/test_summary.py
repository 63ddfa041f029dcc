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
    return page.getvalue()


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
