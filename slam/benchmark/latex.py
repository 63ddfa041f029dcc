"""`tables.tex`: the figures of a benchmark for a paper, with the package booktabs."""

from collections.abc import Sequence
from pathlib import Path

from slam.benchmark.results import SHOWN, Row, medians, shown
from slam.report.reading import MISSING
from slam.storage.atomic import atomic_writer

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    MISSING: "--",
} | {sign: f"\\{sign}" for sign in "&%$#_{}"}


def write_latex(folder: Path, rows: Sequence[Row]) -> None:
    """Write tables.tex: one table, a line for each source, paradigm and back end, medians over the seeds.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_writer(folder / "tables.tex") as file:
        file.write(latex(rows))


def latex(rows: Sequence[Row]) -> str:
    """The table as text; failed runs are left out."""
    headings = ("source", "paradigm", "back end", "runs", *(heading for _, heading, _ in SHOWN))
    lines = [
        "% needs \\usepackage{booktabs}; medians over the seeds; ATE after alignment of all poses",
        f"\\begin{{tabular}}{{lll{'r' * (len(headings) - 3)}}}",
        "\\toprule",
        _line(headings),
        "\\midrule",
        *(_line((row.source, row.paradigm, row.robust, str(runs), *shown(row))) for row, runs in medians(rows)),
        "\\bottomrule",
        "\\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def _line(cells: Sequence[str]) -> str:
    return " & ".join(escape(cell) for cell in cells) + r" \\"


def escape(plain: str) -> str:
    """Text as LaTeX shows it, whatever signs are in it."""
    return "".join(_SPECIAL.get(sign, sign) for sign in plain)
