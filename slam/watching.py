"""Passes what a viewer shows from the SLAM system to the viewer: frames, loops, and the recogniser's matrix."""

import time

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from place_recognition.evaluation.matrix import MatrixRows
from slam.datasets.dataset import Dataset, Frame
from slam.drive_log import DriveLog
from slam.loop_closing import LoopClosure
from slam.system import LoopAttempt, Processed, Slam
from slam.viewer.viewer import FrameView, LoopView, Viewer

Array = NDArray[np.float64]

_MIN_PAIR_INTERVAL_FRAMES = 10  # between two image pairs shown: the earlier image has to be read again
_MATRIX_INTERVAL_FRAMES = 100  # between two pictures of the recogniser's matrix, whose cost grows with its size
_NO_PIXELS = np.empty((0, 2))


class RunVisualizer:
    """Shows each frame, the outcome of the loops proposed with it, and the recogniser's matrix in a viewer."""

    def __init__(self, slam: Slam, viewer: Viewer, drive: Dataset, rows: MatrixRows) -> None:
        self._slam, self._viewer, self._drive, self._rows = slam, viewer, drive, rows
        self._last_pair = -_MIN_PAIR_INTERVAL_FRAMES

    def restore(self, log: DriveLog) -> None:
        """Show the state of a resumed run, without its images."""
        if log.timestamps:
            loops = [attempt for attempt in log.attempts if attempt.geometry is not None]
            self._viewer.restore(
                np.array(log.timestamps),
                np.array(log.odometry),
                self._slam.parts.graph.poses(),
                [(attempt.belief.query, attempt.belief.match or 0, attempt.closed) for attempt in loops],
            )

    def show(self, processed: Processed) -> dict[str, float]:
        """Show a frame and return the milliseconds it took, as the stage `viewer`."""
        start = time.perf_counter()
        self._viewer.show_frame(_frame_view(processed))
        for attempt in processed.attempts:
            if attempt.geometry is not None and not attempt.elsewhere:
                self._show_loop(attempt, processed)
        if processed.frame.index % _MATRIX_INTERVAL_FRAMES == _MATRIX_INTERVAL_FRAMES - 1:
            self._viewer.show_matrix(self._rows.matrix(processed.frame.index + 1))
        return {"viewer": 1000.0 * (time.perf_counter() - start)}

    def _show_loop(self, attempt: LoopAttempt, processed: Processed) -> None:
        with_pair = attempt.closed and processed.frame.index - self._last_pair >= _MIN_PAIR_INTERVAL_FRAMES
        if with_pair:
            self._last_pair = processed.frame.index
        poses = self._slam.parts.graph.poses() if with_pair else np.empty((0, 4, 4))
        self._viewer.show_loop(self._loop_view(attempt, processed, with_pair), poses)

    def _loop_view(self, attempt: LoopAttempt, processed: Processed, with_pair: bool) -> LoopView:
        geometry, belief = attempt.geometry, attempt.belief
        assert belief.match is not None
        closure = geometry if isinstance(geometry, LoopClosure) else None
        return LoopView(
            query=belief.query,
            match=belief.match,
            image_query=self._query_image(belief.query, processed.frame) if with_pair else None,
            image_match=self._drive[belief.match].left if with_pair else None,
            pixels_query=_NO_PIXELS if closure is None else closure.pixels_query.astype(np.float64),
            pixels_match=_NO_PIXELS if closure is None else closure.pixels_match.astype(np.float64),
            accepted=attempt.closed,
            reason=attempt.reason,
        )

    def _query_image(self, query: int, frame: Frame) -> NDArray[np.uint8]:
        """Return the image of the query: the current one, unless the recogniser answers late."""
        return frame.left if query == frame.index else self._drive[query].left


def _frame_view(processed: Processed) -> FrameView:
    beliefs = [attempt.belief for attempt in processed.attempts]  # several at once, or none, where answers come late
    belief = max(beliefs, key=lambda belief: (belief.accepted, belief.score), default=None)
    return FrameView(
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
    return se3.transform(processed.T_world_camera, processed.landmarks.points.astype(np.float64))
