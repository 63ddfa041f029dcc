"""`revisit dense`: the dense map of a run, before and after correction, and what of it can be driven on."""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from odometry.calibration import Calibration
from slam.config import read_config
from slam.datasets.dataset import Dataset
from slam.datasets.open import open_dataset
from slam.datasets.source import DatasetSpec
from slam.errors import ConfigError, DataError, OutputError
from slam.keyframes import KeyFrameConfig
from slam.mapping.dense_map import DenseMapConfig, DenseMapper, Odometry, choose_frames
from slam.mapping.fusion import FusionConfig
from slam.mapping.occupancy import Grid, draw_grid, write_grid
from slam.mapping.submaps import SubmapStore
from slam.mapping.surface_file import write_surfaces
from slam.mapping.top_view import Window, seen_from_above
from slam.progress import progress_bar
from slam.report.dense_section import Overview, show_dense_map
from slam.storage.calibration import read_calibration
from slam.storage.metrics import read_metrics
from slam.storage.run_folder import STAGING
from slam.storage.tables import read_frames
from slam.storage.trajectory import read_tum
from slam.viewer.dense_recording import PlacedMap, record_dense_map

Array = NDArray[np.float64]

REPORT, RECORDING = "report.html", "recording.rrd"
_PICTURE_CELL = 4 / 3  # of a voxel: points that far apart leave no gaps in a picture
RESULTS = (
    "dense_before.ply", "dense_after.ply", "mesh_before.ply", "mesh_after.ply", "occupancy.png", "occupancy.yaml",
    "dense.rrd",
)  # fmt: skip


@dataclass(frozen=True)
class DenseOptions:
    """What to map.

    Attributes:
        run: folder of a run, where the results go.
        source: its recording, where that has moved; None where it has not.
        voxel_m: distance between points, metres.
        max_depth_m: what is farther from the camera is left out, metres.
        overwrite: replace a dense map that is there.
    """

    run: Path
    source: Path | None = None
    voxel_m: float = FusionConfig.voxel_m
    max_depth_m: float = FusionConfig.max_depth_m
    overwrite: bool = False

    @property
    def config(self) -> DenseMapConfig:
        """As the fusion takes it.

        Raises:
            ConfigError: a number that cannot work.
        """
        try:
            return DenseMapConfig(fusion=FusionConfig(voxel_m=self.voxel_m, max_depth_m=self.max_depth_m))
        except ValueError as error:
            raise ConfigError(f"--voxel, --depth: {error}") from None


@dataclass(frozen=True)
class DrivenRun:
    """What a dense map needs of a run.

    Attributes:
        drive: the recording.
        calibration: as the run has learned it.
        odometry: the trajectory by which depth is fused.
        corrected: (F, 4, 4) metres, the trajectory that moves the submaps.
        key_frames: what chooses them.
    """

    drive: Dataset
    calibration: Calibration
    odometry: Odometry
    corrected: Array
    key_frames: KeyFrameConfig

    @property
    def states(self) -> dict[str, Array]:
        """Trajectories (F, 4, 4), metres, before and after correction."""
        return {"before": self.odometry.T_world_camera, "after": self.corrected}


def read_run(run: Path, source: Path | None = None) -> DrivenRun:
    """Read what a run has left, and open its recording, which may have moved to `source`.

    Raises:
        DataError: something is missing or damaged, or does not belong together.
    """
    calibration, recording = read_calibration(run / "calibration.toml"), _recording(run, source)
    drive = open_dataset(recording)
    if not drive.has_right or drive.camera != calibration.camera:
        raise DataError(
            f"{recording.path}: expected the pair that {run} was made with, found another camera; name its recording"
        )
    odometry, corrected = (read_tum(run / f"trajectory_{name}.tum")[1] for name in ("odometry", "corrected"))
    predicted = read_frames(run / "frames.csv").predicted
    if not len(odometry) == len(corrected) == len(predicted) <= len(drive):
        raise DataError(
            f"{run}: expected one pose in both trajectories for each line of frames.csv, and an image for each, found"
            f" {len(odometry)}, {len(corrected)}, {len(predicted)} and {len(drive)}; run again"
        )
    key_frames = read_config(run / "config.toml").key_frames
    return DrivenRun(drive, calibration, Odometry(odometry, predicted), corrected, key_frames)


