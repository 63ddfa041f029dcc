"""The configuration of a benchmark: sources, odometries, paradigms, back ends and seeds, read from a TOML file.

Every combination of them is a run. Paths are relative to the file:

    odometry = ["stereo", "mono", "file:orbslam/{source}.txt"]
    paradigms = ["tracked-words", "dynamic-sequences", "file:netvlad.csv"]
    preset = ["default", "published"]
    robust = ["pcm+gnc"]
    seeds = [0, 1]
    config = "settings.toml"

    [[sources]]
    path = "data/kitti"
    sequence = "05"

    [[sources]]
    simulate = "blocks"
    laps = 2
    length_m = 300

`file:` takes trajectories and matches of other programs; `{source}` in the path stands for the name of the source.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from slam.components import check_preset
from slam.config import RunConfig, from_values, read_toml
from slam.datasets.dataset import DatasetSpec
from slam.errors import ConfigError
from slam.external.matches_file import FILE_PREFIX, path_of
from slam.simulation.scenario.config import SHAPES, SimulationConfig

ODOMETRIES = ("stereo", "mono")  # those of the system, by name


@dataclass(frozen=True)
class RecordedSource:
    """A recording that exists.

    Attributes:
        name: name of the source, with which the names of its runs begin.
        source: recording to read.
    """

    name: str
    source: DatasetSpec


@dataclass(frozen=True)
class SimulatedSource:
    """A simulated drive that is rendered first.

    Attributes:
        name: name of its folder, with which the names of its runs begin.
        spec: specification of the simulated drive.
    """

    name: str
    spec: SimulationConfig


@dataclass(frozen=True)
class Sweep:
    """Every source with every paradigm, back end and seed.

    Attributes:
        sources: sources with different names.
        odometries: "stereo", "mono" or "file:PATH"; None for that of the settings.
        paradigms: names of place-recognition paradigms, or "file:PATH".
        presets: names of their presets; None for that of the settings.
        robust: names of robust back ends.
        seeds: seeds of every random generator of a run.
        config: TOML file with the settings of all runs; None for the defaults.
        record: whether each run writes `recording.rrd`.
    """

    sources: tuple[RecordedSource | SimulatedSource, ...]
    odometries: tuple[str | None, ...]
    paradigms: tuple[str, ...]
    presets: tuple[str | None, ...]
    robust: tuple[str, ...]
    seeds: tuple[int, ...]
    config: Path | None
    record: bool


@dataclass(frozen=True)
class _SweepFile:
    """The values of the file before they are checked."""

    sources: tuple[Any, ...] = ()
    odometry: tuple[Any, ...] = ()
    paradigms: tuple[Any, ...] = (RunConfig.paradigm,)
    preset: Any = None  # a name, or a list of names
    robust: tuple[Any, ...] = (RunConfig.robust,)
    seeds: tuple[Any, ...] = (RunConfig.seed,)
    config: str = ""
    record: bool = False


@dataclass(frozen=True)
class _SourceFile:
    path: str
    sequence: str = ""
    format: str = ""


def read_sweep(path: Path) -> Sweep:
    """Read the TOML file of a benchmark.

    Raises:
        ConfigError: the file is missing or damaged, or holds an unknown name or a value of the wrong type.
    """
    return parse_sweep(read_toml(path), path)


def parse_sweep(values: dict[str, Any], path: Path) -> Sweep:
    """Make a sweep from the values of its file.

    Raises:
        ConfigError: an unknown name or a value of the wrong type.
    """
    written = from_values(_SweepFile, values, str(path))
    sources = [_source(entry, f"{path}: source {n}", path.parent) for n, entry in enumerate(written.sources, start=1)]
    _check_list(tuple(source.name for source in sources), str, f"{path}: sources (give each a name = ... of its own)")
    _check_list(written.paradigms, str, f"{path}: paradigms")
    presets = _presets(written.preset, f"{path}: preset")
    _check_list(written.robust, str, f"{path}: robust")
    _check_list(written.seeds, int, f"{path}: seeds")
    config = _path(written.config, path.parent, f"{path}: config") if written.config else None
    odometries = _odometries(written.odometry, path)
    paradigms = tuple(_absolute(name, path.parent, f"{path}: paradigms") for name in written.paradigms)
    axes = (odometries, paradigms, presets, written.robust, written.seeds)
    return Sweep(tuple(sources), *axes, config, written.record)


def _odometries(written: tuple[Any, ...], path: Path) -> tuple[str | None, ...]:
    """Return names of odometries, with absolute paths; (None,) where there is none."""
    if not written:
        return (None,)
    where = f"{path}: odometry"
    _check_list(written, str, where)
    for name in written:
        if name not in ODOMETRIES and path_of(name) is None:
            known = ", ".join((*ODOMETRIES, f"{FILE_PREFIX}PATH"))
            raise ConfigError(f"{where}: unknown odometry {name!r}; expected one of {known}")
    return tuple(_absolute(name, path.parent, where) for name in written)


def _absolute(name: str, folder: Path, where: str) -> str:
    """Return a name with the absolute path of its file, if it names one."""
    file = path_of(name)
    return name if file is None else f"{FILE_PREFIX}{_path(str(file), folder, where)}"


def _presets(written: object, where: str) -> tuple[str | None, ...]:
    """Return the names of a name or of a list of names; (None,) where there is none."""
    if written is None:
        return (None,)
    names = written if isinstance(written, tuple) else (written,)
    _check_list(names, str, where)
    for name in names:
        try:
            check_preset(name)
        except ConfigError as error:
            raise ConfigError(f"{where}: {error}") from None
    return names


def _check_list(values: tuple[Any, ...], kind: type, where: str) -> None:
    """Raise ConfigError unless these are one or more different values of one type."""
    wanted = f"{where}: expected one or more different {'numbers from 0 on' if kind is int else 'names'}"
    if not values:
        raise ConfigError(f"{wanted}, found none")
    wrong = [value for value in values if not _is_valid(value, kind)]
    if wrong:
        raise ConfigError(f"{wanted}, found {wrong[0]!r}")
    twice = [value for n, value in enumerate(values) if value in values[:n]]
    if twice:
        raise ConfigError(f"{wanted}, found {twice[0]!r} twice")


def _is_valid(value: object, kind: type) -> bool:
    # Not isinstance: True is an int of Python, and no seed.
    return type(value) is kind and not (isinstance(value, int) and value < 0)


def _source(entry: object, where: str, folder: Path) -> RecordedSource | SimulatedSource:
    if not isinstance(entry, dict) or ("path" in entry) == ("simulate" in entry):
        raise ConfigError(f"{where}: expected a table with path = ... or with simulate = ..., found {entry!r}")
    settings = {key: value for key, value in entry.items() if key != "name"}
    given = entry.get("name", "")
    if not isinstance(given, str):
        raise ConfigError(f"{where}: name: expected str, found {given!r}")
    if "path" in entry:
        return _recorded(given, settings, where, folder)
    return _simulated(given, settings, where, folder)


def _recorded(name: str, settings: dict[str, Any], where: str, folder: Path) -> RecordedSource:
    written = from_values(_SourceFile, settings, where)
    path = _path(written.path, folder, f"{where}: path")
    own = "-".join(part for part in (path.name, written.sequence) if part)
    return RecordedSource(_file_name(name or own), DatasetSpec(path, written.sequence or None, written.format or None))


def _simulated(name: str, settings: dict[str, Any], where: str, folder: Path) -> SimulatedSource:
    shape = settings.pop("simulate")
    if not isinstance(shape, str):
        raise ConfigError(f"{where}: simulate: expected a shape or the path of a KITTI pose file, found {shape!r}")
    path = shape if shape in SHAPES else str(_path(shape, folder, f"{where}: simulate"))
    spec = from_values(SimulationConfig, {"shape": path, **settings}, where)
    own = "-".join([Path(shape).stem, *(f"{key}-{value}" for key, value in settings.items())])
    return SimulatedSource(_file_name(name or own), spec)


def _path(written: str, folder: Path, where: str) -> Path:
    try:
        path = (folder / Path(written).expanduser()).resolve()
        path.exists()  # raises ValueError or OSError for names that no file can have
    except (OSError, ValueError, RuntimeError) as error:
        raise ConfigError(f"{where}: expected a path, found {written[:60]!r}: {error}") from None
    return path


def _file_name(name: str) -> str:
    """Replace characters that a file name should not have; letters of any script, digits and - . + _ stay."""
    return re.sub(r"[^\w.+-]", "_", name).lstrip(".") or "_"
