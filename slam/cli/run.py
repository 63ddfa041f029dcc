"""Commands that run the pipeline: on a simulated drive, a recorded one, a saved map, or densely on a finished run."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from slam.cli.options import (
    BACK_END,
    BACK_END_NAMES,
    DEFAULT_BACK_END,
    DEFAULT_FEATURES,
    DEFAULT_PARADIGM,
    EXIT_INTERRUPTED,
    FEATURE_NAMES,
    INPUT,
    OUTPUT,
    PARADIGM_NAMES,
    RECOGNITION,
    Format,
    FrameRate,
    ImageTopic,
    Out,
    Overwrite,
    Sequence,
    Settings,
)
from slam.simulation.scenario.config import SimulationConfig

_ROUTE, _SCENE, _CAMERA = "Route", "Scene", "Camera"
_FROM_MAP = "as in the map"


def demo(
    out: Out = Path("runs/demo"),
    seed: Annotated[int, typer.Option(help="Random seed of the town and of the camera noise.")] = 0,
) -> None:
    """Simulate a drive of three laps, run the whole pipeline on it and write a report. Needs no download.

    The drive is rendered once and kept in a cache. The results in the output folder are replaced each time.

    Example: revisit demo --out runs/demo
    """
    from slam.apps.demo import run_demo

    interrupted = run_demo(out, seed, Console(stderr=True), Console())
    raise typer.Exit(EXIT_INTERRUPTED if interrupted else 0)


def simulate(
    shape: Annotated[
        str, typer.Argument(help="Shape of the route: circle, figure-eight, blocks, or the path of a KITTI pose file.")
    ],
    out: Out,
    laps: Annotated[int, typer.Option(help="Number of laps.", rich_help_panel=_ROUTE)] = SimulationConfig.laps,
    length: Annotated[
        float, typer.Option(help="Length of one lap, metres.", rich_help_panel=_ROUTE)
    ] = SimulationConfig.length_m,
    speed: Annotated[
        float, typer.Option(help="Speed of the car, metres per second.", rich_help_panel=_ROUTE)
    ] = SimulationConfig.speed_m_per_s,
    lateral_offset: Annotated[
        float, typer.Option(help="Sideways shift of the laps after the first, metres.", rich_help_panel=_ROUTE)
    ] = 0.0,
    reverse: Annotated[
        bool,
        typer.Option("--reverse", help="Drive every second lap in the opposite direction.", rich_help_panel=_ROUTE),
    ] = False,
    max_frames: Annotated[
        int, typer.Option(help="Maximum number of frames; 0 renders the whole route.", rich_help_panel=_ROUTE)
    ] = 0,
    seed: Annotated[
        int, typer.Option(help="Random seed of the town and of the camera noise.", rich_help_panel=_SCENE)
    ] = SimulationConfig.seed,
    change_illumination: Annotated[
        bool,
        typer.Option("--change-illumination", help="Give later laps another sun and sky.", rich_help_panel=_SCENE),
    ] = False,
    perceptual_aliasing: Annotated[
        bool,
        typer.Option("--perceptual-aliasing", help="Make two different streets look alike.", rich_help_panel=_SCENE),
    ] = False,
    cars_per_360m: Annotated[
        int,
        typer.Option("--cars-per-360m", help="Number of moving cars met on 360 metres.", rich_help_panel=_SCENE),
    ] = SimulationConfig.cars_per_360m,
    frame_rate: Annotated[
        float, typer.Option(help="Stereo pairs per second.", rich_help_panel=_CAMERA)
    ] = SimulationConfig.frame_rate_hz,
    width: Annotated[int, typer.Option(help="Image width, pixels.", rich_help_panel=_CAMERA)] = SimulationConfig.width,
    height: Annotated[
        int, typer.Option(help="Image height, pixels.", rich_help_panel=_CAMERA)
    ] = SimulationConfig.height,
    rectification_error: Annotated[
        float, typer.Option(help="Peak rectification error, pixels at KITTI's image size.", rich_help_panel=_CAMERA)
    ] = SimulationConfig.rectification_error_px,
    lens_error: Annotated[
        float,
        typer.Option(
            help="Lens distortion left by the calibration, pixels at 45 degrees off the axis at KITTI's image size.",
            rich_help_panel=_CAMERA,
        ),
    ] = SimulationConfig.lens_error_px,
    ideal_sensor: Annotated[
        bool,
        typer.Option(
            "--ideal-sensor",
            help="Leave out noise, blur, vignetting, exposure changes, calibration errors and wind.",
            rich_help_panel=_CAMERA,
        ),
    ] = False,
    save_depth: Annotated[
        bool,
        typer.Option("--save-depth", help="Also write the true depth map of each left image.", rich_help_panel=OUTPUT),
    ] = False,
) -> None:
    """Render a stereo drive through a procedural town, with exact ground truth, in the layout of KITTI.

    Example: revisit simulate circle --laps 2 --length 360 --out data/circle
    """
    from slam.pipeline.progress import progress_bar
    from slam.simulation import simulate as render

    spec = SimulationConfig(
        shape=shape,
        laps=laps,
        length_m=length,
        seed=seed,
        speed_m_per_s=speed,
        frame_rate_hz=frame_rate,
        width=width,
        height=height,
        lateral_offset_m=lateral_offset,
        reverse=reverse,
        change_illumination=change_illumination,
        perceptual_aliasing=perceptual_aliasing,
        cars_per_360m=cars_per_360m,
        rectification_error_px=rectification_error,
        lens_error_px=lens_error,
        max_frames=max_frames,
        ideal_sensor=ideal_sensor,
        depth=save_depth,
    )
    with progress_bar(Console(stderr=True), "Rendering") as progress:
        folder = render(spec, out, progress)
    message = f"{folder}: a drive in KITTI layout, sequence 00; run it with: revisit run {folder} --out DIR"
    Console().print(message, markup=False, highlight=False, soft_wrap=True)


def run(
    source: Annotated[Path, typer.Argument(help="Recording: a folder, a video or a bag.")],
    out: Out,
    sequence: Sequence = None,
    dataset_format: Format = None,
    fps: FrameRate = None,
    image_topic: ImageTopic = None,
    config: Settings = None,
    map_file: Annotated[
        Path | None,
        typer.Option(
            "--map",
            help="Saved map of an earlier drive, a map.db or a run folder, whose places are recognised too.",
            show_default="an empty map",
            rich_help_panel=INPUT,
        ),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Continue an interrupted run in the output folder.", rich_help_panel=INPUT),
    ] = False,
    paradigm: Annotated[
        str | None,
        typer.Option(
            help=f"Place-recognition paradigm: {PARADIGM_NAMES}.",
            show_default=DEFAULT_PARADIGM,
            rich_help_panel=RECOGNITION,
        ),
    ] = None,
    features: Annotated[
        str | None,
        typer.Option(
            help=f"Local features: {FEATURE_NAMES}.", show_default=DEFAULT_FEATURES, rich_help_panel=RECOGNITION
        ),
    ] = None,
    vocabulary: Annotated[
        Path | None,
        typer.Option(
            help="Vocabulary file of visual words.", show_default="a general vocabulary", rich_help_panel=RECOGNITION
        ),
    ] = None,
    descriptor: Annotated[
        str | None,
        typer.Option(
            help="Image descriptor of the paradigm global-descriptor: hog, or onnx:FILE.",
            show_default="hog",
            rich_help_panel=RECOGNITION,
        ),
    ] = None,
    robust: Annotated[
        str | None,
        typer.Option(
            help=f"Robust back end: {BACK_END_NAMES}.", show_default=DEFAULT_BACK_END, rich_help_panel=BACK_END
        ),
    ] = None,
    mono: Annotated[bool, typer.Option("--mono", help="Use the left camera alone.", rich_help_panel=BACK_END)] = False,
    camera_height: Annotated[
        float | None,
        typer.Option(
            help="Height of the camera above the road, metres, which gives the scale with --mono; 1.65 for KITTI.",
            show_default="unknown: no scale",
            rich_help_panel=BACK_END,
        ),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(help="Seed of every random generator.", show_default="0", rich_help_panel=BACK_END),
    ] = None,
    view: Annotated[
        str, typer.Option(help="Live view during the run: none, native or web.", rich_help_panel=OUTPUT)
    ] = "none",
    no_record: Annotated[
        bool, typer.Option("--no-record", help="Do not write recording.rrd.", rich_help_panel=OUTPUT)
    ] = False,
    no_map: Annotated[
        bool,
        typer.Option(
            "--no-map",
            help="Do not write map.db; the run can then neither be resumed nor used by revisit locate.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Run the whole pipeline on a recording: odometry, place recognition, loop closing, pose graph, map, report.

    An interrupted run continues with --resume and ends with the same results. With --map the run starts from the map
    of an earlier drive, recognises its places, and ends with both drives in one map.

    Example: revisit run ~/kitti/dataset --sequence 05 --out runs/kitti05
    """
    from slam.pipeline.pipeline import RunOptions, run_pipeline

    options = RunOptions(
        source=source,
        sequence=sequence,
        out=out,
        view=view,
        overwrite=overwrite,
        resume=resume,
        map_file=map_file,
        config=config,
        format=dataset_format,
        fps=fps,
        topics=tuple(image_topic or ()),
    )
    chosen = {
        "paradigm": paradigm,
        "features": features,
        "vocabulary": None if vocabulary is None else str(vocabulary),
        "descriptor": descriptor,
        "robust": robust,
        "seed": seed,
        "save_recording": False if no_record else None,
        "save_map": False if no_map else None,
        "mono": mono or None,
        "camera_height": camera_height,
    }
    settings = {name: value for name, value in chosen.items() if value is not None}
    interrupted = run_pipeline(options, settings, Console(stderr=True), Console())
    raise typer.Exit(EXIT_INTERRUPTED if interrupted else 0)


