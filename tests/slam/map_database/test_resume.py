"""A drive that stops and goes on ends as if nobody had disturbed it."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from place_recognition.evaluation.similarity_matrix import MatrixRecorder
from place_recognition.paradigms.registry import PARADIGMS
from slam.components import build_components
from slam.config import RunConfig, to_toml
from slam.datasets.dataset import Dataset, DatasetSpec, Frame
from slam.datasets.formats.registry import open_dataset
from slam.errors import DataError, OutputError
from slam.frame_record import FrameRecord
from slam.map_database.database import MapDatabase, Session
from slam.map_database.session_writer import MapSessionRecorder, NullSessionRecorder, SessionRecorder
from slam.pose_graph.robust.backends import OptimizationResult
from slam.run_log import RunLog
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
    rows: MatrixRecorder
    log: RunLog
    optimized: OptimizationResult


def drive_on(drive: Every, config: RunConfig, recorder: SessionRecorder, stop: int | None = None) -> End | None:
    """Drive from where the recorder stopped to the end, or stop after so many frames."""
    rows, log = MatrixRecorder(1000), RunLog()
    slam = Slam(build_components(drive.drive.camera, config, rows))
    for index in range(recorder.restore(slam, rows, log), len(drive)):
        result = slam.process(drive[index])
        log.add(result, {})
        recorder.add(result, result.stage_ms)
        if index + 1 == stop:
            recorder.write_checkpoint()
            return None
    recorder.write_checkpoint()
    late, optimized = slam.finish(config.robust)
    log.add_loops(late)
    recorder.finish(late, optimized, ended=True)
    return End(slam, rows, log, optimized)


@contextlib.contextmanager
def kept(path: Path, drive: Every, config: RunConfig) -> Iterator[tuple[MapDatabase, MapSessionRecorder]]:
    session = Session(0, 0, "test", drive.drive.camera, to_toml(config), {"source": "a test"})
    fresh = not path.exists()
    with MapDatabase.create(path) if fresh else MapDatabase.open(path, writable=True) as store:
        if fresh:
            with store.writing():
                store.add_session(session)
        yield store, MapSessionRecorder(store, session, config)


def said(log: RunLog) -> list[tuple[object, ...]]:
    return [(a.belief.query, a.belief.match, a.belief.score, a.belief.accepted, a.reason) for a in log.candidates]


@pytest.mark.parametrize("paradigm", PARADIGMS)
def test_a_session_that_stopped_twice_ends_with_the_same_bits(drive: Every, tmp_path: Path, paradigm: str):
    config = RunConfig(paradigm=paradigm)
    whole = drive_on(drive, config, NullSessionRecorder())
    for stop in (45, 110):
        with kept(tmp_path / "map.db", drive, config) as (store, recorder):
            drive_on(drive, config, recorder, stop)
            assert store.images() == stop
    with kept(tmp_path / "map.db", drive, config) as (store, recorder):
        parts = drive_on(drive, config, recorder)
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


def test_a_resumed_run_with_one_camera_gives_the_same_bits(circle_drive: Path, tmp_path: Path):
    drive, config = Every(open_dataset(DatasetSpec(circle_drive)), 1), RunConfig(mono=True)
    first = Every(replace_length(drive.drive, 70), 1)
    whole = drive_on(first, config, NullSessionRecorder())
    with kept(tmp_path / "map.db", drive, config) as (_, recorder):
        drive_on(first, config, recorder, 40)
    with kept(tmp_path / "map.db", drive, config) as (_, recorder):
        parts = drive_on(first, config, recorder)
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


def test_every_frame_is_restored(drive: Every, tmp_path: Path):
    config, seen = RunConfig(), []

    class Spy(MapSessionRecorder):
        def write_checkpoint(self) -> None:
            seen.extend(self._waiting)
            super().write_checkpoint()

    with kept(tmp_path / "map.db", drive, config) as (store, _):
        drive_on(drive, config, Spy(store, store.sessions()[0], config), 30)
        back = list(store.frames())
    assert len(back) == len(seen) == 30
    for one, other in zip(back, seen, strict=True):
        assert_same(one, other)


def assert_same(one: FrameRecord, other: FrameRecord) -> None:
    assert (one.image, one.timestamp, one.is_key_frame, one.motion.reason) == (
        other.image, other.timestamp, other.is_key_frame, other.motion.reason,
    )  # fmt: skip
    for name in ("pixels", "points", "grey", "descriptors"):
        np.testing.assert_array_equal(getattr(one.landmarks, name), getattr(other.landmarks, name))
    np.testing.assert_array_equal(one.motion.covariance, other.motion.covariance)
    np.testing.assert_array_equal(one.T_world_online, other.T_world_online)
    assert one.motion.inliers.sum() == other.motion.inliers.sum()
    assert len(one.motion.inliers) == len(other.motion.inliers)


def test_a_transaction_that_fails_leaves_nothing(drive: Every, tmp_path: Path):
    config = RunConfig()
    with kept(tmp_path / "map.db", drive, config) as (store, recorder):
        drive_on(drive, config, recorder, 20)
        answers = store.count("loop")
        with contextlib.suppress(RuntimeError), store.writing():
            store.delete_loops_from(0)
            assert store.count("loop") == 0
            raise RuntimeError
        assert store.count("loop") == answers > 0
        with pytest.raises(OutputError, match="cannot be written"), store.writing():
            store.add_frame(next(store.frames()), 0)  # there is one of this number
        assert store.images() == 20


@pytest.mark.parametrize(("table", "column"), [("frame", "reason"), ("session", "camera"), ("landmark", "grey")])
def test_a_missing_column_is_reported_in_one_line(drive: Every, tmp_path: Path, table: str, column: str):
    config, path = RunConfig(paradigm="global-descriptor"), tmp_path / "map.db"
    with kept(path, drive, config) as (store, recorder):
        drive_on(drive, config, recorder, 3)
        store._connection.execute(f"ALTER TABLE {table} RENAME COLUMN {column} TO damaged")
    fault = "expected a map database, found a damaged one"
    with MapDatabase.open(path) as store, pytest.raises(DataError, match=fault):
        _ = store.sessions(), list(store.frames())


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ("UPDATE checkpoint SET structure = replace(structure, 'history', 'other')", "the structure of the checkpoint"),
        ("UPDATE chunk SET bytes = zeroblob(length(bytes))", "a chunk of the checkpoint"),
        ("DELETE FROM checkpoint_array WHERE number = 0", "IndexError"),
    ],
)
def test_a_damaged_checkpoint_is_refused_in_one_line(drive: Every, tmp_path: Path, change: str, found: str):
    config, path = RunConfig(paradigm="global-descriptor"), tmp_path / "map.db"
    with kept(path, drive, config) as (store, recorder):
        drive_on(drive, config, recorder, 3)
        with store.writing():
            store._connection.execute(change)
    with kept(path, drive, config) as (_, recorder), pytest.raises(DataError, match=found) as error:
        drive_on(drive, config, recorder)
    assert "\n" not in str(error.value)


def test_the_state_of_another_recogniser_is_refused_in_one_line(drive: Every, tmp_path: Path):
    path = tmp_path / "map.db"
    with kept(path, drive, RunConfig(paradigm="global-descriptor")) as (_, recorder):
        drive_on(drive, RunConfig(paradigm="global-descriptor"), recorder, 3)
    other = RunConfig(paradigm="pixel-sequences")
    with kept(path, drive, other) as (_, recorder), pytest.raises(DataError, match=r"thumbnails|similarity") as error:
        drive_on(drive, other, recorder)
    assert "\n" not in str(error.value)
