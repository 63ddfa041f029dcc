"""The viewer protocol, the views of frames and loops that a run sends, and the viewer that shows nothing."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.similarity_matrix import SimilarityMatrix
from slam.run_result import RunRecord

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FrameView:
    """Contents of one frame for a viewer.

    Attributes:
        index: index of the frame, from 0.
        timestamp: time, seconds.
        image: left image, (H, W) uint8.
        T_world_camera_odometry: pose by odometry alone, (4, 4), metres.
        T_world_camera: pose of the online estimate, (4, 4), metres.
        pixels_previous, pixels_current: tracks in the previous and in this left image, (N, 2), pixels.
        inliers: tracks that agree with the motion, (N,) bool.
        predicted: whether the motion was extrapolated instead of measured.
        landmarks_world: landmarks of a new key frame by the online estimate, (M, 3), metres; else None.
        stage_ms: milliseconds of each stage that ran.
        score: latest score of the recogniser, on its own scale.
        accepted: whether the recogniser accepted its latest match as a revisit.
        is_known_place: whether the map has the place that the camera has just passed often enough.
    """

    index: int
    timestamp: float
    image: NDArray[np.uint8]
    T_world_camera_odometry: Array
    T_world_camera: Array
    pixels_previous: Array
    pixels_current: Array
    inliers: NDArray[np.bool_]
    predicted: bool
    landmarks_world: Array | None
    stage_ms: dict[str, float]
    score: float
    accepted: bool
    is_known_place: bool = False


@dataclass(frozen=True)
class LoopView:
    """Contents of a proposed loop, closed or rejected, for a viewer.

    Attributes:
        query, match: frame indices.
        image_query, image_match: left images, (H, W) uint8; None if they are not shown.
        pixels_query, pixels_match: matches that agree with the relative pose, (K, 2), pixels.
        accepted: whether geometry and back end accepted the loop.
        reason: explanation of the decision, in words.
    """

    query: int
    match: int
    image_query: NDArray[np.uint8] | None
    image_match: NDArray[np.uint8] | None
    pixels_query: Array
    pixels_match: Array
    accepted: bool
    reason: str


class Viewer(Protocol):
    """Shows a run. It never changes what the run computes."""

    def restore(self, timestamps: Array, odometry: Array, poses: Array, loops: list[tuple[int, int, bool]]) -> None:
        """Show the state in which a resumed run was stopped; called before the first frame.

        Args:
            timestamps: times of its frames, (N,), seconds.
            odometry: T_world_camera by odometry alone, (N, 4, 4), metres.
            poses: T_world_camera of the online estimate, (N, 4, 4), metres.
            loops: query, match, and whether the loop was closed.
        """
        ...

    def show_frame(self, view: FrameView) -> None:
        """Show one frame; frames come in order."""
        ...

    def show_loop(self, view: LoopView, poses: Array) -> None:
        """Show the outcome of a proposed loop, and the online trajectory (N, 4, 4), metres, after it.

        Poses (0, 4, 4) leave the trajectory as it is shown: copying a long one for every loop costs too much.
        """
        ...

    def show_matrix(self, matrix: SimilarityMatrix) -> None:
        """Show the similarity matrix of the recogniser: query by earlier image."""
        ...

    def finish(self, record: RunRecord) -> None:
        """Show the end of the run: final trajectories, maps and errors."""
        ...

    def close(self) -> None:
        """Write what is pending and close files and connections; called once, also after an error."""
        ...


class NullViewer:
    """Shows nothing."""

    def restore(self, timestamps: Array, odometry: Array, poses: Array, loops: list[tuple[int, int, bool]]) -> None:
        """Do nothing."""

    def show_frame(self, view: FrameView) -> None:
        """Do nothing."""

    def show_loop(self, view: LoopView, poses: Array) -> None:
        """Do nothing."""

    def show_matrix(self, matrix: SimilarityMatrix) -> None:
        """Do nothing."""

    def finish(self, record: RunRecord) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""
