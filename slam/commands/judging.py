"""Commands that judge: graphs, results against ground truth, many runs side by side."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from slam.commands.options import BACK_END_NAMES, EXIT_FAILED, Out, Overwrite


def optimize(
    graphs: Annotated[
        list[Path], typer.Argument(metavar="GRAPH.g2o...", help="Pose graphs, in the plane or in space.")
    ],
    out: Out,
    robust: Annotated[str, typer.Option(help=f"Back end: {BACK_END_NAMES}.")] = "pcm+gnc",
    ground_truth: Annotated[
        Path | None, typer.Option(help="True poses (KITTI, TUM), or a folder of them named as in the graphs' names.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Optimise pose graphs that may hold false loops; say which loops were kept, and why.

    Edges between successive poses are odometry and trusted, all others are loops.

    Example: revisit optimize kitti_05.g2o --ground-truth poses/05.txt --out runs/graph05
    """
    from slam.graph_command import OptimizeOptions, optimize_graphs

    options = OptimizeOptions(tuple(graphs), out, robust, ground_truth, overwrite)
    optimize_graphs(options, Console(stderr=True), Console())


def benchmark(
    config: Annotated[Path, typer.Argument(help="TOML file: sources, paradigms, robust, seeds.")],
    out: Out,
    workers: Annotated[
        int | None, typer.Option(help="Processes on this machine, 0 for this one alone; else one for each core.")
    ] = None,
    scheduler: Annotated[str | None, typer.Option(help="Of dask, instead: tcp://HOST:PORT; same files there.")] = None,
) -> None:
    """Run every source with every paradigm, back end and seed; figures of all runs side by side.

    What an earlier command has finished in the output folder is kept, so the same command goes on where it stopped.
    Several processes need: pip install 'revisit-slam[cluster]'

    Example: revisit benchmark town.toml --out runs/town
    """
    from slam.benchmark.command import BenchmarkOptions, run_benchmark

    succeeded = run_benchmark(BenchmarkOptions(config, out, workers, scheduler), Console(stderr=True), Console())
    raise typer.Exit(0 if succeeded else EXIT_FAILED)


def evaluate_trajectory(
    estimate: Annotated[Path, typer.Argument(help="Estimated poses, KITTI (12 numbers a line) or TUM.")],
    truth: Annotated[Path, typer.Argument(help="True poses, likewise.")],
    mono: Annotated[bool, typer.Option("--mono", help="Align with Sim(3) instead of SE(3).")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """ATE after alignment, and t_rel, r_rel by the KITTI rule.

    Example: revisit evaluate trajectory runs/kitti05/trajectory_corrected.txt data/kitti/poses/05.txt
    """
    from slam.evaluation.command import compare_files

    Console().print(compare_files(estimate, truth, mono, json))


def evaluate_loops(
    matches: Annotated[Path, typer.Argument(help="matches.csv, or any table with query, match and score.")],
    truth: Annotated[
        Path, typer.Argument(help="Matrix of revisits (.mat, or .npz with truth), or poses (KITTI, TUM).")
    ],
    tolerance: Annotated[int | None, typer.Option(help="Columns that a match may be off, besides 0 and 10.")] = None,
    radius: Annotated[float, typer.Option(help="Of one place, metres; for poses.")] = 10.0,
    heading: Annotated[float, typer.Option(help="Within which one looks the same way, degrees; for poses.")] = 45.0,
    gap: Annotated[float, typer.Option(help="Least time between the images of a revisit, seconds; for poses.")] = 0.0,
    way: Annotated[float, typer.Option(help="Least way between the images of a revisit, metres; for poses.")] = 20.0,
    one_to_one: Annotated[
        bool, typer.Option("--one-to-one", help="Only the nearest image is right; for poses.")
    ] = False,
    fps: Annotated[float | None, typer.Option(help="Poses a second, for a gap where poses have no times.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for metrics.json and the curve.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Precision, recall and R@P100 of matches, by the rule of the chapter's authors and by that of others.

    Example: revisit evaluate loops runs/places05/matches.csv groundTruthKITTI05.mat
    """
    from place_recognition.evaluation.ground_truth import SamePlace
    from slam.evaluation.loops_command import LoopsOptions
    from slam.evaluation.loops_command import evaluate_loops as judge

    rule = SamePlace(radius, heading, gap, way, one_to_one)
    text = judge(LoopsOptions(matches, truth, tolerance, rule, fps, out, overwrite), json)
    Console().print(text, markup=False, highlight=False, soft_wrap=True)


def explain(
    run: Annotated[Path, typer.Argument(help="Folder of a run.")],
    query: Annotated[int, typer.Argument(help="Frame that was asked about, counted from 0.")],
    match: Annotated[int | None, typer.Argument(help="Earlier frame; without it the recogniser's best.")] = None,
) -> None:
    """Tell why a loop was or was not closed, stage by stage, with the numbers.

    Example: revisit explain runs/demo 310
    """
    from slam.explain import explain_loop

    Console().print(explain_loop(run, query, match), markup=False, highlight=False, soft_wrap=True)
