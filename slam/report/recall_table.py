"""Table 4.2 of the chapter: R@P100 of each paradigm on each data set, the published value beside ours."""

from collections.abc import Mapping
from dataclasses import dataclass

from matplotlib.figure import Figure

from slam.report import colours
from slam.report.figures import INK, new_figure

# Per cent. Chapter, Table 4.2; the two baselines are not in it.
SETS = ("KITTI 00", "KITTI 05", "Malaga 2009 6L", "New College", "City Centre")
PUBLISHED: dict[str, tuple[float, ...]] = {
    "sequence-histograms": (81.5, 84.8, 81.5, 77.6, 68.5),
    "dynamic-sequences": (96.5, 97.3, 87.6, 92.7, 71.1),
    "hierarchical-places": (93.1, 94.2, 87.9, 88.0, 16.3),
    "tracked-words": (97.5, 92.6, 85.0, 83.0, 20.0),
}
DOUBTFUL = ("sequence-histograms", "Malaga 2009 6L")
FOOTNOTE = "* 76.8 in the paper itself (IROS 2016, Table II); 81.5 there is the figure of another method."


@dataclass(frozen=True)
class RecallTable:
    """R@P100 that was measured.

    Attributes:
        paradigms: names, row by row.
        measured: (paradigm, data set) to R@P100 in per cent; what was not measured is not in it.
    """

    paradigms: tuple[str, ...]
    measured: Mapping[tuple[str, str], float]

    def cell(self, paradigm: str, data_set: str) -> str:
        """Ours and the published value; a dash for what there is not."""
        ours = self.measured.get((paradigm, data_set))
        return f"{'-' if ours is None else f'{ours:.1f}'} ({published(paradigm, data_set)})"

    def rows(self) -> list[list[str]]:
        """The cells, headings first."""
        cells = [[name, *(self.cell(name, data_set) for data_set in SETS)] for name in self.paradigms]
        return [["R@P100 [%]: ours (published)", *SETS], *cells]


def published(paradigm: str, data_set: str) -> str:
    """The published value, marked where it is doubtful; a dash where there is none."""
    if paradigm not in PUBLISHED:
        return "-"
    value = f"{PUBLISHED[paradigm][SETS.index(data_set)]:.1f}"
    return f"{value}*" if (paradigm, data_set) == DOUBTFUL else value


def as_text(table: RecallTable) -> str:
    """The table in columns."""
    rows = table.rows()
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:], FOOTNOTE])


def as_latex(table: RecallTable) -> str:
    """The table for a paper (package booktabs)."""
    head, *rows = ([cell.replace("%", r"\%").replace("*", r"$^*$") for cell in row] for row in table.rows())
    return "\n".join(
        [
            r"\begin{tabular}{l" + "r" * len(SETS) + "}",
            r"\toprule",
            " & ".join(head) + r" \\",
            r"\midrule",
            *(" & ".join(row) + r" \\" for row in rows),
            r"\bottomrule",
            r"\end{tabular}",
            f"% {FOOTNOTE}",
            "",
        ]
    )


def as_picture(table: RecallTable) -> Figure:
    """The table as a picture: ours as bars, the published value as a line across."""
    figure = new_figure(2.9 * len(SETS), 1.3 + 0.36 * len(table.paradigms))
    rows = range(len(table.paradigms))
    panels = figure.subplots(1, len(SETS), sharey=True)
    for ax, data_set in zip(panels, SETS, strict=True):
        ours = [table.measured.get((name, data_set), 0.0) for name in table.paradigms]
        ax.barh(rows, ours, height=0.6, color=colours.CORRECTED, label="ours")
        known = [(PUBLISHED[n][SETS.index(data_set)], row) for row, n in enumerate(table.paradigms) if n in PUBLISHED]
        values, at = zip(*known, strict=True) if known else ((), ())
        ax.plot(values, at, "|", color=colours.REJECTED, ms=16, mew=2.5, label="published")
        for row, name in enumerate(table.paradigms):
            ax.text(103, row, table.cell(name, data_set), va="center", fontsize=8, color=INK)
        ax.set(xlim=(0, 100), title=data_set, xlabel="R@P100 [%]")
        ax.spines[["top", "right"]].set_visible(False)
    panels[0].set_yticks(list(rows), table.paradigms)
    panels[0].invert_yaxis()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, labelcolor=INK)
    figure.text(0.005, 0.005, FOOTNOTE, fontsize=7, color=INK)
    return figure
