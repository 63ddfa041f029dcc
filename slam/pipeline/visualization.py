"""Visualization of a run: opens a viewer, and shows it frames, loops and the recogniser's similarity matrix."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from place_recognition.evaluation.similarity_matrix import MatrixRecorder
from slam.datasets.dataset import Dataset, Frame
from slam.loop_closing.loop_closer import LoopClosure
from slam.pipeline.run_warnings import RunWarnings
from slam.run_log import RunLog
from slam.system import FrameResult, LoopCandidate, Slam, redundant_frames
from slam.viewer.viewer import FrameView, LoopView, NullViewer, Viewer

Array = NDArray[np.float64]

VIEWS = ("none", "native", "web")
# Between two image pairs shown: the earlier image has to be read again, and the whole trajectory is drawn, for which a
# longer drive has longer intervals.
_MIN_PAIR_INTERVAL_FRAMES, _MIN_PAIR_INTERVAL_SHARE = 10, 0.005
_MIN_JUMP_M = 0.5  # a correction of the camera's position by as much is shown with the loop that makes it
_MATRIX_INTERVAL_FRAMES = 100  # between two pictures of the recogniser's matrix, whose cost grows with its size
_NO_PIXELS = np.empty((0, 2))


@contextmanager
def open_viewer(
    view: str, recording: Path | None, dataset: Dataset, run_id: str, warnings: RunWarnings
) -> Iterator[Viewer]:
    """Open the viewer of a run, and close it at the end; a recording that cannot be written is only a warning.

    Args:
        view: one of `VIEWS`.
        recording: file to record into; None for none.
        dataset: dataset to process.
        run_id: globally unique id (UUID) of the run.
        warnings: takes the warning.
    """
    viewer: Viewer = NullViewer()
    if view != "none" or recording is not None:
        from slam.viewer.rerun_viewer import RerunViewer

        mode = "record" if view == "none" else view
        viewer = RerunViewer(recording, dataset.camera, dataset.ground_truth, mode, run_id)  # type: ignore[arg-type]
    try:
        yield viewer
    finally:
        warnings.attempt_to("recording", viewer.close)


class RunVisualizer:
    """Shows each frame, the outcome of the loops proposed with it, and the recogniser's matrix in a viewer."""

    def __init__(self, slam: Slam, viewer: Viewer, dataset: Dataset, rows: MatrixRecorder) -> None:
        self._slam, self._viewer, self._dataset, self._rows = slam, viewer, dataset, rows
        self._last_pair = -_MIN_PAIR_INTERVAL_FRAMES
        self._T_world_previous: Array | None = None

    def restore(self, log: RunLog) -> None:
        """Show the state of a resumed run, without its images."""
        if log.timestamps:
            loops = [candidate for candidate in log.candidates if candidate.geometry is not None]
            self._viewer.restore(
                np.array(log.timestamps),
                np.array(log.odometry),
                self._slam.components.graph.poses(),
                [(candidate.belief.query, candidate.belief.match or 0, candidate.closed) for candidate in loops],
            )

    def show(self, result: FrameResult) -> dict[str, float]:
        """Show a frame and return the milliseconds it took, as the stage `viewer`."""
        start = time.perf_counter()
        self._viewer.show_frame(_frame_view(result))
        has_jumped = self._has_jumped(result)
        for candidate in result.candidates:
            if candidate.geometry is not None:
                self._show_loop(candidate, result, has_jumped)
        if result.frame.index % _MATRIX_INTERVAL_FRAMES == _MATRIX_INTERVAL_FRAMES - 1:
            self._viewer.show_matrix(self._rows.matrix(result.frame.index + 1))
        return {"viewer": 1000.0 * (time.perf_counter() - start)}

    def _has_jumped(self, result: FrameResult) -> bool:
        """Whether loops have moved the camera since the frame before; motion alone is no jump."""
        before, self._T_world_previous = self._T_world_previous, result.T_world_camera
        if before is None:
            return False
        expected = before @ result.motion.T_previous_current
        return bool(np.linalg.norm(result.T_world_camera[:3, 3] - expected[:3, 3]) >= _MIN_JUMP_M)

    def _show_loop(self, candidate: LoopCandidate, result: FrameResult, has_jumped: bool) -> None:
        interval = max(_MIN_PAIR_INTERVAL_FRAMES, _MIN_PAIR_INTERVAL_SHARE * result.frame.index)
        with_pair = candidate.closed and result.frame.index - self._last_pair >= interval
        if with_pair:
            self._last_pair = result.frame.index
        with_poses = with_pair or (candidate.closed and has_jumped)
        poses = self._slam.components.graph.poses() if with_poses else np.empty((0, 4, 4))
        self._viewer.show_loop(self._loop_view(candidate, result, with_pair), poses)

    def _loop_view(self, candidate: LoopCandidate, result: FrameResult, with_pair: bool) -> LoopView:
        geometry, belief = candidate.geometry, candidate.belief
        assert belief.match is not None
        closure = geometry if isinstance(geometry, LoopClosure) else None
        return LoopView(
            query=belief.query,
            match=belief.match,
            image_query=self._query_image(belief.query, result.frame) if with_pair else None,
            image_match=self._dataset.read_left(belief.match) if with_pair else None,
            pixels_query=_NO_PIXELS if closure is None else closure.pixels_query.astype(np.float64),
            pixels_match=_NO_PIXELS if closure is None else closure.pixels_match.astype(np.float64),
            accepted=candidate.closed,
            reason=candidate.reason,
        )

    def _query_image(self, query: int, frame: Frame) -> NDArray[np.uint8]:
        """Return the image of the query: the current one, unless the recogniser answers late."""
        return frame.left if query == frame.index else self._dataset.read_left(query)


def _frame_view(result: FrameResult) -> FrameView:
    beliefs = [candidate.belief for candidate in result.candidates]  # several at once, or none, where answers come late
    belief = max(beliefs, key=lambda belief: (belief.accepted, belief.score), default=None)
    is_known_place = bool(redundant_frames(result.candidates))
    return FrameView(
        index=result.frame.index,
        timestamp=result.frame.timestamp,
        image=result.frame.left,
        T_world_camera_odometry=result.T_world_camera_odometry,
        T_world_camera=result.T_world_camera,
        pixels_previous=result.motion.pixels_previous,
        pixels_current=result.motion.pixels_current,
        inliers=result.motion.inliers,
        predicted=result.motion.predicted,
        landmarks_world=None if is_known_place else _landmarks_world(result),
        stage_ms=result.stage_ms,
        score=belief.score if belief else 0.0,
        accepted=belief.accepted if belief else False,
        is_known_place=is_known_place,
    )


def _landmarks_world(result: FrameResult) -> Array | None:
    if not result.is_key_frame:
        return None
    return se3.transform(result.T_world_camera, result.landmarks.points.astype(np.float64))
