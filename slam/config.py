"""The configuration of a run, composed of the configurations of its components; the defaults work for any dataset.

It is written beside the results as `config.toml` and can be read from it again.
"""

import dataclasses
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import tomli_w

from odometry.mono.mono_config import MonoOdometryConfig
from odometry.stereo.rgbd_odometry import RgbdOdometryConfig
from odometry.stereo.stereo_odometry import StereoOdometryConfig
from place_recognition.image_processing.static_regions import StaticRegionConfig
from place_recognition.paradigms.registry import ParadigmsConfig
from slam.errors import ConfigError
from slam.keyframes import KeyFrameConfig
from slam.loop_closing.loop_closer import LoopCloserConfig
from slam.mapping.landmark_map import LandmarkMapConfig
from slam.pose_graph.node_chain import NodeSpacing
from slam.pose_graph.odometry_chain import OdometryDriftModel
from slam.pose_graph.pose_graph import PoseGraphConfig
from slam.pose_graph.robust.backends import DEFAULT

T = TypeVar("T")


@dataclass(frozen=True)
class MonoConfig:
    """Settings of a run with one camera.

    Attributes:
        odometry: settings of the odometry.
        drift: drift model of the odometry in the pose graph.
        scale_drift: standard deviation of the change of the logarithm of its unit of length over a path of one metre;
            it grows with the square root of the path length.
    """

    odometry: MonoOdometryConfig = field(default_factory=MonoOdometryConfig)
    drift: OdometryDriftModel = field(default_factory=lambda: OdometryDriftModel(sigma_m_per_m=0.03))
    scale_drift: float = 0.01


@dataclass(frozen=True)
class RgbdConfig:
    """Settings of a run with a depth camera, which sees as far as a room is wide.

    Attributes:
        odometry: settings of the odometry.
        key_frames: when a frame becomes a key frame of the map.
        nodes: selection of the frames that are optimised online.
        loop_sigma_m: noise floor of the translation of every loop.
        max_landmark_depth_m: maximum depth of points of the landmark map.
        min_revisit_path_m: length of the path before the newest image that is no past, beside what it still shows.
    """

    odometry: RgbdOdometryConfig = field(default_factory=RgbdOdometryConfig)
    key_frames: KeyFrameConfig = field(default_factory=lambda: KeyFrameConfig(min_distance_m=0.15))
    nodes: NodeSpacing = field(default_factory=lambda: NodeSpacing(min_distance_m=0.3))
    loop_sigma_m: float = 0.01
    max_landmark_depth_m: float = 5.0
    min_revisit_path_m: float = 0.5


@dataclass(frozen=True)
class RunConfig:
    """All settings that decide the result of a run.

    Attributes:
        paradigm: name of the place recogniser, or `file:PATH` for the matches of another program.
        robust: name of the back end of the final optimisation.
        seed: seed of every random generator.
        save_recording: write `recording.rrd`.
        save_map: write `map.db`, which resuming, localization and later sessions need.
        mono: use the left camera alone.
        depth: use the depth images of a depth camera; a run sets it where the recording has them.
        odometry_file: trajectory of another program, whose motions replace those measured here; empty for none.
        odometry_covariance: how uncertain these motions are (`slam.external.odometry_file.read_uncertainty`).
        trust_poses: take the relative poses of a file of matches as they are, without looking at the images.
        mask: path of an image of the camera's size, black where it does not show the scene; empty for none.
        static_regions: how such parts are found without it.
        odometry: settings of the stereo odometry.
        mono_odometry: settings of a run with one camera.
        rgbd: settings of a run with a depth camera.
        place_recognition: settings of the place recognisers.
        loop_closing: settings of the geometric verification of loops.
        pose_graph: noise model and loop selection of the pose graph, for a stereo pair.
        key_frames: when a frame becomes a key frame of the map.
        landmarks: settings of the landmark map.
    """

    paradigm: str = "tracked-words"
    robust: str = DEFAULT
    seed: int = 0
    save_recording: bool = True
    save_map: bool = True
    mono: bool = False
    depth: bool = False
    odometry_file: str = ""
    odometry_covariance: str = ""
    trust_poses: bool = False
    mask: str = ""
    static_regions: StaticRegionConfig = field(default_factory=StaticRegionConfig)
    odometry: StereoOdometryConfig = field(default_factory=StereoOdometryConfig)
    mono_odometry: MonoConfig = field(default_factory=MonoConfig)
    rgbd: RgbdConfig = field(default_factory=RgbdConfig)
    place_recognition: ParadigmsConfig = field(default_factory=ParadigmsConfig)
    loop_closing: LoopCloserConfig = field(default_factory=LoopCloserConfig)
    pose_graph: PoseGraphConfig = field(default_factory=PoseGraphConfig)
    key_frames: KeyFrameConfig = field(default_factory=KeyFrameConfig)
    landmarks: LandmarkMapConfig = field(default_factory=LandmarkMapConfig)

    def pose_graph_for_camera(self) -> PoseGraphConfig:
        """Settings of the pose graph, with the drift of the odometry that is used."""
        if self.depth:
            return replace(self.pose_graph, nodes=self.rgbd.nodes, loop_sigma_m=self.rgbd.loop_sigma_m)
        if not self.mono:
            return self.pose_graph
        return replace(self.pose_graph, drift=self.mono_odometry.drift, scale_drift=self.mono_odometry.scale_drift)

    def key_frames_for_camera(self) -> KeyFrameConfig:
        """When a frame becomes a key frame."""
        return self.rgbd.key_frames if self.depth else self.key_frames

    def places_for_camera(self) -> ParadigmsConfig:
        """Settings of place recognition, with the length of path that separates images of one place."""
        places = self.place_recognition
        if not self.depth:
            return places
        return replace(places, view=replace(places.view, min_distance_m=self.rgbd.min_revisit_path_m))

    def with_depth_of(self, has_depth: bool) -> "RunConfig":
        """Settings for a recording with depth images or without; one camera alone does not use them."""
        return replace(self, depth=has_depth and not self.mono)


