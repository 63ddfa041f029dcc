"""Results of the runs of a benchmark: rows, medians over the seeds, tables, and files (CSV, JSON, LaTeX, HTML).

`report.html` has a table of all runs, and a chart of R@P100 over the trajectory error.
"""

import shlex
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import asdict, astuple, dataclass, fields, replace
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from rich.markup import escape
from rich.table import Table

from slam.benchmark.job import Job, JobResult
from slam.external.matches_file import short_name
from slam.io.files import atomic_writer
from slam.io.frames_and_loops_csv import write_table
from slam.io.metrics import write_metrics
from slam.report import style
from slam.report.formatting import MISSING, Cell, format_value, metric_value
from slam.report.html_report import template_environment
from slam.report.style import INK, inline_svg, new_figure, style_axes

# Paradigms differ in shape as well as in colour, for readers who are colour-blind.
_MARKS = (
    ("o", style.CORRECTED),
    ("s", style.ODOMETRY),
    ("^", style.ACCEPTED),
    ("D", style.REJECTED),
    ("v", style.ONLINE),
    ("P", style.GROUND_TRUTH),
)

_MIN_AXIS_M = 0.01  # smallest upper end of the error axis: runs without any error would give it no length


@dataclass(frozen=True)
class ResultRow:
    """One run of a benchmark, a line of `results.csv`; None for an unknown value.

    Attributes:
        run: name of the run and of its folder below `jobs`.
        source, paradigm, robust, seed, preset, odometry: the combination that was run; the preset of a run that failed
            is known where the benchmark names it, and so is the odometry.
        frames: number of frames.
        path_length_m: path length by ground truth, metres.
        odometry_ate_m, ate_m: ATE of the odometry and of the corrected trajectory, metres.
        t_rel_percent, r_rel_deg_per_100m: errors of the corrected trajectory by the KITTI rule.
        loops_kept, loops_false: number of loops in the corrected graph, and of false ones among them.
        recall_at_100_precision, average_precision: quality of the place recogniser alone.
        frames_per_second, wall_seconds: speed and duration of the run, possibly with others beside it.
        peak_memory_mb: peak memory of the process, which may have done other runs before.
        error: reason of the failure; empty if there was none.
    """

    run: str
    source: str
    paradigm: str
    robust: str
    seed: int
    preset: str = ""
    frames: object = None
    path_length_m: object = None
    odometry_ate_m: object = None
    ate_m: object = None
    t_rel_percent: object = None
    r_rel_deg_per_100m: object = None
    loops_kept: object = None
    loops_false: object = None
    recall_at_100_precision: object = None
    average_precision: object = None
    frames_per_second: object = None
    wall_seconds: object = None
    peak_memory_mb: object = None
    odometry: str = ""
    error: str = ""

    @property
    def method(self) -> str:
        """Name of the paradigm, with its preset if that is not the default, and the odometry if the sweep has some."""
        preset = "" if self.preset == "default" else self.preset
        return ", ".join(part for part in (self.odometry, self.paradigm, preset) if part)


# Dotted keys of the values in metrics.json.
_METRICS_KEYS = {
    "frames": "frames",
    "path_length_m": "path_length_m",
    "odometry_ate_m": "odometry.ate_m",
    "ate_m": "corrected.ate_m",
    "t_rel_percent": "corrected.t_rel_percent",
    "r_rel_deg_per_100m": "corrected.r_rel_deg_per_100m",
    "loops_kept": "loops.kept",
    "loops_false": "loops.false",
    "recall_at_100_precision": "places.recall_at_100_precision",
    "average_precision": "places.average_precision",
    "frames_per_second": "frames_per_second",
    "wall_seconds": "wall_seconds",
    "peak_memory_mb": "peak_memory_mb",
}

