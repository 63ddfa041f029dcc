"""Logs of a run: numbers of each frame and each loop candidate, and the messages of `run.log`."""

import logging
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from odometry.motion import Motion
from slam.frame_record import FrameRecord
from slam.io.frames_and_loops_csv import FrameTable
from slam.system import FrameResult, LoopCandidate

Array = NDArray[np.float64]

log = logging.getLogger("revisit")


@dataclass
class RunLog:
    """Numbers of a run; one entry is added for each frame.

    Attributes:
        timestamps: seconds.
        odometry, online: T_world_camera (4, 4), metres, at the moment when the frame was processed.
        candidates: all loop candidates, in the order in which they became ready.
        stage_ms: milliseconds by stage.
    """

    timestamps: list[float] = field(default_factory=list)
    odometry: list[Array] = field(default_factory=list)
    online: list[Array] = field(default_factory=list)
    candidates: list[LoopCandidate] = field(default_factory=list)
    stage_ms: list[dict[str, float]] = field(default_factory=list)
    _motions: list[tuple[bool, str, int, int, float]] = field(default_factory=list)

    def add(self, result: FrameResult, outside_ms: dict[str, float]) -> None:
        """Add a frame; `outside_ms` are the milliseconds of the stages outside the system."""
        self._add(result.frame.timestamp, result.T_world_camera_odometry, result.T_world_camera, result.motion)
        self.stage_ms.append(result.stage_ms | outside_ms)
        self.add_loops(result.candidates)

    def restore_frame(self, record: FrameRecord, candidates: Iterable[LoopCandidate]) -> None:
        """Add a frame of an earlier run that is resumed."""
        self._add(record.timestamp, record.T_world_odometry, record.T_world_online, record.motion)
        self.stage_ms.append(dict(record.stage_ms))
        self.add_loops(candidates)

    def add_loops(self, candidates: Iterable[LoopCandidate]) -> None:
        """Add loop candidates."""
        self.candidates.extend(candidates)

    def table(self) -> FrameTable:
        """Contents of `frames.csv`."""
        predicted, reasons, inliers, tracks, residuals = zip(*self._motions, strict=True)
        stages = dict.fromkeys(stage for spent in self.stage_ms for stage in spent)
        return FrameTable(
            timestamps=np.array(self.timestamps),
            predicted=np.array(predicted, dtype=bool),
            reasons=reasons,
            inliers=np.array(inliers, dtype=np.int64),
            tracks=np.array(tracks, dtype=np.int64),
            residual_px=np.array(residuals, dtype=np.float64),
            stage_ms={stage: np.array([spent.get(stage, 0.0) for spent in self.stage_ms]) for stage in stages},
        )

    def _add(self, timestamp: float, odometry: Array, online: Array, motion: Motion) -> None:
        self.timestamps.append(timestamp)
        self.odometry.append(odometry)
        self.online.append(online)
        self._motions.append(_summary(motion))


def _summary(motion: Motion) -> tuple[bool, str, int, int, float]:
    inliers = int(motion.inliers.sum())
    return motion.predicted, motion.reason, inliers, len(motion.inliers), motion.residual_px


def log_frame(result: FrameResult) -> None:
    """Log a predicted motion and the loop candidates of a frame."""
    if result.motion.predicted:
        log.warning("frame %d: motion predicted, %s", result.frame.index, result.motion.reason)
    log_loops(result.candidates)


def log_loops(candidates: Iterable[LoopCandidate]) -> None:
    """Log the outcome of each loop candidate."""
    for candidate in candidates:
        if candidate.reason:
            outcome = "closed" if candidate.closed else "not closed"
            log.info("loop %d -> %s %s: %s", candidate.belief.query, candidate.belief.match, outcome, candidate.reason)


@contextmanager
def log_to_file(path: Path) -> Iterator[None]:
    """Send the log to a file while the block runs."""
    handler = _LogFile(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.removeHandler(handler)
        with suppress(OSError):
            handler.close()


class _LogFile(logging.FileHandler):
    """A log file that a full disk cuts short; the results need room too and report the full disk."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Ignore that a line could not be written."""