@dataclass(frozen=True)
class ChangedSetting:
    """A setting that differs from its default.

    Attributes:
        name: dotted name, such as `key_frames.min_distance_m`.
        value, default: its value in the run, and in a run without options.
    """

    name: str
    value: Any
    default: Any

    def __str__(self) -> str:
        """Return name, value and default on one line."""
        return f"{self.name} = {self.value!r} (default {self.default!r})"


def to_toml(config: RunConfig) -> str:
    """Configuration as TOML text; settings that are None are left out.

    Comments at the top list the settings that differ from the defaults.
    """
    comments = [f"# {change}" for change in changed_settings(config)]
    heading = "# Different from the defaults:" if comments else "# All settings have their defaults."
    return "\n".join([heading, *comments, "", tomli_w.dumps(_without_none(dataclasses.asdict(config)))])


def changed_settings(config: RunConfig) -> tuple[ChangedSetting, ...]:
    """Settings that differ from the defaults, in the order of the configuration."""
    return tuple(_changes(dataclasses.asdict(config), dataclasses.asdict(RunConfig()), ""))


def _changes(values: Mapping[str, Any], defaults: Mapping[str, Any], prefix: str) -> Iterator[ChangedSetting]:
    for name, value in values.items():
        default = defaults.get(name)
        if isinstance(value, dict) and isinstance(default, dict):
            yield from _changes(value, default, f"{prefix}{name}.")
        elif value != default:
            yield ChangedSetting(f"{prefix}{name}", value, default)


def read_config(path: Path) -> RunConfig:
    """Configuration from a TOML file; settings that it does not name keep their defaults.

    Raises:
        ConfigError: the file is missing or damaged, or holds an unknown name or a value of the wrong type.
    """
    return from_values(RunConfig, read_toml(path), str(path))


def parse_config(text: str, where: str) -> RunConfig:
    """Configuration from TOML text, such as `to_toml` gives.

    Args:
        text: the settings.
        where: name of their source, for messages.

    Raises:
        ConfigError: the text is no TOML, or holds an unknown name or a value of the wrong type.
    """
    return from_values(RunConfig, _parse_toml(text, where), where)


def read_toml(path: Path) -> dict[str, Any]:
    """Values of a TOML file.

    Raises:
        ConfigError: the file is missing or damaged.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: expected a TOML file, {error}; correct that line") from error
    return _parse_toml(text, str(path))


def _parse_toml(text: str, where: str) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also for numbers that are too long and tables that are too deep
        raise ConfigError(f"{where}: expected a TOML file, {error}; correct that line") from error


def from_values(kind: type[T], values: dict[str, Any], where: str) -> T:
    """A frozen dataclass, nested ones too, from the values of a TOML table.

    Args:
        kind: the dataclass; fields without a value keep their defaults.
        values: values by the names of the fields.
        where: name of the table, for messages.

    Raises:
        ConfigError: an unknown name, or a value of the wrong type.
    """
    hints = get_type_hints(kind)
    unknown = sorted(set(values) - set(hints))
    if unknown:
        raise ConfigError(f"{where}: unknown setting {unknown[0]!r}; known here: {', '.join(sorted(hints))}")
    settings = {name: _check_value(hints[name], value, f"{where}: {name}") for name, value in values.items()}
    try:
        return kind(**settings)
    except (ValueError, ConfigError) as error:
        raise ConfigError(f"{where}: {error}") from error
    except OverflowError as error:
        raise ConfigError(f"{where}: expected numbers within bounds, found one beyond them: {error}") from error


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    return value


def _check_value(kind: Any, value: Any, where: str) -> Any:
    """The value of a setting, nested settings too, as the type `kind` of its field."""
    if dataclasses.is_dataclass(kind) and isinstance(value, dict):
        return from_values(kind, value, where)  # type: ignore[arg-type]
    if get_origin(kind) is tuple:
        return _check_list(get_args(kind), value, where)
    if get_origin(kind) is UnionType:  # a type or None, and TOML has no None
        return _check_value(get_args(kind)[0], value, where)
    if kind is Any:
        return _as_tuple(value) if isinstance(value, list) else value
    return _check_scalar(kind, value, where) if isinstance(kind, type) else value


def _check_scalar(kind: type, value: Any, where: str) -> Any:
    is_bool = isinstance(value, bool)  # Python counts it among the integers, a setting does not
    if kind is float and isinstance(value, int) and not is_bool:
        return _as_float(value, where)
    if not isinstance(value, kind) or (is_bool and kind is not bool):
        raise ConfigError(f"{where}: expected {kind.__name__}, found {value!r}")
    return value


def _check_list(kinds: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list):
        raise ConfigError(f"{where}: expected a list, found {value!r}")
    wanted = kinds[:1] * len(value) if kinds[1:] == (...,) else kinds
    if len(value) != len(wanted):
        raise ConfigError(f"{where}: expected a list of {len(wanted)}, found {len(value)}")
    return tuple(_check_value(kind, item, where) for kind, item in zip(wanted, value, strict=True))


def _as_float(value: int, where: str) -> float:
    try:
        return float(value)
    except OverflowError as error:
        raise ConfigError(f"{where}: expected a number, found one beyond all bounds: {error}") from error


def _as_tuple(values: list[Any]) -> tuple[Any, ...]:
    """Lists as tuples, nested ones too: TOML has no tuples."""
    return tuple(_as_tuple(value) if isinstance(value, list) else value for value in values)
