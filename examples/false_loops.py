"""Breakdown of each robust back end: more and more false loops are put into a graph.

    python examples/false_loops.py [GRAPH.g2o ...] --out DIR [--kinds random grouped] [--shares 0 0.5 0.9]

Without a graph a drive of two laps is simulated. The error is that of the graph without false loops: half
chi-square of its edges, over its minimum. The table is printed and written as false_loops.csv, the plot as
false_loops.png.
"""

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slam.errors import RevisitError
from slam.evaluation.outlier_injection import KINDS, ContaminatedProblem, OutlierConfig, inject_outliers
from slam.io.frames_and_loops_csv import write_table
from slam.io.g2o import read_g2o
from slam.io.g2o_problem import classify_edges
from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.gtsam_solver import optimize
from slam.pose_graph.optimization.lie_groups import SE2, compose, inverse
from slam.pose_graph.robust.backends import BACK_ENDS, LoopProblem, solve
from slam.report.style import new_figure, save_png, style_axes

Array = NDArray[np.float64]

COLUMNS = ("graph", "kind", "share", "back_end", "error_ratio", "true", "true_kept", "false", "false_kept", "seconds")
SHARES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9)


@dataclass(frozen=True)
class Row:
    """One line of the table; an `error_ratio` of one means that the false loops did no harm."""

    graph: str
    kind: str
    share: float
    back_end: str
    error_ratio: float
    true: int
    true_kept: int
    false: int
    false_kept: int
    seconds: float


def main() -> None:
    """Read the arguments, fill the table and draw it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("graphs", nargs="*", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    parser.add_argument("--shares", nargs="+", type=float, default=list(SHARES))
    parser.add_argument("--back-ends", nargs="+", default=list(BACK_ENDS), choices=list(BACK_ENDS))
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    graphs = {path.stem: classify_edges(read_g2o(path), str(path)).problem for path in arguments.graphs}
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    for name, problem in (graphs or {"two_laps": two_laps(arguments.seed)}).items():
        for row in evaluate(name, problem, arguments):
            rows.append(row)
            print(format_row(row), flush=True)
    write_table(arguments.out / "false_loops.csv", COLUMNS, (vars(row).values() for row in rows))
    save_png(draw(rows), arguments.out / "false_loops.png")


def evaluate(name: str, problem: LoopProblem, arguments: argparse.Namespace) -> Iterator[Row]:
    """Return the rows of one graph."""
    clean = problem.edges_with(np.ones(len(problem.loops), dtype=bool))
    poses = optimize(clean, problem.start)
    minimum = float(clean.chi2(poses).sum())
    for kind in arguments.kinds:
        for share in arguments.shares:
            mixed = inject_outliers(problem, poses, OutlierConfig(kind, share, arguments.seed))
            for back_end in arguments.back_ends:
                yield run_trial(Trial(name, kind, share, back_end), mixed, clean, minimum)


@dataclass(frozen=True)
class Trial:
    """A graph, a kind and a share of false loops, and a back end."""

    graph: str
    kind: str
    share: float
    back_end: str


def run_trial(trial: Trial, mixed: ContaminatedProblem, clean: Edges, minimum: float) -> Row:
    """Optimise with one back end and compare with the graph without false loops (edges, minimum chi-square)."""
    start = time.perf_counter()
    result = solve(mixed.problem, trial.back_end)
    seconds = time.perf_counter() - start
    kept, true = result.kept, mixed.true
    ratio = float(clean.chi2(result.poses).sum()) / minimum
    counts = (int(true.sum()), int(kept[true].sum()), int((~true).sum()), int(kept[~true].sum()))
    return Row(*vars(trial).values(), ratio, *counts, seconds)


def two_laps(seed: int, side: int = 100) -> LoopProblem:
    """Drive twice round a block in steps of 1 m, with noise; every second step of the second lap closes a loop."""
    rng, group = np.random.default_rng(seed), SE2()
    step_sigma, loop_sigma = np.array([0.03, 0.02, 0.003]), np.array([0.05, 0.05, 0.005])
    count = 8 * side
    turning = np.arange(count) % side >= side - 10
    steps = np.column_stack([np.ones(count), np.zeros(count), np.where(turning, np.pi / 20, 0.0)])
    true = group.exp(steps)
    poses = compose(np.eye(3), true)
    odometry = true @ group.exp(rng.normal(size=(count, 3)) * step_sigma)
    rows = np.arange(count, dtype=np.int64)
    trusted = Edges(rows, rows + 1, odometry, np.tile(np.diag(step_sigma**-2), (count, 1, 1)))
    later = np.arange(4 * side + 4, count, 2, dtype=np.int64)
    measured = (
        inverse(poses[later - 4 * side]) @ poses[later] @ group.exp(rng.normal(size=(len(later), 3)) * loop_sigma)
    )
    loops = Edges(later - 4 * side, later, measured, np.tile(np.diag(loop_sigma**-2), (len(later), 1, 1)))
    return LoopProblem(trusted, loops, compose(np.eye(3), odometry))


def format_row(row: Row) -> str:
    """Format a row for the terminal."""
    return (
        f"{row.graph:16} {row.kind:9} {row.share:4.0%}  {row.back_end:10} error x {row.error_ratio:<9.4g} "
        f"true {row.true_kept:5d} of {row.true:5d}  false {row.false_kept:5d} of {row.false:5d}  {row.seconds:6.2f} s"
    )


def draw(rows: list[Row]) -> Figure:
    """Plot error and time over the share of false loops, a column for each graph and kind."""
    panels = list(dict.fromkeys((row.graph, row.kind) for row in rows))
    figure = new_figure(3.6 * len(panels) + 1.5, 6.5)
    axes = figure.subplots(2, len(panels), squeeze=False, sharex=True)
    for column, panel in enumerate(panels):
        for back_end in dict.fromkeys(row.back_end for row in rows):
            line = [row for row in rows if (row.graph, row.kind, row.back_end) == (*panel, back_end)]
            shares = [100 * row.share for row in line]
            axes[0, column].plot(shares, [row.error_ratio for row in line], "o-", ms=3, label=back_end)
            axes[1, column].plot(shares, [row.seconds for row in line], "o-", ms=3)
        axes[0, column].set(title=" ".join(panel), yscale="log")
        axes[1, column].set(xlabel="false loops [%]", yscale="log")
    for ax in axes.ravel():
        style_axes(ax)
    axes[0, 0].set_ylabel("error over that of the clean graph")
    axes[1, 0].set_ylabel("time [s]")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=7, frameon=False)
    return figure


if __name__ == "__main__":
    try:
        main()
    except (RevisitError, OSError) as error:
        sys.exit(str(error))
