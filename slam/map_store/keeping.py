"""A drive into a map store as it goes, and out of it again where it stopped."""

import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol

from place_recognition.evaluation.matrix import MatrixRows
from slam.config import RunConfig, to_toml
from slam.datasets.dataset import Dataset
from slam.drive_log import DriveLog
from slam.errors import RevisitError
from slam.loop_closing import LoopClosure
from slam.map_store.freezing import Freezer, Thawer
from slam.map_store.rows import StoredAttempt, StoredFrame
from slam.map_store.store import MAP_FILE, Checkpoint, Corrected, MapStore, Session, Verdict
from slam.robust import Optimized
from slam.storage.run_folder import RunFolder
from slam.system import LoopAttempt, Processed, Slam

_FEWEST = 100  # frames from one checkpoint to the next
_SHARE = 0.04  # of the time that checkpoints may take: a large map is looked at less often


class Keeper(Protocol):
    """Keeps what a drive finds out."""

    def recall(self, slam: Slam, rows: MatrixRows, log: DriveLog) -> int:
        """Bring a newly built system to where the drive stopped; how many frames it has behind it."""
        ...

    def add(self, processed: Processed, stage_ms: dict[str, float]) -> None:
        """Keep a frame, and how long its stages took, those outside the system included."""
        ...

    def pause(self) -> None:
        """Keep everything so far: the drive ends here, or is stopped."""
        ...

    def finish(self, late: Sequence[LoopAttempt], corrected: Corrected, ended: bool) -> None:
        """Keep the last answers and the corrected map; a drive that was stopped before its end may go on later."""
        ...


class NullKeeper:
    """Keeps nothing (a Keeper)."""

    def recall(self, slam: Slam, rows: MatrixRows, log: DriveLog) -> int:
        """Begin at the beginning."""
        return 0

    def add(self, processed: Processed, stage_ms: dict[str, float]) -> None:
        """Forget the frame."""

    def pause(self) -> None:
        """Do nothing."""

    def finish(self, late: Sequence[LoopAttempt], corrected: Corrected, ended: bool) -> None:
        """Forget the map."""


class MapKeeper:
    """Keeps one session in a store (a Keeper).

    Frames wait in memory until the next checkpoint and are written with it.

    Attributes:
        frames: of the session that have been written.
    """

    def __init__(self, store: MapStore, session: Session) -> None:
        self.frames = 0
        self._store, self._session = store, session
        self._waiting: list[StoredFrame] = []
        self._attempts: list[StoredAttempt] = []
        self._answered = 0
        self._parts: dict[str, object] = {}
        self._last, self._cost = time.perf_counter(), 0.0

    def recall(self, slam: Slam, rows: MatrixRows, log: DriveLog) -> int:
        """Bring a newly built system to where the drive stopped; how many frames it has behind it."""
        self._parts = moving_parts(slam, rows)
        checkpoint = self._store.checkpoint(self._session.number)
        if checkpoint is None:
            return 0
        answered = Answers(self._store.attempts())
        for frame in self._store.frames():
            attempts = answered.with_image(frame.image)
            self._answered += len(attempts)
            log.recall(frame, slam.recall(frame, attempts))
        with self._store.reading():
            Thawer(checkpoint.arrays).thaw(checkpoint.structure, self._parts)
        self.frames = checkpoint.frames
        return checkpoint.frames

    def add(self, processed: Processed, stage_ms: dict[str, float]) -> None:
        """Keep a frame, and how long its stages took, those outside the system included."""
        image = self._session.first_image + processed.frame.index
        self._waiting.append(_stored(processed, image, stage_ms))
        self._attempts += [StoredAttempt(image, attempt.belief, attempt.geometry) for attempt in processed.attempts]
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

    def finish(self, late: Sequence[LoopAttempt], corrected: Corrected, ended: bool) -> None:
        """Keep the last answers and the corrected map; a drive that was stopped before its end may go on later."""
        with self._store.writing():
            if ended:
                after = self._session.first_image + self.frames
                self._write([StoredAttempt(after, attempt.belief, attempt.geometry) for attempt in late])
            self._store.finish(self._session.number, corrected, ended)

    def _write(self, attempts: Iterable[StoredAttempt]) -> None:
        for number, attempt in enumerate(attempts, start=self._answered):
            self._store.add_attempt(number, attempt)


@contextmanager
def open_keeper(
    folder: RunFolder, drive: Dataset, config: RunConfig, provenance: Mapping[str, object]
) -> Iterator[Keeper]:
    """Keep a drive in the map of a run's folder, from the beginning or from where it stopped.

    Whatever ends the block early, the map stays in the folder as soon as there is something in it.

    Raises:
        OutputError: the map cannot be written.
        RevisitError: what the block raises, with a word on how to go on.
    """
    if not config.keep_map:
        yield NullKeeper()
        return
    with _open(folder.path / MAP_FILE, drive, config, provenance) as store:
        keeper = MapKeeper(store, store.sessions()[-1])
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


def _open(path: Path, drive: Dataset, config: RunConfig, provenance: Mapping[str, object]) -> MapStore:
    if path.exists():
        return MapStore.open(path, writable=True)
    store = MapStore.create(path)
    with store.writing():
        store.add_session(Session(0, 0, drive.name, drive.camera, to_toml(config), provenance))
    return store


class Answers:
    """Attempts in their order, dealt out to the images with which they came."""

    def __init__(self, attempts: Iterator[StoredAttempt]) -> None:
        self._waiting = deque(attempts)

    def with_image(self, image: int) -> list[StoredAttempt]:
        """Those that came with an image; call with one image after the other."""
        given = []
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


def corrected(attempts: Iterable[LoopAttempt], optimized: Optimized) -> Corrected:
    """The final poses, and what the optimisation said of the closed loops among all attempts of the drive."""
    closed = [number for number, attempt in enumerate(attempts) if isinstance(attempt.geometry, LoopClosure)]
    columns = (optimized.kept, optimized.weights, optimized.residuals, optimized.reasons)
    verdicts = {number: Verdict(*said) for number, *said in zip(closed, *columns, strict=True)}
    return Corrected(optimized.poses, optimized.lengths, verdicts)


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
