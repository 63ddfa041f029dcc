"""Commands that evaluate: pose graphs, results against ground truth, many runs side by side, single loops."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from slam.cli import options as option
from slam.cli.options import BACK_END_NAMES, DEFAULT_BACK_END, EXIT_FAILED, Json, Out, Overwrite


def optimize(
    graphs: Annotated[
        list[Path], typer.Argument(metavar="GRAPH.g2o...", help="Pose graphs in the plane (SE2) or in space (SE3).")
    ],
    out: Out,
    robust: Annotated[str, typer.Option(help=f"Robust back end: {BACK_END_NAMES}.")] = DEFAULT_BACK_END,
    ground_truth: Annotated[
        Path | None,
        typer.Option(help="True poses (KITTI, TUM), or a folder of files named after the graphs.", show_default="none"),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Optimise pose graphs that may hold false loops, and list which loops were kept and why.

    Edges between poses of one robot whose ids follow each other are odometry, which is trusted. All others are loops.

    Example: revisit optimize kitti_05.g2o --ground-truth poses/05.txt --out runs/graph05
    """
    from slam.apps.optimize import OptimizeOptions, optimize_graphs

    options = OptimizeOptions(tuple(graphs), out, robust, ground_truth, overwrite)
    optimize_graphs(options, Console(stderr=True), Console())


def benchmark(
    config: Annotated[
        Path, typer.Argument(help="TOML file that lists sources, paradigms, presets, robust back ends and seeds.")
    ],
    out: Out,
    workers: Annotated[
        int | None,
        typer.Option(
            help="Number of worker processes on this machine; 0 works in this process alone.",
            show_default="one per core",
        ),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            help="Address of a running dask scheduler, tcp://HOST:PORT, whose workers see the same files.",
            show_default="none: workers on this machine",
        ),
    ] = None,
) -> None:
    r"""Run every source with every paradigm, preset, back end and seed, and compare the results side by side.

    Finished runs in the output folder are kept, so the same command continues where it stopped.
    Several processes need: pip install 'revisit-slam\[cluster]'

    Example: revisit benchmark town.toml --out runs/town
    """
    from slam.benchmark.sweep import BenchmarkOptions, run_benchmark

    options = BenchmarkOptions(config=config, out=out, workers=workers, scheduler=scheduler)
    succeeded = run_benchmark(options, Console(stderr=True), Console())
    raise typer.Exit(0 if succeeded else EXIT_FAILED)


def evaluate_trajectory(
    estimate: Annotated[Path, typer.Argument(help="Estimated poses: KITTI (12 numbers per line), TUM or EuRoC's csv.")],
    truth: Annotated[Path, typer.Argument(help="True poses: KITTI, TUM or EuRoC's csv.")],
    mono: Annotated[bool, typer.Option("--mono", help="Align with Sim(3) instead of SE(3).")] = False,
    json: Json = False,
) -> None:
    """Print the errors of a trajectory: ATE after alignment, t_rel and r_rel by the KITTI rule, and the end error.

    Example: revisit evaluate trajectory runs/kitti05/trajectory_corrected.txt data/kitti/poses/05.txt
    """
    from slam.apps.evaluate import evaluate_trajectory_files

    text = evaluate_trajectory_files(estimate, truth, mono, json)
    Console().print(text, markup=False, highlight=False, soft_wrap=True)


def evaluate_loops(
    matches: option.Matches,
    truth: option.LoopTruth,
    frame_tolerance: option.FrameTolerance = None,
    max_distance: option.MaxDistance = 10.0,
    max_angle: option.MaxAngle = 45.0,
    min_time_gap: option.MinTimeGap = 0.0,
    min_distance: option.MinDistance = 20.0,
    one_to_one: option.OneToOne = False,
    fps: option.PoseRate = None,
    json: option.Json = False,
    out: option.MetricsFolder = None,
    overwrite: option.Overwrite = False,
) -> None:
    """Print precision, recall and R@P100 of matches by two rules in use: exact truth, and a tolerance of 10 images.

    Example: revisit evaluate loops runs/places05/matches.csv groundTruthKITTI05.mat
    """
    from place_recognition.evaluation.revisit_ground_truth import RevisitRule
    from slam.apps.evaluate import LoopsOptions
    from slam.apps.evaluate import evaluate_loops as evaluate

    rule = RevisitRule(max_distance, max_angle, min_time_gap, min_distance, one_to_one)
    options = LoopsOptions(matches, truth, frame_tolerance, rule, fps, out, overwrite)
    Console().print(evaluate(options, json), markup=False, highlight=False, soft_wrap=True)


def explain(
    run: Annotated[Path, typer.Argument(help="Folder of a run.")],
    query: Annotated[int, typer.Argument(help="Index of the query frame, counted from 0.")],
    match: Annotated[
        int | None,
        typer.Argument(help="Index of the earlier frame.", show_default="the recogniser's best match"),
    ] = None,
) -> None:
    """Explain why a loop was or was not closed: the result of each stage, with its numbers.

    Example: revisit explain runs/demo 310
    """
    from slam.apps.explain import explain_loop

    Console().print(explain_loop(run, query, match), markup=False, highlight=False, soft_wrap=True)
