"""What a run remembers of each frame, until it becomes the record of the drive."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from slam.system import LoopAttempt, Processed

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FrameLine:
    """One line of `frames.csv`, images left out.

    Attributes:
        timestamp: seconds.
        T_world_camera_odometry, T_world_camera_online: (4, 4) metres, at the moment the frame was seen.
        predicted: the motion was extrapolated.
        reason: why; empty when measured.
        tracks, inliers: followed points, and those that agree with the motion.
        residual_px: of the inliers, pixels; NaN when predicted.
        stage_ms: milliseconds by stage.
    """

    timestamp: float
    T_world_camera_odometry: Array
    T_world_camera_online: Array
    predicted: bool
    reason: str
    tracks: int
    inliers: int
    residual_px: float
    stage_ms: dict[str, float]


@dataclass
class DriveLog:
    """Grows by one line a frame; holds no image."""

    frames: list[FrameLine] = field(default_factory=list)
    attempts: list[LoopAttempt] = field(default_factory=list)

    def add(self, processed: Processed, extra_ms: dict[str, float]) -> None:
        """Remember a frame; `extra_ms` are the stages outside the system, milliseconds."""
        motion = processed.motion
        self.frames.append(
            FrameLine(
                processed.frame.timestamp,
                processed.T_world_camera_odometry,
                processed.T_world_camera,
                motion.predicted,
                motion.reason,
                len(motion.inliers),
                int(motion.inliers.sum()),
                motion.residual_px,
                processed.stage_ms | extra_ms,
            )
        )
        self.attempts.extend(processed.attempts)

    def poses(self, name: str) -> Array:
        """Stack (N, 4, 4) of the named pose of every frame."""
        return np.array([getattr(line, name) for line in self.frames]).reshape(-1, 4, 4)

    def stage_ms(self) -> dict[str, Array]:
        """Milliseconds of each stage for each frame: name to (N,); 0 where a stage had nothing to do."""
        names = dict.fromkeys(name for line in self.frames for name in line.stage_ms)
        return {name: np.array([line.stage_ms.get(name, 0.0) for line in self.frames]) for name in names}
