"""`revisit optimize`: pose graphs in, corrected ones out, with a verdict on every loop."""

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from slam.errors import ConfigError
from slam.graph_roles import Roles, roles
from slam.graph_truth import GraphTruth, absolute_error, find_truth
from slam.pose_graph_lie import inverse
from slam.provenance import peak_memory_mb, provenance
from slam.report.figures import save_png
from slam.report.graph_figure import draw_pose_graph
from slam.robust import DEFAULT, Outcome, back_end, solved
from slam.storage.g2o import Graph, read_g2o, write_g2o
from slam.storage.metrics import write_metrics
from slam.storage.run_folder import RunFolder
from slam.storage.tables import write_table

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

EDGE_COLUMNS = ("first", "second", "role", "kept", "weight", "residual", "truth", "reason")


@dataclass(frozen=True)
class OptimizeOptions:
    """What `revisit optimize` was asked for.

    Attributes:
        graphs: g2o files.
        out: folder for the results; one folder each inside it where there are several graphs.
        robust: back end by name.
        ground_truth: poses (KITTI, TUM), or a folder of them, each named as a word of the graph's name.
        overwrite: replace earlier results.
    """

    graphs: tuple[Path, ...]
    out: Path
    robust: str = DEFAULT
    ground_truth: Path | None = None
    overwrite: bool = False


@dataclass(frozen=True)
class Solved:
    """One graph, what was made of it, and what is known to be true.

    Attributes:
        path: of the graph.
        graph: as read.
        roles: its edges, sorted.
        outcome: poses and verdicts, the fixed pose in its place.
        truth: positions and loops.
        seconds: wall clock of the optimisation.
    """

    path: Path
    graph: Graph
    roles: Roles
    outcome: Outcome
    truth: GraphTruth
    seconds: float


def optimize_graphs(options: OptimizeOptions, messages: Console, results: Console) -> None:
    """Optimise graphs and write `metrics.json`, `optimized.g2o`, `edges.csv`, `before_after.png` of each.

    Raises:
        RevisitError: a graph, its truth, the settings or the output folder cannot be used; what was there
            before stays untouched.
    """
    back_end(options.robust)
    if len({path.stem for path in options.graphs}) < len(options.graphs):
        raise ConfigError("expected graphs with different names, found two of one; optimise them one by one")
    table = _table()
    for path in options.graphs:
        out = options.out if len(options.graphs) == 1 else options.out / path.stem
        with RunFolder.create(out, options.overwrite) as folder:
            done = _solve(path, options)
            for warning in done.graph.warnings + done.roles.warnings:
                messages.print(f"warning: {warning}", markup=False, highlight=False, soft_wrap=True)
            section = _section(done, options)
            _write(folder.path, done, _metrics(done, section))
            folder.commit()
        _add_row(table, path, section)
    results.print(table)


def _solve(path: Path, options: OptimizeOptions) -> Solved:
    graph = read_g2o(path)
    sorted_ = roles(graph, str(path))
    truth = find_truth(path, graph, sorted_.trusted, options.ground_truth)
    start = time.perf_counter()
    outcome = solved(sorted_.problem, options.robust)
    seconds = time.perf_counter() - start
    return Solved(path, graph, sorted_, outcome, truth, seconds)


def _in_place(done: Solved) -> Array:
    """Optimised poses (N, n, n) in the file's order, the fixed pose (else the first by id) where the file has it."""
    poses = np.empty_like(done.outcome.poses)
    poses[done.roles.order] = done.outcome.poses
    known = np.flatnonzero(done.graph.ids == done.graph.fixed)
    if known.size and done.graph.placed:
        T_file_ours = done.graph.poses[known[0]] @ inverse(poses[known[0]])
        poses = T_file_ours @ poses
    return poses


