"""`revisit dense`: dense maps of a run before and after correction, and an occupancy grid."""

import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from odometry.stereo.stereo_self_calibration import Calibration
from slam.config import read_config
from slam.datasets.dataset import Dataset, DatasetSpec, is_same_image
from slam.datasets.formats.registry import open_dataset
from slam.errors import ConfigError, DataError, OutputError
from slam.io.calibration import read_calibration
from slam.io.folder_lock import FolderLock
from slam.io.frames_and_loops_csv import read_frames
from slam.io.metrics import read_metrics
from slam.io.run_folder import STAGING
from slam.io.trajectory_files import read_tum
from slam.keyframes import KeyFrameConfig
from slam.mapping.birds_eye_view import PlaneWindow, render_birds_eye_view
from slam.mapping.dense_mapper import DenseMapConfig, DenseMapper, OdometryTrajectory, group_key_frames
from slam.mapping.occupancy_grid import (
    OccupancyGrid,
    build_floor_grid,
    build_occupancy_grid,
    find_floor,
    write_occupancy_grid,
)
from slam.mapping.submaps import SubmapStore, write_mesh
from slam.mapping.tsdf import DEPTH_CAMERA_FUSION, FusionConfig
from slam.pipeline.progress import progress_bar
from slam.report.dense_map_section import DenseOverview, write_dense_page
from slam.report.html_report import DENSE_PAGE
from slam.viewer.recordings import PlacedMap, record_dense_map

Array = NDArray[np.float64]

RECORDING, DENSE_RECORDING = "recording.rrd", "dense.rrd"
RESULTS = (
    "dense_before.ply", "dense_after.ply", "mesh_before.ply", "mesh_after.ply", "occupancy.png", "occupancy.yaml",
    DENSE_PAGE, DENSE_RECORDING,
)  # fmt: skip
_SAME_TIME_S = 1e-6
_ABOVE_CAMERA_M = 0.3  # from where on a room is left open: the ceiling would hide it
_PIXEL_VOXELS = 4 / 3  # size of a pixel of the page's pictures: smaller ones leave gaps between the points


@dataclass(frozen=True)
class DenseOptions:
    """Options of a dense map.

    Attributes:
        run: folder of a run, to which the results are written.
        source: new path of its recording; None if that has not moved.
        voxel_m: edge of a voxel, about the distance between points, metres; None for that of the sensor.
        max_depth_m: maximum depth of fused pixels, metres; None for that of the sensor.
        overwrite: whether an existing dense map is replaced.
    """

    run: Path
    source: Path | None = None
    voxel_m: float | None = None
    max_depth_m: float | None = None
    overwrite: bool = False

    def config(self, has_depth: bool) -> DenseMapConfig:
        """Configuration of the fusion, of measured depth or of stereo.

        Raises:
            ConfigError: a number is not positive and finite.
        """
        sensor = DEPTH_CAMERA_FUSION if has_depth else FusionConfig()
        voxel_m = sensor.voxel_m if self.voxel_m is None else self.voxel_m
        max_depth_m = sensor.max_depth_m if self.max_depth_m is None else self.max_depth_m
        try:
            return DenseMapConfig(fusion=replace(sensor, voxel_m=voxel_m, max_depth_m=max_depth_m))
        except ValueError as error:
            raise ConfigError(f"--voxel-size, --max-depth: {error}") from None


@dataclass(frozen=True)
class MappedRun:
    """The parts of a run that a dense map needs.

    Attributes:
        dataset: recording of the run.
        calibration: calibration that the run has estimated.
        odometry: trajectory within a submap.
        corrected: corrected trajectory, (F, 4, 4), metres, which moves the submaps.
        key_frames: rule for the choice of key frames.
        has_depth: whether the depth is that of a depth camera.
    """

    dataset: Dataset
    calibration: Calibration
    odometry: OdometryTrajectory
    corrected: Array
    key_frames: KeyFrameConfig
    has_depth: bool

    @property
    def states(self) -> dict[str, Array]:
        """Trajectories before and after correction, (F, 4, 4), metres."""
        return {"before": self.odometry.T_world_camera, "after": self.corrected}


def read_run(run: Path, source: Path | None = None) -> MappedRun:
    """Read the files of a run and open its recording, which may have moved to `source`.

    Raises:
        DataError: a file is missing or damaged, or files do not belong to one run.
    """
    metrics = read_metrics(run / "metrics.json")
    config = read_config(run / "config.toml")
    calibration, dataset = read_calibration(run / "calibration.toml"), _open_recording(run, metrics, source)
    (times, odometry), (_, corrected) = (read_tum(run / f"trajectory_{name}.tum") for name in ("odometry", "corrected"))
    differs = {
        "depth camera" if config.depth else "right camera": not (
            dataset.has_depth if config.depth else dataset.has_right
        ),
        "camera": dataset.camera != calibration.camera,
        "times": not _has_times(dataset, times),
        "first image": not is_same_image(metrics.get("first_image"), dataset.read_left(0)),
    }
    if any(differs.values()):
        names = " and ".join(name for name in differs if differs[name])
        raise DataError(
            f"{source or metrics.get('source')}: expected the drive that {run} was made of, found another: not the same"
            f" {names}; name its recording: revisit dense {run} SOURCE"
        )
    predicted = read_frames(run / "frames.csv").predicted
    if not len(odometry) == len(corrected) == len(predicted) <= len(dataset):
        raise DataError(
            f"{run}: expected one pose in both trajectories for each line of frames.csv, and an image for each, found"
            f" {len(odometry)}, {len(corrected)}, {len(predicted)} and {len(dataset)}; run again"
        )
    trajectory = OdometryTrajectory(odometry, predicted)
    return MappedRun(dataset, calibration, trajectory, corrected, config.key_frames_for_camera(), config.depth)


