"""The command line: `revisit --help` tells what there is. Only this file prints.

Everything heavy is imported inside the commands, so that help answers at once.
"""

import errno
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from slam.errors import ConfigError, RevisitError
from slam.simulation.spec import DriveSpec

if TYPE_CHECKING:
    from slam.doctor import Check

app = typer.Typer(
    name="revisit",
    help="Visual SLAM that closes loops: from the images of a recorded drive to a corrected trajectory and map.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)
evaluate_app = typer.Typer(no_args_is_help=True)
app.add_typer(evaluate_app, name="evaluate", help="Measure results against ground truth.")
filter_app = typer.Typer(no_args_is_help=True)
app.add_typer(filter_app, name="filter", help="The filter by which sequences are recognised.")
vocabulary_app = typer.Typer(no_args_is_help=True)
app.add_typer(vocabulary_app, name="vocabulary", help="Visual words for the paradigms that need them in advance.")

EXIT_FAILED, EXIT_USAGE, EXIT_INTERRUPTED = 1, 2, 130

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # wherever a disk is full, that is no bug

Out = Annotated[Path, typer.Option("--out", help="Folder for the results.", show_default=True)]
# Named here and not taken from the catalogue, which is slow to import.
PARADIGM_NAMES = (
    "sequence-histograms, dynamic-sequences, hierarchical-places, tracked-words, pixel-sequences, global-descriptor"
)
FEATURE_NAMES = "surf, surf-oriented, sift, orb"
BACK_END_NAMES = "none, huber, dcs, switchable, gnc, pcm, pcm+gnc"
KIND_NAMES = "kitti, euroc, tum-rgbd, own-camera, bag, malaga, new-college, city-centre, images"
Kind = Annotated[str | None, typer.Option(help=f"Of the source, if it is not recognised: {KIND_NAMES}.")]
Topic = Annotated[list[str] | None, typer.Option(help="Of a bag: the left camera's, then the right one's.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an earlier run in the output folder.")]


@app.command()
def demo(
    out: Out = Path("runs/demo"),
    seed: Annotated[int, typer.Option(help="Seed of the town and of its camera.")] = 0,
) -> None:
    """Simulate a drive of three laps, run the whole chain on it, and write a report. Needs no download.

    The drive is rendered once and kept in the cache; the run in the output folder is made anew each time.

    Example: revisit demo --out runs/demo
    """
    from slam.demo import run_demo

    interrupted = run_demo(out, seed, Console(stderr=True), Console())
    raise typer.Exit(EXIT_INTERRUPTED if interrupted else 0)


@app.command()
def simulate(
    shape: Annotated[str, typer.Argument(help="circle, figure-eight, blocks, or the path of a KITTI pose file.")],
    out: Out,
    laps: Annotated[int, typer.Option(help="Laps to drive.")] = DriveSpec.laps,
    length: Annotated[float, typer.Option(help="Length of one lap, metres.")] = DriveSpec.length,
    seed: Annotated[int, typer.Option(help="Seed of the town and of its camera.")] = DriveSpec.seed,
    speed: Annotated[float, typer.Option(help="Of the car, metres a second.")] = DriveSpec.speed,
    frame_rate: Annotated[float, typer.Option(help="Stereo pairs a second.")] = DriveSpec.frame_rate,
    width: Annotated[int, typer.Option(help="Of the images, pixels.")] = DriveSpec.width,
    height: Annotated[int, typer.Option(help="Of the images, pixels.")] = DriveSpec.height,
    lateral_offset: Annotated[float, typer.Option(help="Sideways shift of later laps, metres.")] = 0.0,
    reverse: Annotated[bool, typer.Option("--reverse", help="Drive every second lap the opposite way.")] = False,
    relight: Annotated[bool, typer.Option("--relight", help="Drive later laps in other light.")] = False,
    alike: Annotated[bool, typer.Option("--alike", help="Make two streets alike (perceptual aliasing).")] = False,
    moving_cars: Annotated[int, typer.Option(help="Cars met on 360 m.")] = DriveSpec.moving_cars,
    rectification_error: Annotated[
        float, typer.Option(help="Peak error of the calibration, pixels at KITTI's size.")
    ] = DriveSpec.rectification_error,
    lens_error: Annotated[
        float, typer.Option(help="Distortion that calibration has left, pixels at 45 degrees, at KITTI's size.")
    ] = DriveSpec.lens_error,
    max_frames: Annotated[int, typer.Option(help="Stop after so many frames; 0 drives all the way.")] = 0,
    clean: Annotated[bool, typer.Option("--clean", help="Leave out noise, blur, wind and camera faults.")] = False,
    depth: Annotated[bool, typer.Option("--depth", help="Write the true depth of each image too.")] = False,
) -> None:
    """Render a drive through a procedural town: KITTI layout, stereo, exact ground truth.

    Example: revisit simulate circle --laps 2 --length 360 --out data/circle
    """
    settings = {name: value for name, value in locals().items() if name != "out"}
    from slam.progress import progress_bar
    from slam.simulation import simulate as render

    with progress_bar(Console(stderr=True), "Rendering") as progress:
        folder = render(DriveSpec(**settings), out, progress)
    message = f"{folder}: a drive in KITTI layout, sequence 00; run it with: revisit run {folder} --out DIR"
    Console().print(message, markup=False, highlight=False, soft_wrap=True)


@app.command()
def run(
    source: Annotated[Path, typer.Argument(help="A recorded drive: folder, video or bag.")],
    out: Out,
    sequence: Annotated[
        str | None, typer.Option(help="Sequence, for example 00; needed where there are several.")
    ] = None,
    paradigm: Annotated[str | None, typer.Option(help=f"Place recogniser: {PARADIGM_NAMES}.")] = None,
    features: Annotated[str | None, typer.Option(help=f"Local features: {FEATURE_NAMES}.")] = None,
    vocabulary: Annotated[Path | None, typer.Option(help="Vocabulary file; without it a general one.")] = None,
    descriptor: Annotated[str | None, typer.Option(help="Of global-descriptor: hog, or onnx:FILE.")] = None,
    robust: Annotated[str | None, typer.Option(help=f"Back end: {BACK_END_NAMES}.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of every random generator.")] = None,
    config: Annotated[Path | None, typer.Option(help="Settings, a TOML file such as a run's config.toml.")] = None,
    view: Annotated[str, typer.Option(help="Watch while it runs: none, native or web.")] = "none",
    mono: Annotated[bool, typer.Option("--mono", help="Use the left camera alone.")] = False,
    camera_height: Annotated[
        float | None, typer.Option(help="With --mono: metres above the road; gives the scale. KITTI: 1.65.")
    ] = None,
    no_record: Annotated[bool, typer.Option("--no-record", help="Write no recording.rrd.")] = False,
    no_map: Annotated[bool, typer.Option("--no-map", help="Write no map.db: no --resume, no locate.")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where a run into the folder stopped.")] = False,
    map_file: Annotated[
        Path | None, typer.Option("--map", help="Map of other drives, a map.db or a run: recognise their places.")
    ] = None,
    kind: Kind = None,
    fps: Annotated[float | None, typer.Option(help="Images a second, where nothing else says.")] = None,
    topic: Topic = None,
    overwrite: Overwrite = False,
) -> None:
    """Run the whole chain on a recorded drive: odometry, places, loops, pose graph, map, report.

    Killed or stopped, it goes on with --resume and ends with the same results. With --map it begins with the map of an
    earlier run, recognises its places, and ends with both drives in one map.

    Example: revisit run ~/kitti/dataset --sequence 05 --out runs/kitti05
    """
    from slam.run import RunOptions, run_recorded

    options = RunOptions(
        source, sequence, out, view, overwrite, resume, map_file, config, kind, fps, tuple(topic or ())
    )
    chosen = {
        "paradigm": paradigm,
        "features": features,
        "vocabulary": None if vocabulary is None else str(vocabulary),
        "descriptor": descriptor,
        "robust": robust,
        "seed": seed,
        "record": False if no_record else None,
        "keep_map": False if no_map else None,
        "mono": mono or None,
        "camera_height": camera_height,
    }
    settings = {name: value for name, value in chosen.items() if value is not None}
    interrupted = run_recorded(options, settings, Console(stderr=True), Console())
    raise typer.Exit(EXIT_INTERRUPTED if interrupted else 0)


@app.command()
def reprocess(
    map_: Annotated[Path, typer.Argument(metavar="MAP", help="Map of one drive: a map.db, or a run with one.")],
    out: Out,
    paradigm: Annotated[str | None, typer.Option(help=f"Place recogniser: {PARADIGM_NAMES}.")] = None,
    robust: Annotated[str | None, typer.Option(help=f"Back end: {BACK_END_NAMES}.")] = None,
    config: Annotated[Path | None, typer.Option(help="Settings, a TOML file such as a run's config.toml.")] = None,
    source: Annotated[Path | None, typer.Option(help="The recording, if it is no longer where it was.")] = None,
    no_record: Annotated[bool, typer.Option("--no-record", help="Write no recording.rrd.")] = False,
    overwrite: Overwrite = False,
) -> None:
    """Find the loops of a drive again, with other settings: motions and landmarks are taken from its map.

    What is not given stays as it was. The images are read again, for the recogniser.

    Example: revisit reprocess runs/kitti05 --paradigm hierarchical-places --out runs/kitti05-hp
    """
    from dataclasses import replace

    from slam.map_store.remembered import source_of
    from slam.run import RunOptions, run_recorded

    found = source_of(map_)
    found = found if source is None else replace(found, path=source)
    options = RunOptions(
        found.path, found.sequence, out, "none", overwrite, again=map_, config=config, kind=found.kind, fps=found.fps,
        topics=found.topics,
    )  # fmt: skip
    chosen = {"paradigm": paradigm, "robust": robust, "record": not no_record}
    settings = {name: value for name, value in chosen.items() if value is not None}
    interrupted = run_recorded(options, settings, Console(stderr=True), Console())
    raise typer.Exit(EXIT_INTERRUPTED if interrupted else 0)


@app.command()
def places(
    source: Annotated[Path, typer.Argument(help="A recorded drive, a folder of images, a video or a bag.")],
    paradigm: Annotated[str, typer.Option(help=f"One of: {PARADIGM_NAMES}.")],
    out: Out,
    sequence: Annotated[
        str | None, typer.Option(help="Sequence, for example 00; needed where there are several.")
    ] = None,
    ground_truth: Annotated[
        Path | None, typer.Option(help="Matrix of revisits (.mat, or .npz with truth), or poses (KITTI, TUM).")
    ] = None,
    features: Annotated[str, typer.Option(help=f"Local features: {FEATURE_NAMES}.")] = "surf",
    vocabulary: Annotated[Path | None, typer.Option(help="Vocabulary file; without it one for surf.")] = None,
    descriptor: Annotated[str, typer.Option(help="Of global-descriptor: hog, or onnx:FILE.")] = "hog",
    exclude: Annotated[float | None, typer.Option(help="Match no image less than so many seconds old.")] = None,
    fps: Annotated[float | None, typer.Option(help="Images a second, where there is no times.txt.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of every random generator.")] = 0,
    json: Annotated[bool, typer.Option("--json", help="Print the metrics as JSON.")] = False,
    kind: Kind = None,
    topic: Topic = None,
    overwrite: Overwrite = False,
) -> None:
    """Place recognition alone, with one camera: which images show a place that was seen before?

    Example: revisit places ~/kitti/dataset --sequence 05 --paradigm tracked-words --out runs/places05
    """
    settings = {name: value for name, value in locals().items() if name not in ("json", "topic")}
    from slam.places.command import recognise_places
    from slam.places.options import PlacesOptions

    options = PlacesOptions(**settings, topics=tuple(topic or ()))
    interrupted = recognise_places(options, Console(stderr=True), Console(), json)
    raise typer.Exit(EXIT_INTERRUPTED if interrupted else 0)


@app.command()
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


@app.command()
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


@evaluate_app.command("trajectory")
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


@evaluate_app.command("loops")
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


@vocabulary_app.command("train")
def train_vocabulary(
    sources: Annotated[list[Path], typer.Argument(metavar="SOURCE...", help="Folders of images, or KITTI roots.")],
    out: Annotated[Path, typer.Option("--out", help="File for the words.")],
    features: Annotated[str, typer.Option(help=f"What the words are made of: {FEATURE_NAMES}.")] = "surf",
    words: Annotated[int, typer.Option(help="How many.")] = 10000,
    sample: Annotated[int, typer.Option(help="Descriptors to train on, at most.")] = 1000000,
    seed: Annotated[int, typer.Option(help="Of every random choice.")] = 0,
) -> None:
    """Train visual words on images of your own. Never on those that will be recognised.

    Example: revisit vocabulary train ~/photos ~/drive --out town.vocabulary
    """
    from slam.progress import progress_bar
    from slam.vocabulary import TrainingOptions, train_from_images

    options = TrainingOptions(tuple(sources), out, features)
    with progress_bar(Console(stderr=True), "Describing images") as progress:
        message = train_from_images(options, {"words": words, "sample": sample, "seed": seed}, progress)
    Console().print(message, markup=False, highlight=False, soft_wrap=True)


@filter_app.command("train")
def filter_train(
    matrix: Annotated[Path, typer.Argument(help="matrix.npz of revisit places with a paradigm of sequences.")],
    truth: Annotated[Path, typer.Argument(help="Matrix of its revisits: .mat, or .npz with truth.")],
    out: Annotated[Path, typer.Option("--out", help="Settings to write, a TOML file.")],
    paradigm: Annotated[
        str, typer.Option(help="Whose filter: sequence-histograms or dynamic-sequences.")
    ] = "dynamic-sequences",
) -> None:
    """Learn the 3x3 filter of the similarity matrix by logistic regression.

    Example: revisit filter train runs/places05/matrix.npz loops_05.npz --out filter.toml
    """
    from slam.filter_training import train_filter_file

    Console().print(train_filter_file(matrix, truth, out, paradigm), markup=False, highlight=False, soft_wrap=True)


@app.command()
def explain(
    run: Annotated[Path, typer.Argument(help="Folder of a run.")],
    query: Annotated[int, typer.Argument(help="Frame that was asked about, counted from 0.")],
    match: Annotated[int | None, typer.Argument(help="Earlier frame; without it the recogniser's best.")] = None,
) -> None:
    """Tell why a loop was or was not closed, stage by stage, with the numbers.

    Example: revisit explain runs/demo 310
    """
    from slam.explain import explain as told

    Console().print(told(run, query, match), markup=False, highlight=False, soft_wrap=True)


@app.command()
def locate(
    map: Annotated[Path, typer.Argument(help="Folder of a run, or its map.db.")],
    images: Annotated[Path, typer.Argument(help="An image, a folder of images, a video, or a recorded drive.")],
    sequence: Annotated[
        str | None, typer.Option(help="Sequence, for example 00; needed where there are several.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", help="CSV file for the poses.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Tell where single images of the map's camera were taken, or that the map does not show it.

    Example: revisit locate runs/kitti05 photo.png
    """
    from slam.datasets.source import Source
    from slam.localisation.command import LocateOptions, as_json, as_table
    from slam.localisation.command import locate as place

    answers = place(LocateOptions(map, Source(images, sequence), out), Console(stderr=True))
    shown = as_json(answers) if json else as_table(answers)
    Console().print(shown, markup=not json, highlight=False, soft_wrap=json)


@app.command()
def info(
    map: Annotated[Path, typer.Argument(help="Folder of a run, or its map.db.")],
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Tell what a saved map holds: its drives, loops and landmarks, and where its bytes are.

    Example: revisit info runs/kitti05
    """
    from slam.map_store.summary import as_json, as_table, summarise

    summary = summarise(map)
    shown = as_json(summary) if json else as_table(summary)
    Console().print(shown, markup=not json, highlight=False, soft_wrap=json)


@app.command()
def check(
    source: Annotated[
        Path,
        typer.Argument(help="A recorded drive, a folder of images, a video, a bag, or a map that a run has saved."),
    ],
    sequence: Annotated[
        str | None, typer.Option(help="Sequence, for example 00; needed where there are several.")
    ] = None,
    kind: Kind = None,
    fps: Annotated[float | None, typer.Option(help="Images a second, where nothing else says.")] = None,
    topic: Topic = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Look at a recording before a run, or at a saved map: what will and what will not work with it, and why.

    Example: revisit check data/kitti --sequence 05
    """
    from slam.datasets.source import Source
    from slam.inspection.command import as_json, as_table, check_recording
    from slam.inspection.map import inspect_map, is_map

    if is_map(source):
        inspection = inspect_map(source)
    else:
        inspection = check_recording(Source(source, sequence, kind, fps, tuple(topic or ())), Console(stderr=True))
    shown = as_json(inspection) if json else as_table(inspection)
    Console().print(shown, markup=not json, highlight=False, soft_wrap=json)
    raise typer.Exit(0 if inspection.serves else EXIT_FAILED)


@app.command()
def export(
    run: Annotated[Path, typer.Argument(help="Folder of a run.")],
    format: Annotated[
        str, typer.Option(help="tum or kitti (trajectories), g2o (graph), ply (landmarks), colmap (its text model).")
    ],
    state: Annotated[
        str, typer.Option(help="odometry, online (trajectories only: as known at each moment) or corrected.")
    ] = "corrected",
    out: Annotated[Path | None, typer.Option(help="File, or colmap's folder; without it beside the run.")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")] = False,
) -> None:
    """Write one result of a run in the format that another program reads.

    Example: revisit export runs/kitti05 --format tum --out kitti05.tum
    """
    from slam.export import ExportOptions
    from slam.export import export as write

    written = write(ExportOptions(run, format, state, out, overwrite))
    Console().print(str(written), markup=False, highlight=False, soft_wrap=True)


@app.command()
def view(
    run: Annotated[Path, typer.Argument(help="Folder of a run with a recording.")],
    web: Annotated[bool, typer.Option("--web", help="Name a page for a browser of this machine instead.")] = False,
) -> None:
    """Open the recording of a run, and its dense map where it has one, in the rerun viewer.

    The viewer listens on 127.0.0.1 alone and reports to nobody.

    Example: revisit view runs/demo
    """
    from slam.viewer.listener import open_recording

    open_recording(run, web).wait()


@app.command()
def dense(
    run: Annotated[Path, typer.Argument(help="Folder of a run with two cameras.")],
    source: Annotated[
        Path | None, typer.Argument(help="Its recording, where that has moved since.", show_default=False)
    ] = None,
    voxel: Annotated[float, typer.Option(help="Distance between points of the map, metres.")] = 0.15,
    depth: Annotated[float, typer.Option(help="Leave out what is farther from the camera, metres.")] = 25.0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace a dense map that is there.")] = False,
) -> None:
    """Make the dense map of a run: cloud and mesh before and after correction, and the grid of what is free.

    Writes into the folder of the run, and shows the maps in its report too. Images
    are read once; the corrected graph moves finished submaps.

    Example: revisit dense runs/kitti05
    """
    from slam.dense_command import DenseOptions, map_densely

    message = map_densely(DenseOptions(run, source, voxel, depth, overwrite), Console(stderr=True))
    Console().print(message, markup=False, highlight=False, soft_wrap=True)


@app.command()
def doctor(
    licences: Annotated[bool, typer.Option("--licences", help="List the installed dependencies instead.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Check Python, the wheels and the system libraries; say what is missing and what to type.

    Example: revisit doctor
    """
    if licences:
        _print_licences(json)
        return
    from slam.doctor import check_machine

    checks = check_machine()
    (_print_json if json else _print_checks)(checks)
    raise typer.Exit(EXIT_FAILED if any(check.problem for check in checks) else 0)


def _print_checks(checks: Sequence["Check"]) -> None:
    from rich.markup import escape

    for check in checks:
        mark = "[red]missing[/red]" if check.problem else "[green]ok[/green]"
        words = escape(f"{check.name} {check.found}{check.problem}")
        Console().print(f"{mark:>8}  {words}", highlight=False, soft_wrap=True)
        if check.remedy:
            Console().print(f"          type: {check.remedy}", markup=False, highlight=False, soft_wrap=True)


def _print_json(rows: Sequence[Any]) -> None:
    """Print dataclasses as a list of objects."""
    Console().print(dumps([asdict(row) for row in rows], indent=2), markup=False, highlight=False, soft_wrap=True)


def _print_licences(as_json: bool) -> None:
    from rich.table import Table

    from slam.licences import licences

    if as_json:
        _print_json(licences())
        return
    table = Table("package", "version", "licence", "needed by", title="What Revisit is installed with", box=None)
    for one in licences():
        table.add_row(one.package, one.version, one.licence, "Revisit" if one.direct else "another package")
    Console().print(table)


def main() -> None:
    """Run the command line; known errors become one line on standard error and an exit code."""
    sys.exit(_exit_code(app))


def _exit_code(command: Callable[[], None]) -> int:
    try:
        command()
    except RevisitError as error:
        print(f"revisit: {error}", file=sys.stderr)
        return EXIT_USAGE if isinstance(error, ConfigError) else EXIT_FAILED
    except OSError as error:
        if error.errno not in _NO_ROOM:
            raise
        where = f"{error.filename}: " if error.filename else ""
        print(f"revisit: {RevisitError(f'{where}{error.strerror}; make room')}", file=sys.stderr)
        return EXIT_FAILED
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except SystemExit as exit_:
        return exit_.code if isinstance(exit_.code, int) else EXIT_FAILED
    return 0
