"""`revisit optimize`: optimise stored pose graphs and decide on every loop."""

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from slam.errors import ConfigError
from slam.evaluation.pose_graph_errors import GraphTruth, absolute_error, find_truth
from slam.io.frames_and_loops_csv import write_table
from slam.io.g2o import Graph, read_g2o, write_g2o
from slam.io.g2o_problem import ClassifiedEdges, classify_edges
from slam.io.metrics import write_metrics
from slam.io.run_folder import RunFolder
from slam.pipeline.provenance import peak_memory_mb, provenance
from slam.pose_graph.optimization.lie_groups import inverse
from slam.pose_graph.robust.backends import DEFAULT, BackEndResult, back_end, solve
from slam.report.pose_graph_figure import draw_pose_graph
from slam.report.style import save_png

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

EDGE_COLUMNS = ("first", "second", "role", "kept", "weight", "residual", "truth", "reason")


@dataclass(frozen=True)
class OptimizeOptions:
    """Options of `revisit optimize`.

    Attributes:
        graphs: g2o files to optimise.
        out: folder for the results; one folder each inside it where there are several graphs.
        robust: name of the back end.
        ground_truth: poses (KITTI, TUM), or a folder of them, each named as a word of the graph's name.
        overwrite: whether to replace earlier results.
    """

    graphs: tuple[Path, ...]
    out: Path
    robust: str = DEFAULT
    ground_truth: Path | None = None
    overwrite: bool = False


@dataclass(frozen=True)
class OptimizedGraph:
    """A stored graph, the result of its optimisation, and its ground truth.

    Attributes:
        path: file of the graph.
        graph: the graph as read.
        edges: its edges, classified as odometry and loops.
        result: optimised poses by id, and a weight and a reason for each loop.
        truth: ground truth of positions and loops, where there is any.
        seconds: wall-clock time of the optimisation.
    """

    path: Path
    graph: Graph
    edges: ClassifiedEdges
    result: BackEndResult
    truth: GraphTruth
    seconds: float


def optimize_graphs(options: OptimizeOptions, messages: Console, results: Console) -> None:
    """Optimise graphs and write `metrics.json`, `optimized.g2o`, `edges.csv`, `before_after.png` of each.

    Raises:
        RevisitError: a graph, its truth, the settings or the output folder cannot be used; what was there
            before stays untouched.
    """
    back_end(options.robust)  # an unknown name is an error before any graph is read
    if len({path.stem for path in options.graphs}) < len(options.graphs):
        raise ConfigError("expected graphs with different names, found two of one; optimise them one by one")
    table = _table()
    for path in options.graphs:
        out = options.out if len(options.graphs) == 1 else options.out / path.stem
        with RunFolder.create(out, options.overwrite) as folder:
            done = _optimize(path, options, messages)
            section = _section(done, options)
            _write(folder.path, done, _metrics(done, section))
            folder.commit()
        _add_row(table, path, section)
    results.print(table)


def _optimize(path: Path, options: OptimizeOptions, messages: Console) -> OptimizedGraph:
    graph = read_g2o(path)
    _warn(messages, graph.warnings)  # at once: what was passed over may be why the next step fails
    edges = classify_edges(graph, str(path))
    _warn(messages, edges.warnings)
    truth = find_truth(path, graph, edges.trusted, options.ground_truth)
    _warn(messages, truth.warnings)
    start = time.perf_counter()
    result = solve(edges.problem, options.robust)
    seconds = time.perf_counter() - start
    return OptimizedGraph(path, graph, edges, result, truth, seconds)


def _warn(messages: Console, warnings: tuple[str, ...]) -> None:
    for warning in warnings:
        messages.print(f"warning: {warning}", markup=False, highlight=False, soft_wrap=True)


def _in_place(done: OptimizedGraph) -> Array:
    """Return the optimised poses (N, n, n) in the file's order and frame."""
    # The back ends hold the first pose by id; a file may fix another one, whose place must stay.
    poses = np.empty_like(done.result.poses)
    poses[done.edges.order] = done.result.poses
    known = np.flatnonzero(done.graph.ids == done.graph.fixed)
    if known.size and done.graph.has_poses:
        T_file_ours = done.graph.poses[known[0]] @ inverse(poses[known[0]])
        poses = T_file_ours @ poses
    return poses


def _write(folder: Path, done: OptimizedGraph, metrics: dict[str, object]) -> None:
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
            declared_loops=np.zeros(0, np.int64),  # rows of the file, no longer those of the kept edges
        ),
    )
    write_table(folder / "edges.csv", EDGE_COLUMNS, _rows(done))
    save_png(
        draw_pose_graph(done.path.stem, done.edges.problem, done.result, done.truth.positions),
        folder / "before_after.png",
    )


def _kept_edges(done: OptimizedGraph) -> Mask:
    """Return which edges of the file the poses are fitted to, (M,) bool."""
    kept = done.edges.trusted.copy()
    kept[~done.edges.trusted] = done.result.kept
    return kept


def _rows(done: OptimizedGraph) -> list[tuple[object, ...]]:
    """Return one row for each edge, in the file's order; the columns are `EDGE_COLUMNS`."""
    graph, problem, result = done.graph, done.edges.problem, done.result
    trusted, count = done.edges.trusted, len(done.edges.trusted)
    weight, residual = np.ones(count), np.empty(count)
    # Objects, as an edge of odometry has no truth: None, an empty cell.
    truth, reason = np.full(count, None, dtype=object), np.full(count, "trusted", dtype=object)
    weight[~trusted] = result.weights
    residual[trusted] = np.sqrt(problem.trusted.chi2(result.poses))
    residual[~trusted] = np.sqrt(problem.loops.chi2(result.poses))
    reason[~trusted] = result.reasons
    reason[done.edges.connecting] = "trusted, as no odometry joins its poses"
    if done.truth.loops is not None:
        truth[~trusted] = done.truth.loops
    role = np.where(trusted, "odometry", "loop")
    columns = (graph.first, graph.second, role, _kept_edges(done), weight, residual, truth, reason)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def _section(done: OptimizedGraph, options: OptimizeOptions) -> dict[str, object]:
    """Return the section `graph` of metrics.json."""
    problem, result = done.edges.problem, done.result
    ate = [absolute_error(poses, done.truth.positions) for poses in (problem.start, result.poses)]
    true = done.truth.loops
    return {
        "robust": options.robust,
        "poses": len(problem.start),
        "odometry_edges": len(problem.trusted),
        "loop_edges": len(problem.loops),
        "loops_kept": int(result.kept.sum()),
        "true": None if true is None else int(true.sum()),
        "true_kept": None if true is None else int(result.kept[true].sum()),
        "false_kept": None if true is None else int(result.kept[~true].sum()),
        "ate_initial_m": ate[0],
        "ate_m": ate[1],
        "error_initial": problem.error(result.kept, problem.start),
        "error_final": problem.error(result.kept, result.poses),
        "seconds": done.seconds,
    }


def _metrics(done: OptimizedGraph, section: dict[str, object]) -> dict[str, object]:
    notes = {f"graph.{name}": done.truth.missing_reason(name) for name, value in section.items() if value is None}
    warnings = list(done.graph.warnings + done.edges.warnings + done.truth.warnings)
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
