"""Four laps: the map is that of two, every lap has its loops, and all that uses a map goes on working."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from slam.components import build_extractor
from slam.config import RunConfig
from slam.datasets.formats.registry import open_dataset
from slam.keyframes import KeyFrameConfig
from slam.localization.keyframe_map import SavedMap
from slam.localization.localizer import LocalizationResult, Localizer
from slam.map_database.database import MapDatabase
from slam.pipeline.pipeline import RunOptions, run_pipeline
from slam.pipeline.visualization import RunVisualizer
from slam.system import FrameResult

QUIET = Console(quiet=True)
LAP, LAPS = 80, 4  # frames of a lap
SETTINGS = {"save_recording": False}
KEEP_ALL = KeyFrameConfig(max_revisits=1000)
TIMED = {"frames.csv", "report.html", "run.log", "map.db", "metrics.json"}


def drive_of(source: Path, root: Path, frames: list[int]) -> Path:
    """Write a drive of some frames of another one, by links to its images."""
    sequence, target = source / "sequences" / "00", root / "sequences" / "00"
    for camera in ("image_0", "image_1"):
        (target / camera).mkdir(parents=True)
        for k, frame in enumerate(frames):
            (target / camera / f"{k:06d}.png").symlink_to(sequence / camera / f"{frame:06d}.png")
    shutil.copy(sequence / "calib.txt", target)
    (target / "times.txt").write_text("".join(f"{0.2 * k:e}\n" for k in range(len(frames))))
    poses = (source / "poses" / "00.txt").read_text().splitlines()
    (root / "poses").mkdir()
    (root / "poses" / "00.txt").write_text("".join(f"{poses[frame]}\n" for frame in frames))
    return root


@pytest.fixture(scope="module")
def drive(circle_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every second frame of two laps, twice: the camera comes back to where it began after each lap."""
    return drive_of(circle_drive, tmp_path_factory.mktemp("laps") / "drive", [*range(0, 320, 2)] * 2)


def run(source: Path, out: Path, **settings: object) -> Path:
    run_pipeline(RunOptions(source=source, out=out), SETTINGS | settings, QUIET, QUIET)
    return out


@pytest.fixture(scope="module")
def thinned(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run(drive, tmp_path_factory.mktemp("thinned") / "run")


@pytest.fixture(scope="module")
def whole(drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run(drive, tmp_path_factory.mktemp("whole") / "run", key_frames=KEEP_ALL)


def metrics(out: Path) -> dict:
    return json.loads((out / "metrics.json").read_text())


def by_lap(out: Path, sql: str) -> np.ndarray:
    """Sum a number of each image over each lap; the last images, whose answers come at the end, are left out."""
    with MapDatabase.open(out / "map.db") as store:
        rows = store.query(sql)
    sums = np.zeros(LAPS)
    for image, value in ((row[0], row[1]) for row in rows if row[0] < LAPS * LAP - 20):
        sums[image // LAP] += value
    return sums / [LAP, LAP, LAP, LAP - 20]


def test_later_laps_add_no_key_frames_and_few_landmarks(thinned: Path, whole: Path) -> None:
    key_frames = "SELECT image, key_frame FROM frame"
    assert by_lap(whole, key_frames).min() > 0.95
    assert by_lap(thinned, key_frames)[0] > 0.95
    assert by_lap(thinned, key_frames)[2:].max() < 0.2
    landmarks = "SELECT image, length(descriptors) FROM landmark"
    assert by_lap(thinned, landmarks)[0] == by_lap(whole, landmarks)[0]
    assert by_lap(thinned, landmarks)[2:].max() < 0.6 * by_lap(whole, landmarks)[2:].min()


def test_later_laps_add_hardly_anything_to_checkpoint_and_memory(thinned: Path, whole: Path) -> None:
    def chunk_bytes(out: Path) -> int:
        with MapDatabase.open(out / "map.db") as store:
            return store.query("SELECT sum(length(bytes)) FROM chunk")[0][0]

    assert chunk_bytes(thinned) < 0.7 * chunk_bytes(whole)
    for part in ("landmarks", "map"):
        assert metrics(thinned)["memory_mb"][part] < 0.7 * metrics(whole)["memory_mb"][part]
    assert (thinned / "map_after.ply").stat().st_size < 0.7 * (whole / "map_after.ply").stat().st_size


def test_every_lap_has_its_loops_and_the_trajectory_is_as_good(thinned: Path, whole: Path) -> None:
    loops, expected = metrics(thinned)["loops"], metrics(whole)["loops"]
    assert loops["kept"] >= 0.97 * expected["kept"]
    assert loops["false"] == expected["false"] == 0
    assert metrics(thinned)["corrected"]["ate_m"] < 1.1 * metrics(whole)["corrected"]["ate_m"] + 0.01


def interrupting(index: int) -> Callable[[RunVisualizer, FrameResult], object]:
    show = RunVisualizer.show

    def interrupt(self: RunVisualizer, processed: FrameResult) -> object:
        if processed.frame.index == index:
            raise KeyboardInterrupt
        return show(self, processed)

    return interrupt


@pytest.mark.parametrize("index", [231, 310])
def test_a_run_that_was_killed_in_a_known_place_ends_with_the_same_bits(
    drive: Path, thinned: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, index: int
) -> None:
    out = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(RunVisualizer, "show", interrupting(index))
        with pytest.raises(KeyboardInterrupt):
            run(drive, out)
    run_pipeline(RunOptions(source=drive, out=out, resume=True), SETTINGS, QUIET, QUIET)
    files = {path.name for path in thinned.iterdir()} - TIMED
    assert {path.name for path in out.iterdir()} - TIMED == files
    for name in files:
        assert (out / name).read_bytes() == (thinned / name).read_bytes(), name
    for table in ("landmark", "loop", "checkpoint_array"):
        rows = []
        for folder in (out, thinned):
            with MapDatabase.open(folder / "map.db") as store:
                rows.append([tuple(row) for row in store.query(f"SELECT * FROM {table}")])
        assert rows[0] == rows[1], table


def test_the_loops_of_every_lap_are_found_again_without_odometry(drive: Path, thinned: Path, tmp_path: Path) -> None:
    again = tmp_path / "again"
    run_pipeline(RunOptions(source=drive, out=again, reuse_map=thinned), SETTINGS, QUIET, QUIET)
    assert metrics(again)["loops"]["kept"] >= 0.95 * metrics(thinned)["loops"]["kept"]
    assert metrics(again)["loops"]["false"] == 0


def test_a_later_drive_joins_the_map(circle_drive: Path, thinned: Path, tmp_path: Path) -> None:
    later = drive_of(circle_drive, tmp_path / "later", list(range(41, 161, 2)))
    out = tmp_path / "run"
    run_pipeline(RunOptions(source=later, out=out, map_file=thinned), SETTINGS, QUIET, QUIET)
    assert metrics(out)["map"]["joined"]
    assert metrics(out)["map"]["kept"] > 40


def test_images_of_any_lap_are_located(circle_drive: Path, thinned: Path) -> None:
    images = open_dataset(circle_drive)
    with MapDatabase.open(thinned / "map.db") as store:
        saved = SavedMap.open(store)
        localizer = Localizer(saved, build_extractor(RunConfig().place_recognition))
        found = [localizer.locate(images[k].left) for k in range(5, 320, 35)]
    assert sum(isinstance(result, LocalizationResult) for result in found) == len(found)