# Columns of the tables for people: field, heading, digits after the decimal point.
DISPLAYED = (
    ("odometry_ate_m", "odometry ATE [m]", 2),
    ("ate_m", "ATE [m]", 2),
    ("t_rel_percent", "t_rel [%]", 2),
    ("loops_kept", "loops", 0),
    ("loops_false", "false", 0),
    ("recall_at_100_precision", "R@P100", 3),
    ("frames_per_second", "frames/s", 1),
)

_NOT_IN_TERMINAL = ("t_rel_percent", "frames_per_second")  # left out there, because the names need the space

# Characters that LaTeX would not print as they are. A missing value is a dash of the text, not of mathematics.
_LATEX_ESCAPES = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    MISSING: "--",
} | {sign: f"\\{sign}" for sign in "&%$#_{}"}


def make_row(job: Job, result: JobResult) -> ResultRow:
    """Make the row of a job from its metrics."""
    values = {name: metric_value(result.metrics, key) for name, key in _METRICS_KEYS.items()}
    preset = job.preset or str(result.metrics.get("preset", ""))
    paradigm, odometry = short_name(job.paradigm), short_name(job.odometry or "")
    row = ResultRow(
        job.name, job.source_name, paradigm, job.robust, job.seed, preset, odometry=odometry, error=result.error
    )
    return replace(row, **values)  # type: ignore[arg-type]


def format_row(row: ResultRow) -> str:
    """Format a row as one line of text."""
    if row.error:
        return f"{row.run}: failed: {row.error}"
    loops = f"{format_value(row.loops_kept)} loops kept, {format_value(row.loops_false)} of them false"
    recall = f"R@P100 {format_value(row.recall_at_100_precision, 3)}"
    ate = f"ATE {format_value(row.odometry_ate_m)} m by odometry, {format_value(row.ate_m)} m corrected"
    return f"{row.run}: {ate}; {loops}; {recall}"


def write_csv(folder: Path, rows: Iterable[ResultRow]) -> None:
    """Write results.csv, a line for each row.

    Raises:
        OutputError: the file cannot be written.
    """
    write_table(folder / "results.csv", [field.name for field in fields(ResultRow)], map(astuple, rows))


def write_json(folder: Path, rows: Iterable[ResultRow], command: Sequence[str]) -> None:
    """Write results.json, an object for each row.

    Raises:
        OutputError: the file cannot be written.
    """
    runs = [asdict(row) for row in rows]
    write_metrics(folder / "results.json", {"command": shlex.join(["revisit", *command]), "runs": runs})


def median_rows(rows: Sequence[ResultRow]) -> list[tuple[ResultRow, int]]:
    """Merge rows that differ only in the seed: the median of each number, and the number of rows merged.

    Failed runs have no numbers and are left out.
    """
    groups: dict[tuple[str, ...], list[ResultRow]] = {}
    for row in rows:
        if not row.error:
            groups.setdefault((row.source, row.odometry, row.paradigm, row.preset, row.robust), []).append(row)
    return [(_median(group), len(group)) for group in groups.values()]


def _median(group: Sequence[ResultRow]) -> ResultRow:
    values: dict[str, Any] = {name: _median_value([getattr(row, name) for row in group]) for name in _METRICS_KEYS}
    return replace(group[0], **values)


def _median_value(values: Sequence[object]) -> object:
    numbers = [number for number in values if isinstance(number, int | float)]
    return statistics.median(numbers) if numbers else None


def summary_table(rows: Sequence[ResultRow]) -> Table:
    """Make the table for the terminal. Unknown values are dashes."""
    table = Table(caption="ATE after alignment of all poses", caption_justify="left", box=None)
    table.add_column("run", overflow="fold")
    columns = [column for column in DISPLAYED if column[0] not in _NOT_IN_TERMINAL]
    for _, heading, _ in columns:
        table.add_column(escape(heading), justify="right")
    for row in rows:
        table.add_row(escape(row.run), *(format_value(getattr(row, name), digits) for name, _, digits in columns))
    return table


