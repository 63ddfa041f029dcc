"""Log of a run: what is known of each frame and of each loop candidate, in numbers; never an image."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from odometry.motion import Motion
from slam.frame_record import FrameRecord
from slam.io.csv_tables import FrameTable
from slam.system import FrameResult, LoopCandidate

Array = NDArray[np.float64]


@dataclass
class RunLog:
    """Grows by one entry a frame.

    Attributes:
        timestamps: seconds.
        odometry, online: T_world_camera (4, 4), metres, at the moment when the frame was processed.
        candidates: every belief, and what came of it.
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
        """Add what became of beliefs."""
        self.candidates.extend(candidates)

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

    def _add(self, timestamp: float, odometry: Array, online: Array, motion: Motion) -> None:
        self.timestamps.append(timestamp)
        self.odometry.append(odometry)
        self.online.append(online)
        self._motions.append(_summary(motion))


def _summary(motion: Motion) -> tuple[bool, str, int, int, float]:
    inliers = int(motion.inliers.sum())
    return motion.predicted, motion.reason, inliers, len(motion.inliers), motion.residual_px
