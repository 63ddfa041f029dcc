"""`report.html` of a benchmark: a table of all runs, and a chart of R@P100 over the trajectory error."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from slam.benchmark.sweep_results import DISPLAYED, ResultRow, format_values
from slam.io.files import atomic_writer
from slam.report import style
from slam.report.formatting import Cell
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
