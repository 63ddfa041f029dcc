"""The command that renders simulated recordings: drives through a town, and rooms."""

import re
from pathlib import Path
from typing import Any

from rich.console import Console

from slam.cli import options as option
from slam.errors import ConfigError
from slam.simulation.scenario.config import SimulationConfig
from slam.simulation.scenario.room_config import ROOM, RoomConfig

_UNIT = re.compile(r"_(m_per_s|hz|px|m|s)$")  # that ends the name of a setting, but not of an option


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


def _given(settings: dict[str, Any]) -> dict[str, Any]:
    """Keep the settings that an option gives; the others stay at their defaults."""
    return {name: value for name, value in settings.items() if value is not None}


def _reject(settings: dict[str, Any], owner: str) -> None:
    """Refuse options that mean nothing here.

    Raises:
        ConfigError: one is given.
    """
    for field in _given(settings):
        name = "save-depth" if field == "depth" else _UNIT.sub("", field).replace("_", "-")
        raise ConfigError(f"--{name}: it is an option of {owner}; leave it out")


def _render_drive(config: SimulationConfig, out: Path) -> None:
    from slam.pipeline.progress import progress_bar
    from slam.simulation import simulate as render

    with progress_bar(Console(stderr=True), "Rendering") as progress:
        folder = render(config, out, progress)
    _say(f"{folder}: a drive in KITTI layout, sequence 00; run it with: revisit run {folder} --out DIR")


def _render_room(config: RoomConfig, out: Path) -> None:
    from slam.pipeline.progress import progress_bar
    from slam.simulation import simulate_room

    with progress_bar(Console(stderr=True), "Rendering") as progress:
        folder = simulate_room(config, out, progress)
    layout, mono = ("KITTI", "") if config.sensor == "stereo" else ("TUM RGB-D", " --mono")
    _say(f"{folder}: a room in {layout} layout; run it with: revisit run {folder}{mono} --out DIR")


def _say(message: str) -> None:
    Console().print(message, markup=False, highlight=False, soft_wrap=True)
