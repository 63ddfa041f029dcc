"""Table 4.2 of the chapter: R@P100 of each paradigm on each data set, published and measured with both presets."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from slam.report import style
from slam.report.style import INK, new_figure

# Published R@P100 in per cent: the chapter, Table 4.2, which has no baselines.
DATASETS = ("KITTI 00", "KITTI 05", "Malaga 2009 6L", "New College", "City Centre")
PUBLISHED: dict[str, tuple[float, ...]] = {
    "sequence-histograms": (81.5, 84.8, 81.5, 77.6, 68.5),
    "dynamic-sequences": (96.5, 97.3, 87.6, 92.7, 71.1),
    "hierarchical-places": (93.1, 94.2, 87.9, 88.0, 16.3),
    "tracked-words": (97.5, 92.6, 85.0, 83.0, 20.0),
}
DISPUTED = ("sequence-histograms", "Malaga 2009 6L")
PRESETS = ("published", "default")  # the measured columns; that of the published values stands before them
_OFFSETS, _COLOURS = (-0.18, 0.18), (style.ODOMETRY, style.CORRECTED)  # of the bars of both presets
HEADINGS = ("published value", "published preset", "default")
FOOTNOTE = "* 76.8 in the paper itself (IROS 2016, Table II); 81.5 there is the figure of another method."


@dataclass(frozen=True)
class RecallTable:
    """Measured values of R@P100.

    Attributes:
        paradigms: names of the paradigms, in the order of the rows.
        measured: R@P100 in per cent by (paradigm, preset, data set); values that were not measured are missing.
    """

    paradigms: tuple[str, ...]
    measured: Mapping[tuple[str, str, str], float]

    def values(self, paradigm: str, data_set: str) -> list[str]:
        """Return the published value and those measured with the published preset and the default; else a dash."""
        found = [self.measured.get((paradigm, preset, data_set)) for preset in PRESETS]
        return [format_published(paradigm, data_set), *("-" if value is None else f"{value:.1f}" for value in found)]

    def cell(self, paradigm: str, data_set: str) -> str:
        """Return the three values as one text."""
        return " / ".join(self.values(paradigm, data_set))

    def rows(self) -> list[list[str]]:
        """Return the cells, headings first."""
        cells = [[name, *(self.cell(name, data_set) for data_set in DATASETS)] for name in self.paradigms]
        return [["R@P100 [%]", *DATASETS], *cells]


def format_published(paradigm: str, data_set: str) -> str:
    """Return the published value, with an asterisk where it is disputed; a dash where there is none."""
    if paradigm not in PUBLISHED:
        return "-"
    value = f"{PUBLISHED[paradigm][DATASETS.index(data_set)]:.1f}"
    return f"{value}*" if (paradigm, data_set) == DISPUTED else value


def format_text(table: RecallTable) -> str:
    """Return the table as plain text in columns."""
    rows = table.rows()
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:], " / ".join(HEADINGS), FOOTNOTE])


def format_latex(table: RecallTable) -> str:
    """Return the table in LaTeX (package booktabs)."""
    rows = [[name, *(v for data_set in DATASETS for v in table.values(name, data_set))] for name in table.paradigms]
    data_sets = ["", *(rf"\multicolumn{{3}}{{c}}{{{data_set}}}" for data_set in DATASETS)]
    head = [r"R@P100 [\%]", *(len(DATASETS) * ("published", "preset", "default"))]
    return "\n".join(
        [
            r"\begin{tabular}{l" + "r" * len(DATASETS) * len(HEADINGS) + "}",
            r"\toprule",
            " & ".join(data_sets) + r" \\",
            " & ".join(head) + r" \\",
            r"\midrule",
            *(" & ".join(row).replace("*", r"$^*$") + r" \\" for row in rows),
            r"\bottomrule",
            r"\end{tabular}",
            f"% {FOOTNOTE}",
            "",
        ]
    )


def plot_table(table: RecallTable) -> Figure:
    """Plot the table: two bars for the values of both presets, the published value as a line across them."""
    figure = new_figure(3.4 * len(DATASETS), 1.3 + 0.5 * len(table.paradigms))
    rows = np.arange(len(table.paradigms))
    panels = figure.subplots(1, len(DATASETS), sharey=True)
    for ax, data_set in zip(panels, DATASETS, strict=True):
        for preset, label, offset, colour in zip(PRESETS, HEADINGS[1:], _OFFSETS, _COLOURS, strict=True):
            ours = [table.measured.get((name, preset, data_set), 0.0) for name in table.paradigms]
            ax.barh(rows + offset, ours, height=0.32, color=colour, label=label)
        known = [
            (PUBLISHED[n][DATASETS.index(data_set)], row) for row, n in enumerate(table.paradigms) if n in PUBLISHED
        ]
        values, at = zip(*known, strict=True) if known else ((), ())
        ax.plot(values, at, "|", color=style.REJECTED, ms=20, mew=2.5, label=HEADINGS[0])
        for row, name in enumerate(table.paradigms):
            ax.text(103, row, table.cell(name, data_set), va="center", fontsize=7, color=INK)
        ax.set(xlim=(0, 100), title=data_set, xlabel="R@P100 [%]")
        ax.spines[["top", "right"]].set_visible(False)
    panels[0].set_yticks(rows, table.paradigms)
    panels[0].invert_yaxis()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, labelcolor=INK)
    figure.text(0.005, 0.005, FOOTNOTE, fontsize=7, color=INK)
    return figure
