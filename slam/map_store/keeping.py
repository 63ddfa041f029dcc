"""A drive into a map store as it goes, and out of it again where it stopped."""

import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol

from place_recognition.evaluation.matrix import MatrixRows
from slam.drive_log import DriveLog
from slam.loop_closing import LoopClosure
from slam.map_store.freezing import Freezer, Thawer
from slam.map_store.rows import StoredAttempt, StoredFrame
from slam.map_store.store import Checkpoint, Corrected, MapStore, Session, Verdict
from slam.robust import Optimized
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
    """

    def __init__(self, store: MapStore, session: Session) -> None:
        self._store, self._session = store, session
        self._frames: list[StoredFrame] = []
        self._attempts: list[StoredAttempt] = []
        self._kept = self._answered = 0
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
        self._kept = checkpoint.frames
        return checkpoint.frames

    def add(self, processed: Processed, stage_ms: dict[str, float]) -> None:
        """Keep a frame, and how long its stages took, those outside the system included."""
        image = self._session.first_image + processed.frame.index
        self._frames.append(_stored(processed, image, stage_ms))
        self._attempts += [StoredAttempt(image, attempt.belief, attempt.geometry) for attempt in processed.attempts]
        driven = time.perf_counter() - self._last
        if len(self._frames) >= _FEWEST and _SHARE * driven >= self._cost:
            self.pause()

    def pause(self) -> None:
        """Write a checkpoint, and what has come since the last one."""
        begin = time.perf_counter()
        with self._store.writing():
            self._store.forget_answers(self._answered)  # of an end that was none
            for frame in self._frames:
                self._store.add_frame(frame, self._session.number)
            self._write(self._attempts)
            freezer = Freezer()
            structure = freezer.freeze(self._parts)
            kept = self._kept + len(self._frames)
            self._store.set_checkpoint(self._session.number, Checkpoint(kept, structure, freezer.arrays))
        self._kept, self._answered = kept, self._answered + len(self._attempts)
        self._frames, self._attempts = [], []
        self._last = time.perf_counter()
        self._cost = self._last - begin

    def finish(self, late: Sequence[LoopAttempt], corrected: Corrected, ended: bool) -> None:
        """Keep the last answers and the corrected map; a drive that was stopped before its end may go on later."""
        with self._store.writing():
            if ended:
                after = self._session.first_image + self._kept
                self._write([StoredAttempt(after, attempt.belief, attempt.geometry) for attempt in late])
            self._store.finish(self._session.number, corrected, ended)

    def _write(self, attempts: Iterable[StoredAttempt]) -> None:
        for number, attempt in enumerate(attempts, start=self._answered):
            self._store.add_attempt(number, attempt)


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


def verdicts(attempts: Iterable[LoopAttempt], optimized: Optimized) -> dict[int, Verdict]:
    """What the optimisation said of each closed loop, by the number of its attempt."""
    closed = [number for number, attempt in enumerate(attempts) if isinstance(attempt.geometry, LoopClosure)]
    columns = (optimized.kept, optimized.weights, optimized.residuals, optimized.reasons)
    return {number: Verdict(*said) for number, *said in zip(closed, *columns, strict=True)}


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
