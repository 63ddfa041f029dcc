"""A drive into a map store as it goes, and out of it again where it stopped."""

import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from odometry.camera import StereoCamera
from place_recognition.evaluation.matrix import MatrixRows
from slam.config import RunConfig, to_toml
from slam.drive_log import DriveLog
from slam.errors import RevisitError
from slam.loop_closing import LoopClosure
from slam.map_store.ending import Ended, conclude, stopped
from slam.map_store.freezing import Freezer, Thawer
from slam.map_store.rows import StoredAttempt, StoredFrame
from slam.map_store.store import MAP_FILE, Checkpoint, MapStore, Session
from slam.parts import build_parts
from slam.robust import OptimizationResult
from slam.storage.atomic import replacing
from slam.storage.run_folder import RunFolder
from slam.system import Beginning, LoopAttempt, Processed, Slam

_APART_M = 1000.0  # of way between two drives: more than any rule asks for between an image and its match
_FEWEST = 100  # frames from one checkpoint to the next
_SHARE = 0.04  # of the time that checkpoints may take: a large map is looked at less often


@dataclass(frozen=True)
class NewDrive:
    """A drive that a map is to take in.

    Attributes:
        name: of the drive.
        camera: of its left images, with the pair's baseline.
        provenance: source, recording, command, versions, and the name of the run.
        map_file: map of other drives, which it may meet; it stays as it is.
    """

    name: str
    camera: StereoCamera
    provenance: Mapping[str, object]
    map_file: Path | None = None


class Keeper(Protocol):
    """Keeps what a drive finds out."""

    @property
    def beginning(self) -> Beginning:
        """Where the drive begins behind the others of the map."""
        ...

    def recall(self, slam: Slam, rows: MatrixRows, log: DriveLog) -> int:
        """Bring a newly built system to where the drive stopped; how many frames it has behind it."""
        ...

    def add(self, processed: Processed, stage_ms: dict[str, float]) -> None:
        """Keep a frame, and how long its stages took, those outside the system included."""
        ...

    def pause(self) -> None:
        """Keep everything so far: the drive ends here, or is stopped."""
        ...

    def finish(self, late: Sequence[LoopAttempt], optimized: OptimizationResult, ended: bool) -> Ended:
        """Keep the last answers and the corrected map; a drive that was stopped before its end may go on later."""
        ...


class NullKeeper:
    """Keeps nothing (a Keeper)."""

    beginning = Beginning()

    def recall(self, slam: Slam, rows: MatrixRows, log: DriveLog) -> int:
        """Begin at the beginning."""
        return 0

    def add(self, processed: Processed, stage_ms: dict[str, float]) -> None:
        """Forget the frame."""

    def pause(self) -> None:
        """Do nothing."""

    def finish(self, late: Sequence[LoopAttempt], optimized: OptimizationResult, ended: bool) -> Ended:
        """Forget the map."""
        return Ended(optimized)


class MapKeeper:
    """Keeps one session in a store (a Keeper).

    Frames wait in memory until the next checkpoint and are written with it.

    Attributes:
        frames: of the session that have been written.
    """

    def __init__(self, store: MapStore, session: Session, config: RunConfig) -> None:
        self.frames = 0
        self._store, self._session, self._config = store, session, config
        self._waiting: list[StoredFrame] = []
        self._attempts: list[StoredAttempt] = []
        self._answered = 0
        self._parts: dict[str, object] = {}
        self._last, self._cost = time.perf_counter(), 0.0

    @property
    def beginning(self) -> Beginning:
        """Where the drive begins behind the others of the map."""
        before = self._store.steps()[: self._session.first_image]
        way = sum(float(np.linalg.norm(T[:3, 3])) for T, _ in before)
        return Beginning(self._session.first_image, way + _APART_M * self._session.number)

    def recall(self, slam: Slam, rows: MatrixRows, log: DriveLog) -> int:
        """Bring a newly built system to where the drive stopped; how many frames it has behind it."""
        first = self._session.first_image
        self._parts = moving_parts(slam, rows)
        self._answered = self._store.answers_before(first)
        answered = Answers(self._store.attempts(first))
        for frame in self._store.frames():
            if frame.image < first:
                slam.parts.loop_closer.restore_frame(frame.image, frame.landmarks)
                continue
            attempts = answered.with_image(frame.image)
            self._answered += len(attempts)
            log.recall(frame, slam.recall(frame, attempts))
        self.frames = self._thaw(rows)
        return self.frames

    def _thaw(self, rows: MatrixRows) -> int:
        """Thaw what is known of this drive, else of the one before; how many frames of this one that has seen."""
        own = self._store.checkpoint(self._session.number)
        checkpoint = own or self._store.checkpoint(self._session.number - 1)
        if checkpoint is None:
            return 0
        parts = self._parts if own else self._parts | self._of_another_drive()
        with self._store.reading():
            Thawer(checkpoint.arrays).thaw(checkpoint.structure, parts)
        if own is None:
            rows.begin_anew(self._session.first_image)
        return own.frames if own else 0

    def _of_another_drive(self) -> dict[str, object]:
        """Parts that begin anew with each drive: what those of the one before knew goes into these."""
        parts = build_parts(self._session.camera, self._config)
        return {"eyes": parts.eyes, "key_frames": parts.key_frames}

    def add(self, processed: Processed, stage_ms: dict[str, float]) -> None:
        """Keep a frame, and how long its stages took, those outside the system included."""
        image = self._session.first_image + processed.frame.index
        self._waiting.append(_stored(processed, image, stage_ms))
        self._attempts += [self._answer(attempt, image) for attempt in processed.attempts]
        driven = time.perf_counter() - self._last
        if len(self._waiting) >= _FEWEST and _SHARE * driven >= self._cost:
            self.pause()

    def pause(self) -> None:
        """Write a checkpoint, and what has come since the last one."""
        begin = time.perf_counter()
        with self._store.writing():
            self._store.forget_answers(self._answered)  # of an end that was none
            for frame in self._waiting:
                self._store.add_frame(frame, self._session.number)
            self._write(self._attempts)
            freezer = Freezer()
            structure = freezer.freeze(self._parts)
            kept = self.frames + len(self._waiting)
            self._store.set_checkpoint(self._session.number, Checkpoint(kept, structure, freezer.arrays))
        self.frames, self._answered = kept, self._answered + len(self._attempts)
        self._waiting, self._attempts = [], []
        self._last = time.perf_counter()
        self._cost = self._last - begin

    def finish(self, late: Sequence[LoopAttempt], optimized: OptimizationResult, ended: bool) -> Ended:
        """Keep the last answers and the corrected map; a drive that was stopped before its end may go on later."""
        with self._store.writing():
            if ended:
                self._write([self._answer(attempt, None) for attempt in late])
                told = conclude(self._store, self._session, optimized, self._config)
            else:
                told = stopped(self._session, optimized)
            self._store.finish(self._session.number, told.corrected, ended)
        return told.ended

    def _answer(self, attempt: LoopAttempt, at_image: int | None) -> StoredAttempt:
        """An attempt with its images counted through all drives."""
        first = self._session.first_image
        belief, geometry = attempt.belief, attempt.geometry
        match = None if belief.match is None else belief.match + first
        belief = replace(belief, query=belief.query + first, match=match)
        if isinstance(geometry, LoopClosure):
            geometry = replace(geometry, query=geometry.query + first, match=geometry.match + first)
        return StoredAttempt(at_image, belief, geometry)

    def _write(self, attempts: Iterable[StoredAttempt]) -> None:
        for number, attempt in enumerate(attempts, start=self._answered):
            self._store.add_attempt(number, attempt)