def _recording(run: Path, source: Path | None) -> DatasetSpec:
    metrics = read_metrics(run / "metrics.json")
    try:
        recording = DatasetSpec.from_metrics(metrics["recording"])  # type: ignore[arg-type]
    except (KeyError, TypeError):
        raise DataError(
            f"{run / 'metrics.json'}: expected the recording that was read, found none; make the run again"
        ) from None
    return recording if source is None else replace(recording, path=source)


def map_densely(options: DenseOptions, messages: Console) -> str:
    """Fuse the drive of a run and write both maps and the grid into its folder; says what was done.

    Raises:
        ConfigError: a number that cannot work.
        DataError: the run or its recording cannot be read.
        OutputError: a dense map is there already and is not to be replaced, or it cannot be written.
    """
    run, config = options.run, options.config
    present = [name for name in RESULTS if (run / name).exists()]
    if present and not options.overwrite:
        raise OutputError(f"{run / present[0]}: there is a dense map already; give --overwrite to replace it")
    driven = read_run(run, options.source)
    groups = choose_frames(driven.odometry, driven.key_frames, config.submap_frames)
    total = sum(map(len, groups))
    with _folder_in(run) as folder:
        store, mapper = SubmapStore(folder), DenseMapper(driven.calibration, config)
        with progress_bar(messages, "Fusing") as progress:
            for done in mapper.fuse(driven.drive, driven.odometry, groups, store):
                progress(done, total)
        grid = draw_grid(store, driven.corrected)
        _write(run, store, driven, grid)
        _where_there_is(run / REPORT, messages, lambda report: _show(report, store, driven, grid, config.fusion))
        _where_there_is(run / RECORDING, messages, lambda recording: _record(recording, store, driven))
    written = [name for name in (*RESULTS, REPORT) if (run / name).exists()]
    return f"{run}: {total} key frames in {len(store)} submaps; see {', '.join(written)}"


@contextmanager
def _folder_in(run: Path) -> Iterator[Path]:
    """Make a folder for submaps where there is room for their results, not where temporary files eat up memory."""
    try:
        folder = tempfile.TemporaryDirectory(prefix=STAGING, dir=run)
    except OSError as error:
        raise OutputError(f"{run}: cannot be written, {error.strerror}; copy the run to another folder") from error
    with folder as name:
        yield Path(name)


def _write(run: Path, store: SubmapStore, driven: DrivenRun, grid: Grid) -> None:
    for state, poses in driven.states.items():
        surfaces = partial(store.placed, poses)
        write_surfaces(run / f"dense_{state}.ply", surfaces, with_triangles=False)
        write_surfaces(run / f"mesh_{state}.ply", surfaces, with_triangles=True)
    write_grid(run / "occupancy.yaml", grid)


def _where_there_is(path: Path, messages: Console, show: Callable[[Path], None]) -> None:
    """Show the maps in a file of the run, if it has that; where the file is of no use, they are there all the same."""
    if not path.exists():
        return
    try:
        show(path)
    except DataError as error:
        messages.print(f"not shown there: {error}", markup=False, highlight=False, soft_wrap=True)


def _show(report: Path, store: SubmapStore, driven: DrivenRun, grid: Grid, config: FusionConfig) -> None:
    positions = np.concatenate([poses[:, :3, 3] for poses in driven.states.values()])
    window = Window.around(positions, config.max_depth_m, _PICTURE_CELL * config.voxel_m)
    maps = [
        Overview(state, seen_from_above(store.placed(poses), window), poses[:, :3, 3])
        for state, poses in driven.states.items()
    ]
    show_dense_map(report, maps, window, grid)


def _record(recording: Path, store: SubmapStore, driven: DrivenRun) -> None:
    placed = (PlacedMap(state, store.placed(poses), poses[:, :3, 3]) for state, poses in driven.states.items())
    record_dense_map(recording.with_name("dense.rrd"), recording, driven.drive.camera, placed)
