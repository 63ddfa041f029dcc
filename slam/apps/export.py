"""`revisit export`: results of a run in the formats of other programs."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from slam.errors import ConfigError, DataError, OutputError
from slam.io.colmap import Model, write_colmap
from slam.io.files import atomic_writer
from slam.io.landmarks import read_cloud, read_landmark_observers
from slam.io.run_folder import RunFolder
from slam.io.trajectory_files import read_tum, write_kitti, write_tum

STATES = ("odometry", "online", "corrected")
_MAP_SUFFIXES = {"odometry": "before", "corrected": "after"}  # of the files of graph and map
_TRAJECTORIES = ("tum", "kitti")
_SUFFIXES = {"tum": ".tum", "kitti": ".txt", "g2o": ".g2o", "ply": ".ply", "colmap": "_colmap"}


@dataclass(frozen=True)
class ExportOptions:
    """Options of an export.

    Attributes:
        run: folder of a run.
        format: key of FORMATS.
        state: one of STATES: odometry alone, the online estimate of each frame, or corrected.
        out: the file to write, a folder for colmap; None for a name beside the run that begins with the run's.
        overwrite: whether an existing file is replaced.
    """

    run: Path
    format: str
    state: str = "corrected"
    out: Path | None = None
    overwrite: bool = False


def export_result(options: ExportOptions) -> Path:
    """Write one result of a run in one format and return the file or folder that was written.

    Raises:
        ConfigError: the format or state is unknown, or a run has no such result in that state.
        DataError: the run does not have the result, or it is damaged.
        OutputError: the file exists, or cannot be written.
    """
    _check(options)
    folder = options.run.resolve()
    out = options.out or options.run.with_name(f"{folder.name}_{options.state}{_SUFFIXES[options.format]}")
    if out.exists() and not options.overwrite:
        raise OutputError(f"{out}: this file exists already; choose another name or add --overwrite")
    FORMATS[options.format](options.run, options.state, out)
    return out


def _check(options: ExportOptions) -> None:
    if options.format not in FORMATS:
        raise ConfigError(f"--format: expected one of {', '.join(FORMATS)}, found {options.format!r}")
    known = STATES if options.format in _TRAJECTORIES else tuple(_MAP_SUFFIXES)
    if options.state not in known:
        raise ConfigError(f"--state: expected one of {', '.join(known)} for {options.format}, found {options.state!r}")


def _tum(run: Path, state: str, out: Path) -> None:
    write_tum(out, *read_tum(_result(run, f"trajectory_{state}.tum")))


def _kitti(run: Path, state: str, out: Path) -> None:
    write_kitti(out, read_tum(_result(run, f"trajectory_{state}.tum"))[1])


def _g2o(run: Path, state: str, out: Path) -> None:
    _copy(_result(run, f"pose_graph_{_MAP_SUFFIXES[state]}.g2o"), out)


def _ply(run: Path, state: str, out: Path) -> None:
    _copy(_result(run, f"map_{_MAP_SUFFIXES[state]}.ply"), out)


def _colmap(run: Path, state: str, out: Path) -> None:
    model = _model(run, state)
    with RunFolder.create(out, overwrite=True) as folder:
        write_colmap(folder.path, model)
        folder.commit()


def _model(run: Path, state: str) -> Model:
    observers = read_landmark_observers(_result(run, "landmarks.npz"))
    cloud = read_cloud(_result(run, f"map_{_MAP_SUFFIXES[state]}.ply"))
    poses = read_tum(_result(run, f"trajectory_{state}.tum"))[1]
    if len(cloud.points) != len(observers.frames) or observers.frames.max(initial=0) >= len(poses):
        raise DataError(
            f"{run / 'landmarks.npz'}: expected a frame, up to {len(poses) - 1}, for each of {len(cloud.points)}"
            f" landmarks, found {len(observers.frames)} up to {observers.frames.max(initial=0)}; run again"
        )
    return Model(poses, cloud, observers)


def _result(run: Path, name: str) -> Path:
    path = run / name
    if not path.is_file():
        raise DataError(
            f"{path}: expected the result of a run, found none; make one with: revisit run SOURCE --out DIR"
        )
    return path


def _copy(source: Path, out: Path) -> None:
    with atomic_writer(out, "wb") as file:
        file.write(source.read_bytes())


FORMATS: dict[str, Callable[[Path, str, Path], None]] = {
    "tum": _tum,
    "kitti": _kitti,
    "g2o": _g2o,
    "ply": _ply,
    "colmap": _colmap,
}
