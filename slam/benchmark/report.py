"""`report.html` of a benchmark: every run in one table, and place recognition against the trajectory it led to."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from slam.benchmark.results import SHOWN, Row, shown
from slam.report import colours
from slam.report.cells import Cell
from slam.report.figures import INK, new_figure, style_axes
from slam.report.page import template_environment
from slam.report.svg import inline_svg
from slam.storage.atomic import atomic_writer

# Told apart by shape as well as by hue.
_MARKS = (
    ("o", colours.CORRECTED),
    ("s", colours.ODOMETRY),
    ("^", colours.ACCEPTED),
    ("D", colours.REJECTED),
    ("v", colours.ONLINE),
    ("P", colours.GROUND_TRUTH),
)

_SMALLEST_M = 0.01  # of the scale of errors, for runs without any


def write_report(folder: Path, name: str, rows: Sequence[Row]) -> None:
    """Write the page.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_writer(folder / "report.html") as file:
        file.write(render(name, rows))


def render(name: str, rows: Sequence[Row]) -> str:
    """The page as text; names are escaped by the template engine."""
    figure = places_and_errors(rows)
    title = "R@P100 of each run over the position error of its corrected trajectory"
    return (
        template_environment()
        .get_template("benchmark.html.jinja")
        .render(
            name=name,
            verdict=_verdict(rows),
            figure=None if figure is None else inline_svg(figure, "runs", title),
            headings=[heading for _, heading, _ in SHOWN],
            rows=[(row, _cells(row)) for row in rows],
        )
    )


def _verdict(rows: Sequence[Row]) -> str:
    failed = sum(bool(row.error) for row in rows)
    runs = f"{len(rows)} run{'' if len(rows) == 1 else 's'}"
    return f"{runs}, {failed} of them failed." if failed else f"{runs}, none failed."


def _cells(row: Row) -> list[Cell]:
    values = [getattr(row, name) for name, _, _ in SHOWN]
    return [
        Cell(text, order=found if isinstance(found, int | float) else "")
        for text, found in zip(shown(row), values, strict=True)
    ]


def places_and_errors(rows: Sequence[Row]) -> Figure | None:
    """Draw R@P100 over ATE, a mark for each run; None where no run has both."""
    known = [row for row in rows if row.ate_m is not None and row.recall_at_100_precision is not None]
    if not known:
        return None
    figure = new_figure(5.6, 3.4)
    ax = figure.subplots()
    for n, paradigm in enumerate(dict.fromkeys(row.paradigm for row in known)):
        points = [(row.ate_m, row.recall_at_100_precision) for row in known if row.paradigm == paradigm]
        mark, colour = _MARKS[n % len(_MARKS)]
        ax.plot(*zip(*points, strict=True), mark, color=colour, ms=7, label=paradigm)
    ax.set(xlabel="ATE, corrected [m]", ylabel="R@P100", ylim=(0.0, 1.05))
    ax.set_xlim(0.0, 1.08 * max(ax.dataLim.x1, _SMALLEST_M))
    style_axes(ax)
    figure.legend(loc="outside upper center", ncols=3, frameon=False, labelcolor=INK, columnspacing=1.0)
    return figure
