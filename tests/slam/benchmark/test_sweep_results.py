"""Figures of many runs side by side, as text that nothing in a name can break."""

import csv
import io
import json
from pathlib import Path

import pytest
from rich.console import Console

from slam.benchmark.sweep_results import (
    ResultRow,
    escape_latex,
    format_row,
    latex_table,
    make_row,
    median_rows,
    recall_over_error_figure,
    render_page,
    summary_table,
    write_benchmark_report,
    write_csv,
    write_json,
)

from ..report.browser import NO_BROWSER, browser, has_browser

HOSTILE = '<b>"&amp; улица_50%'


def row(run: str = "one", paradigm: str = "tracked-words", seed: int = 0, **known: object) -> ResultRow:
    return ResultRow(run, "street", paradigm, "gnc", seed, **known)  # type: ignore[arg-type]


ROWS = [
    row("a", seed=0, ate_m=1.0, recall_at_100_precision=0.9, loops_kept=3),
    row("b", seed=1, ate_m=10.0, recall_at_100_precision=0.7, loops_kept=4),
    row("c", seed=2, ate_m=2.0, loops_kept=9),
    row("d", paradigm="pixel-sequences", error="no vocabulary"),
    row(HOSTILE, paradigm=HOSTILE, ate_m=0.5, recall_at_100_precision=0.8),
]


def test_runs_that_differ_in_their_seed_alone_are_one_line_of_medians():
    found = {one.paradigm: (one, runs) for one, runs in median_rows(ROWS)}
    together, runs = found["tracked-words"]
    assert (together.ate_m, together.loops_kept, runs) == (2.0, 4, 3)
    assert together.recall_at_100_precision == pytest.approx(0.8)
    assert "pixel-sequences" not in found


def test_runs_of_different_presets_are_different_lines():
    rows = [row("a", preset="default", ate_m=1.0), row("b", preset="published", ate_m=3.0)]
    assert [(one.ate_m, runs) for one, runs in median_rows(rows)] == [(1.0, 1), (3.0, 1)]
    assert [one.method for one in rows] == ["tracked-words", "tracked-words, published"]
    assert "tracked-words, published & gnc" in latex_table(rows)
    assert "<td>tracked-words, published</td>" in render_page("x", rows)


def test_csv_and_json_hold_every_digit_and_leave_empty_what_is_not_known(tmp_path: Path):
    rows = [row(ate_m=0.1 + 0.2, path_length_m=float("nan")), *ROWS]
    write_csv(tmp_path, rows)
    write_json(tmp_path, rows, ["benchmark", HOSTILE])
    lines = list(csv.DictReader((tmp_path / "results.csv").open(encoding="utf-8")))
    runs = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))["runs"]
    assert float(lines[0]["ate_m"]) == runs[0]["ate_m"] == 0.1 + 0.2
    assert lines[0]["path_length_m"] == ""
    assert runs[0]["path_length_m"] is None
    assert lines[4]["error"] == runs[4]["error"] == "no vocabulary"
    assert lines[5]["run"] == runs[5]["run"] == HOSTILE


def test_latex_shows_every_sign_and_has_as_many_cells_in_each_line():
    assert escape_latex(r"50% of a_b & \c{d}") == r"50\% of a\_b \& \textbackslash{}c\{d\}"
    lines = [line for line in latex_table(ROWS).splitlines() if line.endswith(r"\\")]
    cells = {line.replace(r"\&", "").count("&") for line in lines}
    assert len(lines) == 1 + 2  # the failed run is none
    assert len(cells) == 1


def test_the_terminal_shows_names_as_they_are_and_what_failed():
    console = Console(record=True, width=200, file=io.StringIO())
    console.print(summary_table([row("[bold]x", ate_m=1.25)]))
    shown = console.export_text()
    assert "[bold]x" in shown
    assert "1.25" in shown
    assert format_row(ROWS[3]) == "d: failed: no vocabulary"


def test_the_page_escapes_names_and_draws_every_run_that_has_both_numbers():
    page = render_page(HOSTILE, ROWS)
    assert "<b>" not in page
    assert "no vocabulary" in page
    figure = recall_over_error_figure(ROWS)
    drawn = {tuple(point) for line in figure.axes[0].lines for point in line.get_xydata().tolist()}
    assert drawn == {(1.0, 0.9), (10.0, 0.7), (0.5, 0.8)}


def test_without_ground_truth_there_is_a_page_all_the_same():
    assert recall_over_error_figure([row()]) is None
    assert "1 run, none failed" in render_page("x", [row()])


@pytest.mark.skipif(not has_browser(), reason=NO_BROWSER)
def test_the_page_sorts_by_its_headings_and_loads_nothing(tmp_path: Path):
    path = tmp_path / "report.html"
    write_benchmark_report(tmp_path, HOSTILE, ROWS)
    cells = "return [...document.querySelectorAll('#runs tbody tr')].map((row) => row.cells[arguments[0]].textContent)"
    with browser() as page:
        page.open(path)
        ate = page.run(
            "return [...document.querySelectorAll('#runs th')].findIndex((h) => h.textContent === 'ATE [m]')"
        )
        page.run("document.querySelectorAll('#runs thead button')[arguments[0]].click()", ate)
        assert page.run(cells, ate)[:4] == ["0.50", "1.00", "2.00", "10.00"]  # by size, what failed last
        page.run("document.querySelectorAll('#runs thead button')[arguments[0]].click()", ate)
        assert page.run(cells, ate)[:4] == ["10.00", "2.00", "1.00", "0.50"]
        assert page.run("return document.querySelector('#runs tbody tr:nth-child(4) th').textContent") == HOSTILE
        assert page.loaded() == [path.as_uri()]
        assert page.complaints() == []


def test_a_row_takes_its_numbers_from_the_metrics(tmp_path: Path):
    class Named:
        name, source_name, paradigm, robust, seed, preset = "one", "street", "p", "gnc", 3, None
        odometry = "file:results/orbslam.txt"

    class Done:
        error = ""
        metrics = {"frames": 9, "odometry": {"ate_m": 2.0}, "corrected": {"ate_m": 1.0}, "loops": {"false": 0}}  # noqa: RUF012

    Done.metrics["preset"] = "published"
    made = make_row(Named, Done)  # type: ignore[arg-type]
    assert made.preset == "published"
    assert made.method == "file-orbslam, p, published"
    assert (made.frames, made.odometry_ate_m, made.ate_m, made.loops_false, made.loops_kept) == (9, 2.0, 1.0, 0, None)