def _write(folder: Path, done: Solved, metrics: dict[str, object]) -> None:
    write_metrics(folder / "metrics.json", metrics)
    kept = _kept_edges(done)
    graph = done.graph
    write_g2o(
        folder / "optimized.g2o",
        replace(
            graph,
            poses=_in_place(done),
            first=graph.first[kept],
            second=graph.second[kept],
            motions=graph.motions[kept],
            information=graph.information[kept],
        ),
    )
    write_table(folder / "edges.csv", EDGE_COLUMNS, _rows(done))
    save_png(
        draw_pose_graph(done.path.stem, done.roles.problem, done.outcome, done.truth.positions),
        folder / "before_after.png",
    )


def _kept_edges(done: Solved) -> Mask:
    """(M,) edges of the file that the poses lean on."""
    kept = done.roles.trusted.copy()
    kept[~done.roles.trusted] = done.outcome.kept
    return kept


def _rows(done: Solved) -> list[tuple[object, ...]]:
    """One row for each edge, in the file's order."""
    graph, problem = done.graph, done.roles.problem
    trusted_residual = iter(np.sqrt(problem.trusted.chi2(done.outcome.poses)).tolist())
    residual = np.sqrt(problem.loops.chi2(done.outcome.poses)).tolist()
    truth = [None] * len(residual) if done.truth.loops is None else done.truth.loops.tolist()
    loops = iter(
        zip(
            done.outcome.kept.tolist(),
            done.outcome.weights.tolist(),
            residual,
            truth,
            done.outcome.reasons,
            strict=True,
        )
    )
    rows: list[tuple[object, ...]] = []
    for i, j, trusted in zip(graph.first.tolist(), graph.second.tolist(), done.roles.trusted.tolist(), strict=True):
        if trusted:
            rows.append((i, j, "odometry", True, 1.0, next(trusted_residual), None, "trusted"))
        else:
            rows.append((i, j, "loop", *next(loops)))
    return rows


def _section(done: Solved, options: OptimizeOptions) -> dict[str, object]:
    """The part of metrics.json that is about the graph."""
    problem, outcome = done.roles.problem, done.outcome
    ate = [absolute_error(poses, done.truth.positions) for poses in (problem.start, outcome.poses)]
    true = done.truth.loops
    return {
        "robust": options.robust,
        "poses": len(problem.start),
        "odometry_edges": len(problem.trusted),
        "loop_edges": len(problem.loops),
        "loops_kept": int(outcome.kept.sum()),
        "true": None if true is None else int(true.sum()),
        "true_kept": None if true is None else int(outcome.kept[true].sum()),
        "false_kept": None if true is None else int(outcome.kept[~true].sum()),
        "ate_initial_m": ate[0],
        "ate_m": ate[1],
        "error_initial": problem.error(outcome.kept, problem.start),
        "error_final": problem.error(outcome.kept, outcome.poses),
        "seconds": done.seconds,
    }


def _metrics(done: Solved, section: dict[str, object]) -> dict[str, object]:
    notes = {f"graph.{name}": done.truth.why(name) for name, value in section.items() if value is None}
    warnings = list(done.graph.warnings + done.roles.warnings)
    rest: dict[str, object] = {"peak_memory_mb": peak_memory_mb(), "warnings": warnings, "notes": notes}
    return provenance(done.path, done.path.stem) | {"graph": section} | rest


def _table() -> Table:
    table = Table()
    table.add_column("graph", no_wrap=True)
    for name in ("poses", "loops", "kept", "true", "false", "before [m]", "ATE [m]", "s"):
        table.add_column(name, justify="right")
    return table


def _add_row(table: Table, path: Path, graph: dict[str, object]) -> None:
    formats = {"ate_initial_m": ".2f", "ate_m": ".2f", "seconds": ".2f"}
    names = ("poses", "loop_edges", "loops_kept", "true_kept", "false_kept", *formats)
    cells = ["-" if graph[name] is None else format(graph[name], formats.get(name, "")) for name in names]
    table.add_row(path.stem, *cells)
