"""Records a session in a map database while it runs."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Protocol

from odometry.camera import StereoCamera
from place_recognition.evaluation.similarity_matrix import MatrixRecorder
from slam.config import RunConfig, to_toml
from slam.errors import RevisitError
from slam.frame_record import FrameRecord, LoopRecord
from slam.io.files import replacing
from slam.io.run_folder import RunFolder
from slam.map_database.database import MAP_FILE, Checkpoint, MapDatabase, Session
from slam.map_database.inter_session_loops import SessionRecognizer, components_in_session, loop_in_map
from slam.map_database.resume import restore_session, session_start, system_state
from slam.map_database.session_merging import SessionResult, close_session, merge_session
from slam.pose_graph.robust.backends import OptimizationResult
from slam.run_log import RunLog
from slam.system import Components, FrameResult, LoopCandidate, Slam, redundant_frames

_MIN_CHECKPOINT_FRAMES = 100  # from one checkpoint to the next
# Largest share of the run's time for checkpoints: those of a large map take longer and are written less often.
_MAX_CHECKPOINT_SHARE = 0.04


@dataclass(frozen=True)
class SessionInfo:
    """A new session of a map.

    Attributes:
        name: name of the dataset.
        camera: camera of its left images, with the pair's baseline.
        provenance: source, recording, command, versions, and the id of the run.
        map_file: map of earlier sessions, which stays as it is; None for none.
    """

    name: str
    camera: StereoCamera
    provenance: Mapping[str, object]
    map_file: Path | None = None


class SessionRecorder(Protocol):
    """Records a session: each frame with its loops, and checkpoints from which a run can be resumed.

    Attributes:
        frames: number of frames of the session that have been written.
    """

    frames: int

    def components_in_session(self, components: Components) -> Components:
        """The components for a system that counts the frames of this session only."""
        ...

    def restore(self, slam: Slam, matrix: MatrixRecorder, run_log: RunLog) -> int:
        """Restore a new system to where the session stopped.

        Returns:
            Number of frames of the session that have been processed.
        """
        ...

    def announce_checkpoint(self) -> bool:
        """Whether a checkpoint will follow the next frame: until then no component may process a later frame."""
        ...

    def add(self, result: FrameResult, stage_ms: dict[str, float]) -> None:
        """Record a frame, and the milliseconds of its stages, those outside the system included."""
        ...

    def write_checkpoint(self) -> None:
        """Record everything so far, and the state of the components."""
        ...

    def finish(self, late: Sequence[LoopCandidate], optimized: OptimizationResult, ended: bool) -> SessionResult:
        """Record the last loops and the corrected poses.

        Args:
            late: candidates that came at the end.
            optimized: trajectory of the session by itself.
            ended: False for a run that was interrupted and may be resumed.
        """
        ...


class NullSessionRecorder:
    """Records nothing (a SessionRecorder)."""

    frames = 0

    def components_in_session(self, components: Components) -> Components:
        """The components themselves."""
        return components

    def restore(self, slam: Slam, matrix: MatrixRecorder, run_log: RunLog) -> int:
        """Start with the first frame."""
        return 0

    def announce_checkpoint(self) -> bool:
        """Never."""
        return False

    def add(self, result: FrameResult, stage_ms: dict[str, float]) -> None:
        """Do nothing."""

    def write_checkpoint(self) -> None:
        """Do nothing."""

    def finish(self, late: Sequence[LoopCandidate], optimized: OptimizationResult, ended: bool) -> SessionResult:
        """The trajectory by itself."""
        return SessionResult(optimized)


class MapSessionRecorder:
    """Records a session in a map database (a SessionRecorder).

    Frames wait in memory until the next checkpoint and are written with it in one transaction.

    Attributes:
        frames: number of frames of the session that have been written.
    """

    def __init__(self, store: MapDatabase, session: Session, config: RunConfig) -> None:
        self.frames = 0
        self._store, self._session, self._config = store, session, config
        self._recognizer: SessionRecognizer | None = None
        self._waiting: list[FrameRecord] = []
        self._loops: list[LoopRecord] = []
        self._redundant: list[int] = []  # images whose record is written and needs no more than a few landmarks
        self._num_loops = 0
        self._is_announced = False
        self._state: Callable[[], object] = dict
        self._last, self._cost = time.perf_counter(), 0.0

    def components_in_session(self, components: Components) -> Components:
        """The components for a system that counts the frames of this session only."""
        components = components_in_session(components, session_start(self._store, self._session))
        if isinstance(components.recognizer, SessionRecognizer):
            self._recognizer = components.recognizer
        return components

    def restore(self, slam: Slam, matrix: MatrixRecorder, run_log: RunLog) -> int:
        """Restore a new system to where the session stopped; the number of frames that have been processed."""
        restored = restore_session(self._store, self._session, slam, matrix, run_log)
        self.frames, self._num_loops = restored.num_frames, restored.num_loops
        self._state = partial(system_state, slam.components, matrix)
        return self.frames

    def announce_checkpoint(self) -> bool:
        """Whether a checkpoint will follow the next frame: until then no component may process a later frame."""
        spent = time.perf_counter() - self._last
        is_late = len(self._waiting) + 1 >= _MIN_CHECKPOINT_FRAMES and _MAX_CHECKPOINT_SHARE * spent >= self._cost
        self._is_announced = is_late
        return is_late

    def add(self, result: FrameResult, stage_ms: dict[str, float]) -> None:
        """Record a frame, and the milliseconds of its stages; then write the checkpoint that was announced."""
        image = self._session.first_image + result.frame.index
        self._waiting.append(_frame_record(result, image, stage_ms))
        self._loops += [self._loop_record(candidate, image) for candidate in result.candidates]
        for query in redundant_frames(result.candidates):
            self._thin(query)
        if self._is_announced:
            self.write_checkpoint()

    def write_checkpoint(self) -> None:
        """Record everything so far, and the state of the components."""
        begin = time.perf_counter()
        with self._store.writing():
            self._store.delete_loops_from(self._num_loops)  # an interrupted run has written late ones, which come again
            for frame in self._waiting:
                self._store.add_frame(frame, self._session.number)
            for image in self._redundant:
                self._store.thin_frame(image, self._config.loop_closing.max_known_landmarks)
            self._write_loops(self._loops)
            num_frames = self.frames + len(self._waiting)
            self._store.set_checkpoint(self._session.number, Checkpoint(num_frames, self._state()))
        self.frames, self._num_loops = num_frames, self._num_loops + len(self._loops)
        self._waiting, self._loops, self._redundant, self._is_announced = [], [], [], False
        self._last = time.perf_counter()
        self._cost = self._last - begin

    def finish(self, late: Sequence[LoopCandidate], optimized: OptimizationResult, ended: bool) -> SessionResult:
        """Record the last loops and the corrected poses; a session that was interrupted may be resumed."""
        with self._store.writing():
            if ended:
                self._write_loops([self._loop_record(candidate, None) for candidate in late])
                corrected, result = merge_session(self._store, self._session, optimized, self._config)
            else:
                corrected, result = close_session(self._session, optimized)
            self._store.finish(self._session.number, corrected, ended)
        return result

    def _thin(self, query: int) -> None:
        """Keep a few landmarks of a frame of the session; of a waiting frame, as the rest need not be written first."""
        waiting = query - self.frames
        if waiting < 0:
            self._redundant.append(self._session.first_image + query)
            return
        frame, count = self._waiting[waiting], self._config.loop_closing.max_known_landmarks
        self._waiting[waiting] = replace(frame, landmarks=frame.landmarks.strongest(count), is_key_frame=False)

    def _loop_record(self, candidate: LoopCandidate, at_image: int | None) -> LoopRecord:
        """The record of a candidate, numbered as in the map; it may match an image of an earlier session."""
        first = self._session.first_image
        if self._recognizer is not None:
            inter_session = self._recognizer.take_inter_session(first + candidate.belief.query)
            if inter_session is not None:
                return replace(inter_session, at_image=at_image)
        return loop_in_map(candidate, at_image, first)

    def _write_loops(self, loops: Iterable[LoopRecord]) -> None:
        for number, loop in enumerate(loops, start=self._num_loops):
            self._store.add_loop(number, loop)


@contextmanager
def open_session_recorder(folder: RunFolder, config: RunConfig, session: SessionInfo) -> Iterator[SessionRecorder]:
    """Record a session in the map of a run's folder, from its first frame or from where it stopped.

    If an error ends the block, the map stays in the folder, provided that it has at least one frame.

    Raises:
        OutputError: the map cannot be written.
        RevisitError: an error of the block, with a hint how to resume.
    """
    if not config.save_map:
        yield NullSessionRecorder()
        return
    with _open(folder.path / MAP_FILE, config, session) as store:
        recorder = MapSessionRecorder(store, store.sessions()[-1], config)
        try:
            yield recorder
        except RevisitError as error:
            if not recorder.frames:
                raise
            kept = f"{recorder.frames} frames are kept in {folder.final}: continue with --resume"
            raise type(error)(f"{error}; {kept}") from error
        finally:
            if recorder.frames:
                folder.keep()
    if not recorder.frames:  # a disk without room: the other results are better without an empty map
        (folder.path / MAP_FILE).unlink(missing_ok=True)


def _open(path: Path, config: RunConfig, session: SessionInfo) -> MapDatabase:
    if not path.exists():
        with replacing(path) as begun:  # without its new session, the map would look like that of another run
            _begin(begun, config, session)
    return MapDatabase.open(path, writable=True)


def _begin(path: Path, config: RunConfig, session: SessionInfo) -> None:
    """Write the map that a session starts with: empty, or with the earlier sessions."""
    if session.map_file is not None:
        with MapDatabase.open(session.map_file) as known:
            known.copy(path)
    database = MapDatabase.open(path, writable=True) if session.map_file else MapDatabase.create(path)
    with database as store, store.writing():
        number = len(store.sessions())
        store.add_session(
            Session(
                number=number,
                first_image=store.images(),
                name=session.name,
                camera=session.camera,
                config=to_toml(config),
                provenance=session.provenance,
                map_id=number,
            )
        )


def _frame_record(result: FrameResult, image: int, stage_ms: dict[str, float]) -> FrameRecord:
    return FrameRecord(
        image=image,
        timestamp=result.frame.timestamp,
        motion=result.motion,
        T_world_odometry=result.T_world_camera_odometry,
        T_world_online=result.T_world_camera,
        landmarks=result.landmarks,
        is_key_frame=result.is_key_frame,
        stage_ms=stage_ms,
    )
