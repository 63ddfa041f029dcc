"""`tables.tex`: the results of a benchmark as a LaTeX table for a paper (package booktabs)."""

from collections.abc import Sequence
from pathlib import Path

from slam.benchmark.results import DISPLAYED, ResultRow, format_values, median_rows
from slam.report.reading import MISSING
from slam.storage.atomic import atomic_writer

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    MISSING: "--",
} | {sign: f"\\{sign}" for sign in "&%$#_{}"}


def write_latex(folder: Path, rows: Sequence[ResultRow]) -> None:
    """Write tables.tex: one table, a line for each source, paradigm and back end, median_rows over the seeds.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_writer(folder / "tables.tex") as file:
        file.write(latex_table(rows))


def latex_table(rows: Sequence[ResultRow]) -> str:
    """Format the table as text; failed runs are left out."""
    headings = ("source", "paradigm", "back end", "runs", *(heading for _, heading, _ in DISPLAYED))
    lines = [
        "% needs \\usepackage{booktabs}; median_rows over the seeds; ATE after alignment of all poses",
        f"\\begin{{tabular}}{{lll{'r' * (len(headings) - 3)}}}",
        "\\toprule",
        _line(headings),
        "\\midrule",
        *(
            _line((row.source, row.paradigm, row.robust, str(runs), *format_values(row)))
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
    return "".join(_SPECIAL.get(sign, sign) for sign in text)