def format_values(row: ResultRow) -> list[str]:
    """Format the numbers of a row in the order of `DISPLAYED`."""
    return [format_value(getattr(row, name), digits) for name, _, digits in DISPLAYED]


def write_latex(folder: Path, rows: Sequence[ResultRow]) -> None:
    """Write tables.tex: one table, a line for each source, paradigm and back end, with medians over the seeds.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_writer(folder / "tables.tex") as file:
        file.write(latex_table(rows))


def latex_table(rows: Sequence[ResultRow]) -> str:
    """Format the table as text; failed runs are left out."""
    headings = ("source", "paradigm", "back end", "runs", *(heading for _, heading, _ in DISPLAYED))
    lines = [
        "% needs \\usepackage{booktabs}; medians over the seeds; ATE after alignment of all poses",
        f"\\begin{{tabular}}{{lll{'r' * (len(headings) - 3)}}}",
        "\\toprule",
        _line(headings),
        "\\midrule",
        *(
            _line((row.source, row.method, row.robust, str(runs), *format_values(row)))
            for row, runs in median_rows(rows)
        ),
        "\\bottomrule",
        "\\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def _line(cells: Sequence[str]) -> str:
    return " & ".join(escape_latex(cell) for cell in cells) + r" \\"


def escape_latex(text: str) -> str:
    """Escape a text so that LaTeX prints every character of it."""
    return "".join(_LATEX_ESCAPES.get(sign, sign) for sign in text)


def write_benchmark_report(folder: Path, name: str, rows: Sequence[ResultRow]) -> None:
    """Write report.html of a benchmark.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_writer(folder / "report.html") as file:
        file.write(render_page(name, rows))


def render_page(name: str, rows: Sequence[ResultRow]) -> str:
    """Render the page as text; names are escaped by the template engine."""
    figure = recall_over_error_figure(rows)
    title = "R@P100 of each run over the position error of its corrected trajectory"
    return (
        template_environment()
        .get_template("benchmark.html.jinja")
        .render(
            name=name,
            headline=_headline(rows),
            figure=None if figure is None else inline_svg(figure, "runs", title),
            headings=[heading for _, heading, _ in DISPLAYED],
            rows=[(row, _cells(row)) for row in rows],
        )
    )


def _headline(rows: Sequence[ResultRow]) -> str:
    failed = sum(bool(row.error) for row in rows)
    runs = f"{len(rows)} run{'' if len(rows) == 1 else 's'}"
    return f"{runs}, {failed} of them failed." if failed else f"{runs}, none failed."


def _cells(row: ResultRow) -> list[Cell]:
    values = [getattr(row, name) for name, _, _ in DISPLAYED]
    return [
        Cell(text, order=found if isinstance(found, int | float) else "")
        for text, found in zip(format_values(row), values, strict=True)
    ]


def recall_over_error_figure(rows: Sequence[ResultRow]) -> Figure | None:
    """Draw R@P100 over ATE with a mark for each run; None if no run has both."""
    complete = [row for row in rows if row.ate_m is not None and row.recall_at_100_precision is not None]
    if not complete:
        return None
    figure = new_figure(5.6, 3.4)
    ax = figure.subplots()
    for n, method in enumerate(dict.fromkeys(row.method for row in complete)):
        points = [(row.ate_m, row.recall_at_100_precision) for row in complete if row.method == method]
        mark, colour = _MARKS[n % len(_MARKS)]
        ax.plot(*zip(*points, strict=True), mark, color=colour, ms=7, label=method)
    ax.set(xlabel="ATE, corrected [m]", ylabel="R@P100", ylim=(0.0, 1.05))
    ax.set_xlim(0.0, 1.08 * max(ax.dataLim.x1, _MIN_AXIS_M))
    style_axes(ax)
    figure.legend(loc="outside upper center", ncols=3, frameon=False, labelcolor=INK, columnspacing=1.0)
    return figure
