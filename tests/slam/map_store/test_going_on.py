"""A drive that stops and goes on ends as if nobody had disturbed it."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from place_recognition.evaluation.matrix import MatrixRows
from place_recognition.paradigms.catalogue import PARADIGMS
from slam.config import RunConfig, to_toml
from slam.datasets.dataset import Dataset, Frame
from slam.datasets.open import open_dataset
from slam.datasets.source import DatasetSpec
from slam.drive_log import DriveLog
from slam.errors import DataError, OutputError
from slam.map_store.keeping import Keeper, MapKeeper, NullKeeper
from slam.map_store.rows import StoredFrame
from slam.map_store.store import MapStore, Session
from slam.parts import build_parts
from slam.robust import Optimized
from slam.system import Slam


@dataclass(frozen=True)
class Every:
    """Every so many-th frame of a drive: enough for places to be seen twice, in less time."""

    drive: Dataset
    step: int

    def __len__(self) -> int:
        return len(self.drive) // self.step

    def __getitem__(self, index: int) -> Frame:
        return replace(self.drive[self.step * index], index=index)


@pytest.fixture(scope="module")
def drive(circle_drive: Path) -> Every:
    return Every(open_dataset(DatasetSpec(circle_drive)), 2)


@dataclass(frozen=True)
class End:
    slam: Slam
    rows: MatrixRows
    log: DriveLog
    optimized: Optimized


def drive_on(drive: Every, config: RunConfig, keeper: Keeper, stop: int | None = None) -> End | None:
    """Drive from where the keeper stopped to the end, or stop after so many frames."""
    rows, log = MatrixRows(1000), DriveLog()
    slam = Slam(build_parts(drive.drive.camera, config, rows))
    for index in range(keeper.recall(slam, rows, log), len(drive)):
        processed = slam.process(drive[index])
        log.add(processed, {})
        keeper.add(processed, processed.stage_ms)
        if index + 1 == stop:
            keeper.pause()
            return None
    keeper.pause()
    late, optimized = slam.finish(config.robust)
    log.conclude(late)
    keeper.finish(late, optimized, ended=True)
    return End(slam, rows, log, optimized)


@contextlib.contextmanager
def kept(path: Path, drive: Every, config: RunConfig) -> Iterator[tuple[MapStore, MapKeeper]]:
    session = Session(0, 0, "test", drive.drive.camera, to_toml(config), {"source": "a test"})
    fresh = not path.exists()
    with MapStore.create(path) if fresh else MapStore.open(path, writable=True) as store:
        if fresh:
            with store.writing():
                store.add_session(session)
        yield store, MapKeeper(store, session, config)


def said(log: DriveLog) -> list[tuple[object, ...]]:
    return [(a.belief.query, a.belief.match, a.belief.score, a.belief.accepted, a.reason) for a in log.attempts]


@pytest.mark.parametrize("paradigm", PARADIGMS)
def test_a_drive_that_stopped_twice_ends_with_the_same_bits(drive: Every, tmp_path: Path, paradigm: str):
    config = RunConfig(paradigm=paradigm)
    whole = drive_on(drive, config, NullKeeper())
    for stop in (45, 110):
        with kept(tmp_path / "map.db", drive, config) as (store, keeper):
            drive_on(drive, config, keeper, stop)
            assert store.images() == stop
    with kept(tmp_path / "map.db", drive, config) as (store, keeper):
        parts = drive_on(drive, config, keeper)
        np.testing.assert_array_equal(store.poses(), parts.optimized.poses)
        assert store.sessions()[0].finished
    assert len(whole.optimized.kept) > 10  # there was something to lose
    assert said(parts.log) == said(whole.log)
    np.testing.assert_array_equal(parts.log.odometry, whole.log.odometry)
    np.testing.assert_array_equal(parts.log.online, whole.log.online)
    np.testing.assert_array_equal(parts.optimized.poses, whole.optimized.poses)
    for stage in whole.rows.stages:
        np.testing.assert_array_equal(
            parts.rows.matrix(len(drive), stage).values, whole.rows.matrix(len(drive), stage).values
        )


def test_one_camera_goes_on_with_the_same_bits(circle_drive: Path, tmp_path: Path):
    drive, config = Every(open_dataset(DatasetSpec(circle_drive)), 1), RunConfig(mono=True)
    first = Every(replace_length(drive.drive, 70), 1)
    whole = drive_on(first, config, NullKeeper())
    with kept(tmp_path / "map.db", drive, config) as (_, keeper):
        drive_on(first, config, keeper, 40)
    with kept(tmp_path / "map.db", drive, config) as (_, keeper):
        parts = drive_on(first, config, keeper)
    np.testing.assert_array_equal(parts.log.odometry, whole.log.odometry)
    assert np.linalg.norm(whole.log.odometry[-1][:3, 3]) > 1.0


def replace_length(drive: Dataset, frames: int) -> Dataset:
    class Shorter:
        camera = drive.camera

        def __len__(self) -> int:
            return frames

        def __getitem__(self, index: int) -> Frame:
            return drive[index]

    return Shorter()  # type: ignore[return-value]


def test_every_frame_comes_back_as_it_was(drive: Every, tmp_path: Path):
    config, seen = RunConfig(), []

    class Spy(MapKeeper):
        def pause(self) -> None:
            seen.extend(self._waiting)
            super().pause()

    with kept(tmp_path / "map.db", drive, config) as (store, _):
        drive_on(drive, config, Spy(store, store.sessions()[0], config), 30)
        back = list(store.frames())
    assert len(back) == len(seen) == 30
    for one, other in zip(back, seen, strict=True):
        assert_same(one, other)


def assert_same(one: StoredFrame, other: StoredFrame) -> None:
    assert (one.image, one.timestamp, one.key_frame, one.motion.reason) == (
        other.image, other.timestamp, other.key_frame, other.motion.reason,
    )  # fmt: skip
    for name in ("pixels", "points", "grey", "descriptors"):
        np.testing.assert_array_equal(getattr(one.landmarks, name), getattr(other.landmarks, name))
    np.testing.assert_array_equal(one.motion.covariance, other.motion.covariance)
    np.testing.assert_array_equal(one.T_world_online, other.T_world_online)
    assert one.motion.inliers.sum() == other.motion.inliers.sum()
    assert len(one.motion.inliers) == len(other.motion.inliers)


def test_a_transaction_that_fails_leaves_nothing(drive: Every, tmp_path: Path):
    config = RunConfig()
    with kept(tmp_path / "map.db", drive, config) as (store, keeper):
        drive_on(drive, config, keeper, 20)
        answers = store.count("attempt")
        with contextlib.suppress(RuntimeError), store.writing():
            store.forget_answers(0)
            assert store.count("attempt") == 0
            raise RuntimeError
        assert store.count("attempt") == answers > 0
        with pytest.raises(OutputError, match="cannot be written"), store.writing():
            store.add_frame(next(store.frames()), 0)  # there is one of this number
        assert store.images() == 20


def test_a_damaged_piece_is_told_in_one_line(drive: Every, tmp_path: Path):
    config, path = RunConfig(paradigm="global-descriptor"), tmp_path / "map.db"
    with kept(path, drive, config) as (store, keeper):
        drive_on(drive, config, keeper, 20)
        with store.writing():
            store._connection.execute("UPDATE piece SET bytes = zeroblob(length(bytes))")
    with kept(path, drive, config) as (_, keeper), pytest.raises(DataError, match="a piece of the checkpoint") as told:
        drive_on(drive, config, keeper)
    assert str(path) in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(("table", "column"), [("frame", "reason"), ("session", "camera"), ("landmark", "grey")])
def test_a_column_of_another_name_is_told_in_one_line(drive: Every, tmp_path: Path, table: str, column: str):
    config, path = RunConfig(paradigm="global-descriptor"), tmp_path / "map.db"
    with kept(path, drive, config) as (store, keeper):
        drive_on(drive, config, keeper, 3)
        store._connection.execute(f"ALTER TABLE {table} RENAME COLUMN {column} TO damaged")
    with MapStore.open(path) as store, pytest.raises(DataError, match="expected a map store, found a damaged one"):
        _ = store.sessions(), list(store.frames())