@contextmanager
def open_keeper(folder: RunFolder, config: RunConfig, drive: NewDrive) -> Iterator[Keeper]:
    """Keep a drive in the map of a run's folder, from the beginning or from where it stopped.

    Whatever ends the block early, the map stays in the folder as soon as there is something in it.

    Raises:
        OutputError: the map cannot be written.
        RevisitError: what the block raises, with a word on how to go on.
    """
    if not config.keep_map:
        yield NullKeeper()
        return
    with _open(folder.path / MAP_FILE, config, drive) as store:
        keeper = MapKeeper(store, store.sessions()[-1], config)
        try:
            yield keeper
        except RevisitError as error:
            if not keeper.frames:
                raise
            kept = f"{keeper.frames} frames are kept in {folder.final}: go on with --resume"
            raise type(error)(f"{error}; {kept}") from error
        finally:
            if keeper.frames:
                folder.keep()


def _open(path: Path, config: RunConfig, drive: NewDrive) -> MapStore:
    if not path.exists():
        with replacing(path) as begun:  # a map without its new drive would be taken for that of another run
            _begin(begun, config, drive)
    return MapStore.open(path, writable=True)


def _begin(path: Path, config: RunConfig, drive: NewDrive) -> None:
    """Write the map with which a drive begins."""
    if drive.map_file is not None:
        with MapStore.open(drive.map_file) as known:
            known.copy(path)
    with MapStore.open(path, writable=True) if drive.map_file else MapStore.create(path) as store, store.writing():
        number, first_image = len(store.sessions()), store.images()
        store.add_session(
            Session(number, first_image, drive.name, drive.camera, to_toml(config), drive.provenance, world=number)
        )


class Answers:
    """Attempts in their order, dealt out to the images with which they came."""

    def __init__(self, attempts: Iterator[StoredAttempt]) -> None:
        self._waiting = deque(attempts)

    def with_image(self, image: int) -> list[StoredAttempt]:
        """Those that came with an image; call with one image after the other."""
        given: list[StoredAttempt] = []
        while self._waiting and self._waiting[0].at_image == image:
            given.append(self._waiting.popleft())
        return given


def moving_parts(slam: Slam, rows: MatrixRows) -> dict[str, object]:
    """What of a system changes with each image and cannot be had from frames and attempts."""
    parts = slam.parts
    return {
        "features": parts.features,
        "eyes": parts.eyes,
        "recognizer": parts.recognizer,
        "key_frames": parts.key_frames,
        "rows": rows,
    }


def _stored(processed: Processed, image: int, stage_ms: dict[str, float]) -> StoredFrame:
    return StoredFrame(
        image=image,
        timestamp=processed.frame.timestamp,
        motion=processed.motion,
        T_world_odometry=processed.T_world_camera_odometry,
        T_world_online=processed.T_world_camera,
        landmarks=processed.landmarks,
        key_frame=processed.is_key_frame,
        stage_ms=stage_ms,
    )
