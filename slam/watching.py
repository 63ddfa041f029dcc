"""Between the system and a viewer: what of a frame is worth showing."""

import time

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.loop_closing import LoopClosure
from slam.system import LoopAttempt, Processed, Slam
from slam.viewer.viewer import ClosedLoop, Step, Viewer

Array = NDArray[np.float64]


class Watcher:
    """Shows each processed frame, and the loops it closed, in a viewer."""

    def __init__(self, slam: Slam, viewer: Viewer) -> None:
        self._slam, self._viewer = slam, viewer

    def show(self, processed: Processed) -> dict[str, float]:
        """Show a frame. Returns the milliseconds it took, as the stage `viewer`."""
        start = time.perf_counter()
        self._viewer.step(_step(processed))
        for attempt in processed.attempts:
            if attempt.geometry is not None:
                self._viewer.loop(self._closed(attempt, processed), self._poses(attempt))
        return {"viewer": 1000.0 * (time.perf_counter() - start)}

    def _poses(self, attempt: LoopAttempt) -> Array:
        return self._slam.parts.graph.poses() if attempt.closed else np.empty((0, 4, 4))

    def _closed(self, attempt: LoopAttempt, processed: Processed) -> ClosedLoop: ...


def _step(processed: Processed) -> Step:
    belief = processed.attempts[-1].belief if processed.attempts else None
    return Step(
        index=processed.frame.index,
        timestamp=processed.frame.timestamp,
        image=processed.frame.left,
        T_world_camera_odometry=processed.T_world_camera_odometry,
        T_world_camera=processed.T_world_camera,
        pixels_previous=processed.motion.pixels_previous,
        pixels_current=processed.motion.pixels_current,
        inliers=processed.motion.inliers,
        predicted=processed.motion.predicted,
        landmarks_world=_landmarks_world(processed),
        stage_ms=processed.stage_ms,
        score=belief.score if belief else 0.0,
        accepted=belief.accepted if belief else False,
    )


def _landmarks_world(processed: Processed) -> Array | None:
    if not processed.is_key_frame:
        return None
    return se3.transform(processed.T_world_camera, processed.landmarks.points_camera)
