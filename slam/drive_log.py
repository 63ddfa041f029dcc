"""What a run remembers of each frame: numbers, never an image."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from odometry.motion import Motion
from place_recognition.recognizer import Belief
from slam.map_store.rows import StoredFrame
from slam.storage.tables import FrameTable
from slam.system import LoopAttempt, Processed

Array = NDArray[np.float64]


@dataclass
class DriveLog:
    """Grows by one entry a frame.

    Attributes:
        timestamps: seconds.
        odometry, online: T_world_camera (4, 4), metres, as they were when the frame was seen.
        attempts: every belief, and what came of it; none of the match where that is an image of another drive.
        meetings: beliefs with such a match, and what came of them.
        stage_ms: milliseconds by stage.
    """

    timestamps: list[float] = field(default_factory=list)
    odometry: list[Array] = field(default_factory=list)
    online: list[Array] = field(default_factory=list)
    attempts: list[LoopAttempt] = field(default_factory=list)
    meetings: list[LoopAttempt] = field(default_factory=list)
    stage_ms: list[dict[str, float]] = field(default_factory=list)
    _motions: list[tuple[bool, str, int, int, float]] = field(default_factory=list)

    def add(self, processed: Processed, outside_ms: dict[str, float]) -> None:
        """Remember a frame; `outside_ms` are the stages outside the system, milliseconds."""
        self.timestamps.append(processed.frame.timestamp)
        self.odometry.append(processed.T_world_camera_odometry)
        self.online.append(processed.T_world_camera)
        self.conclude(processed.attempts)
        self.stage_ms.append(processed.stage_ms | outside_ms)
        self._motions.append(_summary(processed.motion))

    def recall(self, frame: StoredFrame, attempts: Iterable[LoopAttempt]) -> None:
        """Remember a frame of an earlier run that goes on."""
        self.timestamps.append(frame.timestamp)
        self.odometry.append(frame.T_world_odometry)
        self.online.append(frame.T_world_online)
        self.conclude(attempts)
        self.stage_ms.append(dict(frame.stage_ms))
        self._motions.append(_summary(frame.motion))

    def conclude(self, attempts: Iterable[LoopAttempt]) -> None:
        """Remember what came of beliefs."""
        for attempt in attempts:
            if attempt.elsewhere:
                self.meetings.append(attempt)
                unmatched = Belief(attempt.belief.query, None, 0.0, accepted=False)
                self.attempts.append(LoopAttempt(unmatched, None, None))
            else:
                self.attempts.append(attempt)

    def table(self) -> FrameTable:
        """Everything that `frames.csv` holds."""
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


def _summary(motion: Motion) -> tuple[bool, str, int, int, float]:
    inliers = int(motion.inliers.sum())
    return motion.predicted, motion.reason, inliers, len(motion.inliers), motion.residual_px
