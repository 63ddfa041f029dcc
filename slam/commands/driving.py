"""Commands that drive: a recorded drive, or a simulated one, to a trajectory and a map."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from slam.commands.options import (
    BACK_END_NAMES,
    EXIT_INTERRUPTED,
    FEATURE_NAMES,
    PARADIGM_NAMES,
    Kind,
    Out,
    Overwrite,
    Topic,
)
from slam.simulation.spec import SimulationConfig


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


def simulate(
    shape: Annotated[str, typer.Argument(help="circle, figure-eight, blocks, or the path of a KITTI pose file.")],
    out: Out,
    laps: Annotated[int, typer.Option(help="Laps to drive.")] = SimulationConfig.laps,
    length: Annotated[float, typer.Option(help="Length of one lap, metres.")] = SimulationConfig.length,
    seed: Annotated[int, typer.Option(help="Seed of the town and of its camera.")] = SimulationConfig.seed,
    speed: Annotated[float, typer.Option(help="Of the car, metres a second.")] = SimulationConfig.speed,
    frame_rate: Annotated[float, typer.Option(help="Stereo pairs a second.")] = SimulationConfig.frame_rate,
    width: Annotated[int, typer.Option(help="Of the images, pixels.")] = SimulationConfig.width,
    height: Annotated[int, typer.Option(help="Of the images, pixels.")] = SimulationConfig.height,
    lateral_offset: Annotated[float, typer.Option(help="Sideways shift of later laps, metres.")] = 0.0,
    reverse: Annotated[bool, typer.Option("--reverse", help="Drive every second lap the opposite way.")] = False,
    change_illumination: Annotated[
        bool, typer.Option("--relight", help="Drive later laps in other light.")
    ] = False,
    perceptual_aliasing: Annotated[
        bool, typer.Option("--alike", help="Make two streets alike (perceptual aliasing).")
    ] = False,
    cars_per_360m: Annotated[int, typer.Option("--moving-cars", help="Cars met on 360 m.")] = 6,
    rectification_error: Annotated[
        float, typer.Option(help="Peak error of the calibration, pixels at KITTI's size.")
    ] = SimulationConfig.rectification_error,
    lens_error: Annotated[
        float, typer.Option(help="Distortion that calibration has left, pixels at 45 degrees, at KITTI's size.")
    ] = SimulationConfig.lens_error,
    max_frames: Annotated[int, typer.Option(help="Stop after so many frames; 0 drives all the way.")] = 0,
    ideal_sensor: Annotated[
        bool, typer.Option("--clean", help="Leave out noise, blur, wind and camera faults.")
    ] = False,
    depth: Annotated[bool, typer.Option("--depth", help="Write the true depth of each image too.")] = False,
) -> None:
    """Render a drive through a procedural town: KITTI layout, stereo, exact ground truth.

    Example: revisit simulate circle --laps 2 --length 360 --out data/circle
    """
    settings = {name: value for name, value in locals().items() if name != "out"}
    from slam.progress import progress_bar
    from slam.simulation import simulate as render

    with progress_bar(Console(stderr=True), "Rendering") as progress:
        folder = render(SimulationConfig(**settings), out, progress)
    message = f"{folder}: a drive in KITTI layout, sequence 00; run it with: revisit run {folder} --out DIR"
    Console().print(message, markup=False, highlight=False, soft_wrap=True)


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
        found.path, found.sequence, out, "none", overwrite, again=map_, config=config, kind=found.format, fps=found.fps,
        topics=found.topics,
    )  # fmt: skip
    chosen = {"paradigm": paradigm, "robust": robust, "record": not no_record}
    settings = {name: value for name, value in chosen.items() if value is not None}
    interrupted = run_recorded(options, settings, Console(stderr=True), Console())
    raise typer.Exit(EXIT_INTERRUPTED if interrupted else 0)


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
