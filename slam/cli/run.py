"""Commands that run the pipeline: on a simulated drive, a recorded one, a saved map, or densely on a finished run."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from slam.cli import options as option
from slam.cli.options import EXIT_INTERRUPTED
from slam.errors import ConfigError
from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.scenario.room_config import ROOM, RoomConfig

_UNIT = re.compile(r"_(m_per_s|hz|px|m|s)$")  # that ends the name of a setting, but not of an option


def demo(
    out: option.Out = Path("runs/demo"),
    seed: Annotated[int, typer.Option(help="Random seed of the town and of the camera noise.")] = 0,
) -> None:
    """Simulate two laps of two blocks, run the whole pipeline on one camera and write a report. Needs no download.

    The drive is rendered once and kept in a cache. The results in the output folder are replaced each time.

    Example: revisit demo --out runs/demo
    """
    from slam.apps.demo import run_demo

    interrupted = run_demo(out, seed, Console(stderr=True), Console())
    raise typer.Exit(EXIT_INTERRUPTED if interrupted else 0)


def simulate(
    shape: option.Shape,
    out: option.Out,
    laps: option.Laps = None,
    length: option.LapLength = None,
    speed: option.Speed = None,
    lateral_offset: option.LateralOffset = None,
    reverse: option.Reverse = False,
    seed: option.SceneSeed = None,
    change_illumination: option.ChangeIllumination = False,
    perceptual_aliasing: option.PerceptualAliasing = False,
    cars_per_360m: option.CarsPer360m = None,
    difficulty: option.DifficultyLevel = None,
    motion: option.Motion = None,
    sensor: option.Sensor = None,
    duration: option.Duration = None,
    pure_rotation: option.PureRotation = None,
    frame_rate: option.SimulatedFrameRate = None,
    max_frames: option.MaxFrames = None,
    width: option.Width = None,
    height: option.Height = None,
    rectification_error: option.RectificationError = None,
    lens_error: option.LensError = None,
    ideal_sensor: option.IdealSensor = False,
    save_depth: option.SaveDepth = False,
) -> None:
    """Render a stereo drive through a procedural town, or a camera in a room, with exact ground truth.

    A drive has the layout of KITTI; a room that of TUM RGB-D, or of KITTI for a stereo pair.

    Example: revisit simulate circle --laps 2 --length 360 --out data/circle

    Example: revisit simulate room --motion hand --sensor depth --seed 1 --out data/room
    """
    both: dict[str, Any] = {
        "seed": seed,
        "frame_rate_hz": frame_rate,
        "max_frames": max_frames,
        "width": width,
        "height": height,
    }
    both |= {"difficulty": "clean" if ideal_sensor else difficulty}
    both |= {"rectification_error_px": rectification_error, "lens_error_px": lens_error}
    drive = {"laps": laps, "length_m": length, "speed_m_per_s": speed, "lateral_offset_m": lateral_offset}
    drive |= {"reverse": reverse or None, "change_illumination": change_illumination or None}
    drive |= {"perceptual_aliasing": perceptual_aliasing or None, "cars_per_360m": cars_per_360m}
    drive |= {"depth": save_depth or None}
    room = {"motion": motion, "sensor": sensor, "duration_s": duration, "pure_rotation_s": pure_rotation}
    if shape == ROOM:
        _reject(drive, "a drive, not of a room")
        _render_room(RoomConfig(**_given({**both, **room})), out)
    else:
        _reject(room, "a room, not of a drive")
        _render_drive(SimulationConfig(shape, **_given({**both, **drive})), out)


def _reject(settings: dict[str, Any], owner: str) -> None:
    """Refuse options that mean nothing here.

    Raises:
        ConfigError: one is given.
    """
    for field in _given(settings):
        name = "save-depth" if field == "depth" else _UNIT.sub("", field).replace("_", "-")
        raise ConfigError(f"--{name}: it is an option of {owner}; leave it out")


def _render_drive(config: SimulationConfig, out: Path) -> None:
    from slam.pipeline.progress import announce_compilation, progress_bar
    from slam.simulation import simulate as render

    messages = Console(stderr=True)
    with announce_compilation(messages), progress_bar(messages, "Rendering") as progress:
        folder = render(config, out, progress)
    _say(f"{folder}: a drive in KITTI layout, sequence 00; run it with: revisit run {folder} --out DIR")


def _render_room(config: RoomConfig, out: Path) -> None:
    from slam.pipeline.progress import announce_compilation, progress_bar
    from slam.simulation import simulate_room

    messages = Console(stderr=True)
    with announce_compilation(messages), progress_bar(messages, "Rendering") as progress:
        folder = simulate_room(config, out, progress)
    layout, mono = "KITTI" if config.sensor == "stereo" else "TUM RGB-D", " --mono" if config.sensor == "mono" else ""
    _say(f"{folder}: a room in {layout} layout; run it with: revisit run {folder}{mono} --out DIR")


def _say(message: str) -> None:
    Console().print(message, markup=False, highlight=False, soft_wrap=True)


def run(
    source: Annotated[Path, typer.Argument(help="Recording: a folder, a video or a bag.")],
    out: option.Out,
    sequence: option.Sequence = None,
    dataset_format: option.Format = None,
    fps: option.FrameRate = None,
    image_topic: option.ImageTopic = None,
    mask: option.Mask = None,
    config: option.Settings = None,
    map_file: option.EarlierMap = None,
    resume: option.Resume = False,
    paradigm: option.RunParadigm = None,
    preset: option.RunPreset = None,
    matches: option.MatchesFile = None,
    trust_poses: option.TrustPoses = False,
    features: option.RunFeatures = None,
    vocabulary: option.Vocabulary = None,
    descriptor: option.RunDescriptor = None,
    robust: option.RunRobust = None,
    odometry: option.OdometryFile = None,
    odometry_covariance: option.OdometryCovariance = None,
    mono: option.Mono = False,
    camera_height: option.CameraHeight = None,
    seed: option.RunSeed = None,
    view: option.View = "none",
    no_record: option.NoRecord = False,
    no_map: option.NoMap = False,
    overwrite: option.Overwrite = False,
) -> None:
    """Run the whole pipeline on a recording: odometry, place recognition, loop closing, pose graph, map, report.

    An interrupted run continues with --resume and ends with the same results. With --map the run starts from the map
    of an earlier drive, recognises its places, and ends with both drives in one map.

    Example: revisit run ~/kitti/dataset --sequence 05 --out runs/kitti05
    """
    from slam.pipeline.pipeline import RunOptions, run_pipeline

    topics = tuple(image_topic or ())
    recording = RunOptions(source=source, sequence=sequence, out=out, format=dataset_format, fps=fps, topics=topics)
    options = replace(recording, view=view, overwrite=overwrite, resume=resume, map_file=map_file, config=config)
    chosen = _absolute_file_of(option.choose_paradigm(paradigm, matches))
    settings: dict[str, object] = {"paradigm": chosen, "preset": preset}
    settings |= {"odometry_file": _absolute(odometry), "odometry_covariance": _absolute_covariance(odometry_covariance)}
    settings |= {"trust_poses": trust_poses or None}
    settings |= {"features": _absolute_file_of(features), "descriptor": _absolute_file_of(descriptor)}
    settings |= {"vocabulary": _absolute(vocabulary), "robust": robust, "seed": seed}
    settings |= {"mask": _absolute(mask)}
    settings |= {"mono": mono or None, "camera_height": camera_height}
    settings |= {"save_recording": False if no_record else None, "save_map": False if no_map else None}
    interrupted = run_pipeline(options, _given(settings), Console(stderr=True), Console())
    raise typer.Exit(EXIT_INTERRUPTED if interrupted else 0)


def _absolute(path: Path | None) -> str | None:
    """A path as it stands in config.toml, so that --resume finds the file from any folder."""
    return None if path is None else str(path.absolute())


def _absolute_covariance(value: str | None) -> str | None:
    return str(Path(value).absolute()) if value and Path(value).is_file() else value


def _absolute_file_of(name: str | None) -> str | None:
    """A name such as `onnx:FILE` or `file:FILE` with the path absolute, any other name as it is."""
    kind, separator, file = (name or "").partition(":")
    return f"{kind}:{Path(file).absolute()}" if separator and file else name


def _given(settings: dict[str, Any]) -> dict[str, Any]:
    """Keep the settings that an option gives; the others come from --config or stay at their defaults."""
    return {name: value for name, value in settings.items() if value is not None}


def reprocess(
    map_: option.MapToReprocess,
    out: option.Out,
    paradigm: option.NewParadigm = None,
    preset: option.NewPreset = None,
    robust: option.NewRobust = None,
    config: option.NewSettings = None,
    source: option.MovedSource = None,
    no_record: option.NoRecord = False,
    overwrite: option.Overwrite = False,
) -> None:
    """Search the loops of a drive again with other settings. Motions and landmarks are taken from its map.

    Settings that are not given stay as they were. The left images are read again for place recognition.

    Example: revisit reprocess runs/kitti05 --paradigm hierarchical-places --out runs/kitti05-hp
    """
    from slam.map_database.replay import source_of
    from slam.pipeline.pipeline import RunOptions, run_pipeline

    found = source_of(map_)
    found = found if source is None else replace(found, path=source)
    options = RunOptions(
        source=found.path,
        sequence=found.sequence,
        out=out,
        overwrite=overwrite,
        reuse_map=map_,
        config=config,
        format=found.format,
        fps=found.fps,
        topics=found.topics,
    )
    settings = _given({"paradigm": paradigm, "preset": preset, "robust": robust, "save_recording": not no_record})
    interrupted = run_pipeline(options, settings, Console(stderr=True), Console())
    raise typer.Exit(EXIT_INTERRUPTED if interrupted else 0)


def dense(
    run: Annotated[Path, typer.Argument(help="Folder of a run with a stereo pair or a depth camera.")],
    source: Annotated[
        Path | None,
        typer.Argument(help="Recording of the run, if it has been moved.", show_default="as in the run"),
    ] = None,
    voxel_size: Annotated[
        float | None,
        typer.Option(
            help="Voxel size: distance between points, metres.", show_default="0.15; with a depth camera 0.02"
        ),
    ] = None,
    max_depth: Annotated[
        float | None,
        typer.Option(
            help="Maximum depth that is fused, metres from the camera.", show_default="25; with a depth camera 4"
        ),
    ] = None,
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