def reprocess(
    map_: Annotated[
        Path, typer.Argument(metavar="MAP", help="Saved map of one drive: a map.db, or a run folder that has one.")
    ],
    out: Out,
    paradigm: Annotated[
        str | None,
        typer.Option(help=f"Place-recognition paradigm: {PARADIGM_NAMES}.", show_default=_FROM_MAP),
    ] = None,
    robust: Annotated[
        str | None, typer.Option(help=f"Robust back end: {BACK_END_NAMES}.", show_default=_FROM_MAP)
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(help="TOML file with settings, such as the config.toml of a run.", show_default=_FROM_MAP),
    ] = None,
    source: Annotated[
        Path | None, typer.Option(help="Recording of the drive, if it has been moved.", show_default=_FROM_MAP)
    ] = None,
    no_record: Annotated[
        bool, typer.Option("--no-record", help="Do not write recording.rrd.", rich_help_panel=OUTPUT)
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Search the loops of a drive again with other settings. Motions and landmarks are taken from its map.

    Settings that are not given stay as they were. The left images are read again for place recognition.

    Example: revisit reprocess runs/kitti05 --paradigm hierarchical-places --out runs/kitti05-hp
    """
    from dataclasses import replace

    from slam.map_database.replay import source_of
    from slam.pipeline.pipeline import RunOptions, run_pipeline

    found = source_of(map_)
    found = found if source is None else replace(found, path=source)
    options = RunOptions(
        source=found.path,
        sequence=found.sequence,
        out=out,
        view="none",
        overwrite=overwrite,
        reuse_map=map_,
        config=config,
        format=found.format,
        fps=found.fps,
        topics=found.topics,
    )
    chosen = {"paradigm": paradigm, "robust": robust, "save_recording": not no_record}
    settings = {name: value for name, value in chosen.items() if value is not None}
    interrupted = run_pipeline(options, settings, Console(stderr=True), Console())
    raise typer.Exit(EXIT_INTERRUPTED if interrupted else 0)


def dense(
    run: Annotated[Path, typer.Argument(help="Folder of a stereo run.")],
    source: Annotated[
        Path | None,
        typer.Argument(help="Recording of the run, if it has been moved.", show_default="as in the run"),
    ] = None,
    voxel_size: Annotated[float, typer.Option(help="Voxel size: distance between points, metres.")] = 0.15,
    max_depth: Annotated[float, typer.Option(help="Maximum depth that is fused, metres from the camera.")] = 25.0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the dense map of the run.")] = False,
) -> None:
    """Make the dense map of a run: point cloud and mesh before and after correction, and an occupancy grid.

    The files are written into the folder of the run, and its report shows the maps. Images are read once: the corrected
    pose graph moves finished submaps.

    Example: revisit dense runs/kitti05
    """
    from slam.apps.dense import DenseOptions, build_dense_map

    options = DenseOptions(run=run, source=source, voxel_m=voxel_size, max_depth_m=max_depth, overwrite=overwrite)
    message = build_dense_map(options, Console(stderr=True))
    Console().print(message, markup=False, highlight=False, soft_wrap=True)
