"""Continuing from a map database: a run that stopped is resumed, or a new session is added to a prior map.

Finds the run or the map, checks that dataset and settings fit it, and restores the system from its records and its
checkpoint; no other module restores a system.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from place_recognition.evaluation.similarity_matrix import MatrixRecorder
from slam.config import RunConfig, parse_config
from slam.datasets.dataset import Dataset, is_same_image
from slam.errors import ConfigError, DataError, OutputError
from slam.frame_record import LoopRecord
from slam.io.run_folder import STAGING, RunFolder, unfinished
from slam.map_database.database import MAP_FILE, MapDatabase, Session, map_file
from slam.map_database.inter_session_loops import SessionStart, frame_in_session, loop_in_session
from slam.run_log import RunLog
from slam.system import Components, Slam

# Path length between two sessions: more than any rule asks for between an image and its match.
_SESSION_GAP_M = 1000.0


@dataclass(frozen=True)
class ResumableRun:
    """A run that stopped and can be resumed.

    Attributes:
        map_file: path of its map database.
        session: the session that stopped.
        frames: number of frames that have been processed.
    """

    map_file: Path
    session: Session
    frames: int

    @property
    def run_id(self) -> str:
        """Globally unique id (UUID) of the run."""
        return str(self.session.provenance.get("run"))

    @property
    def config(self) -> RunConfig:
        """The settings it was made with."""
        return parse_config(self.session.config, f"{self.map_file}: settings")


def find_resumable_run(out: Path) -> ResumableRun | None:
    """The unfinished run into a folder with the most processed frames; None where there is none.

    Raises:
        DataError: a map database in the folder is damaged.
    """
    files = [folder / MAP_FILE for folder in (*unfinished(out), out) if (folder / MAP_FILE).is_file()]
    runs = [stopped for stopped in map(_resumable_run, files) if stopped is not None]
    return max(runs, key=lambda run: run.frames, default=None)


def is_complete(out: Path) -> bool:
    """Whether a folder holds a run that has come to its end."""
    if not (out / "metrics.json").is_file() or not (out / MAP_FILE).is_file():
        return False
    with MapDatabase.open(out / MAP_FILE) as store:
        return all(session.finished for session in store.sessions())


def check_unfinished(out: Path) -> None:
    """Check that no run into the folder can be resumed: a new one would discard its results.

    Raises:
        OutputError: there is such a run.
    """
    stopped = find_resumable_run(out) if unfinished(out) else None
    if stopped is not None:
        raise OutputError(
            f"{out}: expected a new or empty folder, found a run that stopped after {stopped.frames} frames; "
            "continue it with --resume, or start again with --overwrite"
        )


def reopen_run_folder(stopped: ResumableRun, out: Path) -> RunFolder:
    """The folder in which a stopped run is resumed. Earlier results stay until the new ones are complete.

    Raises:
        OutputError: the map cannot be copied.
    """
    if stopped.map_file.parent != out:
        return RunFolder.reopen(out, stopped.map_file.parent)
    folder = RunFolder.create(out, overwrite=True)
    folder.keep()
    _copy(stopped.map_file, folder.path / MAP_FILE)
    return folder


def check_same(stopped: ResumableRun, dataset: Dataset, config: RunConfig) -> None:
    """Check that the settings and the dataset are those of the run that stopped.

    Raises:
        ConfigError: the settings differ.
        DataError: the dataset is another one.
    """
    if config != stopped.config:
        raise ConfigError(
            f"{stopped.map_file}: the run was made with other settings than these; leave them out with --resume, "
            "or start again with --overwrite"
        )
    check_dataset(stopped, dataset)


def check_dataset(stopped: ResumableRun, dataset: Dataset) -> None:
    """Check that a dataset is the one from which a map was made.

    Raises:
        DataError: it is another one.
    """
    with MapDatabase.open(stopped.map_file) as store:
        times = store.timestamps(stopped.session.number)
    source = stopped.session.provenance.get("source")
    same_times = np.array_equal(dataset.timestamps[: stopped.frames], times)  # false, too, where there are fewer
    same_images = same_times and is_same_image(stopped.session.provenance.get("first_image"), dataset.read_left(0))
    if dataset.camera != stopped.session.camera or not same_images:
        raise DataError(
            f"{stopped.map_file}: expected the dataset from which it was made ({source}, {stopped.frames} "
            f"frames so far), found another one; give that dataset, or start again with --overwrite"
        )


def _resumable_run(file: Path) -> ResumableRun | None:
    with MapDatabase.open(file) as store:
        sessions = store.sessions()
        if not sessions:
            return None
        last = sessions[-1]
        complete = last.finished and not file.parent.name.startswith(STAGING)
        return None if complete else ResumableRun(file, last, store.images(last.number))


def _copy(source: Path, target: Path) -> None:
    with MapDatabase.open(source) as store:
        store.copy(target)


@dataclass(frozen=True)
class PriorMap:
    """A map of earlier sessions.

    Attributes:
        map_file: path of the map database.
        last: the session that was added last.
    """

    map_file: Path
    last: Session

    @property
    def config(self) -> RunConfig:
        """The settings it was made with; a recogniser that continues needs the same."""
        return parse_config(self.last.config, f"{self.map_file}: settings")


def read_prior_map(path: Path) -> PriorMap:
    """The map in a file, or in a run's folder.

    Raises:
        DataError: there is no map, it is damaged, or its last session has not ended.
    """
    file = map_file(path)
    with MapDatabase.open(file) as store:
        sessions = store.sessions()
    if not sessions or not sessions[-1].finished:
        raise DataError(
            f"{file}: expected a map whose last session has ended, found one that stopped; --resume its run first"
        )
    return PriorMap(file, sessions[-1])


def check_fits(prior: PriorMap, dataset: Dataset, config: RunConfig) -> None:
    """Check that a dataset can be added to a map.

    Raises:
        DataError: the camera is another one.
        ConfigError: recogniser or features differ, there is one camera only, or no map is written.
    """
    file, made = prior.map_file, prior.config
    if dataset.camera != prior.last.camera:
        raise DataError(f"{file}: expected sessions of one camera, {prior.last.camera}, found {dataset.camera}")
    if config.mono or made.mono:
        raise ConfigError("--map: expected a stereo pair: sessions of one camera have no common unit of length")
    if (config.paradigm, config.place_recognition) != (made.paradigm, made.place_recognition):
        raise ConfigError(
            f"--map: expected the recogniser that made {file}, {made.paradigm}, with its settings, found others; "
            "leave those options out"
        )
    if not config.save_map:
        raise ConfigError("--no-map: a session that is added to a map is saved in one; leave this option out")


@dataclass(frozen=True)
class RestoredSession:
    """Size of a session that has been restored.

    Attributes:
        num_frames: number of frames of the session that have been processed.
        num_loops: number of loop records of the map, of all sessions, that stay.
    """

    num_frames: int
    num_loops: int


def restore_session(
    store: MapDatabase, session: Session, slam: Slam, matrix: MatrixRecorder, run_log: RunLog
) -> RestoredSession:
    """Restore a new system, its similarity matrix and its log to where a session stopped.

    Pose graph, landmarks and log are rebuilt from the records of the frames; odometry, recogniser and key frames
    continue from the checkpoint. A session without a frame takes over the recogniser of the session before it.

    Raises:
        DataError: the map is damaged, or its checkpoint is of another configuration.
    """
    first = session.first_image
    num_loops = store.num_loops_before(first)
    replay = LoopReplay(store.loops(first))
    for frame in store.frames():
        record = frame_in_session(frame, first)
        if record.image < 0:  # of an earlier session: matches with it are verified by its landmarks
            slam.components.loop_closer.add_frame(record.image, record.landmarks)
            continue
        loops = replay.take(frame.image)
        num_loops += len(loops)
        run_log.restore_frame(record, slam.restore_frame(record, (loop_in_session(loop, first) for loop in loops)))
    return RestoredSession(_restore_checkpoint(store, session, slam.components, matrix), num_loops)


def system_state(components: Components, matrix: MatrixRecorder) -> dict[str, Any]:
    """State of what changes with each image and cannot be rebuilt from frame records, for a checkpoint."""
    return {
        "odometry": components.odometry.state(),
        "masks": components.masks.state(),
        "recognizer": components.recognizer.state(),
        "key_frames": components.key_frames.state(),
        "similarity_matrix": matrix.state(),
    }


def session_start(store: MapDatabase, session: Session) -> SessionStart:
    """Start of a session behind the earlier ones of its map."""
    before = store.steps()[: session.first_image]
    distance_m = sum(float(np.linalg.norm(T[:3, 3])) for T, _ in before)
    return SessionStart(session.first_image, distance_m + _SESSION_GAP_M * session.number)


def _restore_checkpoint(store: MapDatabase, session: Session, components: Components, matrix: MatrixRecorder) -> int:
    """Restore the state of the session, or the recogniser of the session before it; number of frames processed."""
    own = store.checkpoint(session.number)
    if own is not None:
        with store.reading():
            components.odometry.restore(own.state["odometry"])
            components.masks.restore(own.state["masks"])
            components.recognizer.restore(own.state["recognizer"])
            components.key_frames.restore(own.state["key_frames"])
            matrix.restore(own.state["similarity_matrix"])
        return own.frames
    earlier = store.checkpoint(session.number - 1)
    if earlier is not None:
        with store.reading():
            components.recognizer.restore(earlier.state["recognizer"])
        matrix.restart(session.first_image)
    return 0


class LoopReplay:
    """Loop records in their order, dealt out by the images with which they came."""

    def __init__(self, records: Iterator[LoopRecord]) -> None:
        self._waiting = deque(records)

    def take(self, image: int) -> list[LoopRecord]:
        """The records that came with an image; call with one image after the other."""
        taken: list[LoopRecord] = []
        while self._waiting and self._waiting[0].at_image == image:
            taken.append(self._waiting.popleft())
        return taken