def _open_recording(run: Path, metrics: Mapping[str, object], source: Path | None) -> Dataset:
    try:
        recording = DatasetSpec.from_metrics(metrics["recording"])  # type: ignore[arg-type]
    except (KeyError, TypeError):
        raise DataError(
            f"{run / 'metrics.json'}: expected the recording that was read, found none; make the run again"
        ) from None
    if source is None and not recording.path.exists():
        raise DataError(
            f"{recording.path}: expected the recording of {run}, found nothing; if it was moved, name its place: "
            f"revisit dense {run} SOURCE"
        )
    return open_dataset(recording if source is None else replace(recording, path=source))


def _has_times(dataset: Dataset, times: Array) -> bool:
    """Whether the first frames of a dataset have these times; images that are missing are another error."""
    common = min(len(times), len(dataset))
    return np.allclose(dataset.timestamps[:common], times[:common], rtol=0, atol=_SAME_TIME_S)


def build_dense_map(options: DenseOptions, messages: Console) -> str:
    """Fuse the depth of a run, write maps, grid, page and recording into its folder, and return a summary line.

    Raises:
        ConfigError: a number is not positive and finite.
        DataError: the run or its recording cannot be read.
        OutputError: a dense map exists and is not to be replaced, or the results cannot be written.
    """
    run = options.run
    options.config(has_depth=False)  # a number that cannot work is refused before anything is read
    present = [name for name in RESULTS if (run / name).exists()]
    if present and not options.overwrite:
        raise OutputError(f"{run / present[0]}: there is a dense map already; give --overwrite to replace it")
    mapped = read_run(run, options.source)
    config = options.config(mapped.has_depth)
    groups = group_key_frames(mapped.odometry, mapped.key_frames, config.submap_frames)
    total = sum(map(len, groups))
    with _folder_in(run) as folder:
        store, mapper = SubmapStore(folder), DenseMapper(mapped.calibration, config, mapped.has_depth)
        with progress_bar(messages, "Fusing") as progress:
            for done in mapper.fuse(mapped.dataset, mapped.odometry, groups, store):
                progress(done, total)
        seen = _look_from_above(store, mapped)
        _write(run, store, mapped, seen.grid)
        _write_page(run / DENSE_PAGE, store, seen, config.fusion)
        _record(run, store, mapped, messages)
    written = [name for name in RESULTS if (run / name).exists()]
    return f"{run}: {total} key frames in {len(store)} submaps; see {', '.join(written)}"


@contextmanager
def _folder_in(run: Path) -> Iterator[Path]:
    """Lock the run and make a temporary folder for submaps on its disk: /tmp may be in memory."""
    with FolderLock.acquire(run):
        try:
            folder = tempfile.TemporaryDirectory(prefix=STAGING, dir=run)
        except OSError as error:
            raise OutputError(f"{run}: cannot be written, {error.strerror}; copy the run to another folder") from error
        with folder as name:
            yield Path(name)


def _write(run: Path, store: SubmapStore, mapped: MappedRun, grid: OccupancyGrid) -> None:
    for state, poses in mapped.states.items():
        surfaces = partial(store.surfaces_in_world, poses)
        write_mesh(run / f"dense_{state}.ply", surfaces, with_triangles=False)
        write_mesh(run / f"mesh_{state}.ply", surfaces, with_triangles=True)
    write_occupancy_grid(run / "occupancy.yaml", grid)


@dataclass(frozen=True)
class _SeenFromAbove:
    """How a map is drawn from above.

    Attributes:
        states: trajectories before and after correction, (F, 4, 4), metres, in a level frame.
        grid: occupancy grid of the corrected map.
        max_height_m: height above which nothing is drawn.
    """

    states: dict[str, Array]
    grid: OccupancyGrid
    max_height_m: float


def _look_from_above(store: SubmapStore, mapped: MappedRun) -> _SeenFromAbove:
    """Say how a map is drawn: a street as its first camera saw it, a room by its floor and without its ceiling."""
    if not mapped.has_depth:
        return _SeenFromAbove(mapped.states, build_occupancy_grid(store, mapped.corrected), np.inf)
    floor = find_floor(store, mapped.corrected)
    states = {state: floor.T_level_world @ poses for state, poses in mapped.states.items()}
    highest = float(max(-poses[:, 1, 3].min() for poses in states.values()))
    return _SeenFromAbove(states, build_floor_grid(store, states["after"], floor), highest + _ABOVE_CAMERA_M)


def _write_page(page: Path, store: SubmapStore, seen: _SeenFromAbove, config: FusionConfig) -> None:
    positions = np.concatenate([poses[:, :3, 3] for poses in seen.states.values()])
    window = PlaneWindow.around(positions, config.max_depth_m, _PIXEL_VOXELS * config.voxel_m)
    maps = [
        DenseOverview(
            state, render_birds_eye_view(store.surfaces_in_world(poses), window, seen.max_height_m), poses[:, :3, 3]
        )
        for state, poses in seen.states.items()
    ]
    write_dense_page(page, maps, window, seen.grid)


def _record(run: Path, store: SubmapStore, mapped: MappedRun, messages: Console) -> None:
    """Write the maps as a recording beside the run's own, if it has one; a damaged one costs a line, not the maps."""
    recording = run / RECORDING
    if not recording.exists():
        return
    maps = (PlacedMap(state, store.surfaces_in_world(poses), poses[:, :3, 3]) for state, poses in mapped.states.items())
    try:
        record_dense_map(run / DENSE_RECORDING, recording, mapped.dataset.camera, maps)
    except DataError as error:
        messages.print(f"no {DENSE_RECORDING}: {error}", markup=False, highlight=False, soft_wrap=True)
