"""What a run shows while it drives, and the viewer that shows nothing."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.matrix import SimilarityMatrix
from slam.record import RunRecord

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Step:
    """One frame of the chain, as far as a viewer may show it.

    Attributes:
        index: frame, from 0.
        timestamp: seconds.
        image: (H, W) uint8, left camera.
        T_world_camera_odometry: (4, 4) by odometry alone, metres.
        T_world_camera: (4, 4) the online estimate, metres.
        pixels_previous, pixels_current: (N, 2) tracks in the previous and this left image, pixels.
        inliers: (N,) bool, tracks that agree with the motion.
        predicted: the motion was extrapolated.
        landmarks_world: (M, 3) landmarks of a new key frame, online estimate, metres; else None.
        stage_ms: milliseconds of each stage that ran.
        score: the recogniser's latest, on its own scale.
        accepted: whether the recogniser takes that for a revisit.
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


@dataclass(frozen=True)
class ClosedLoop:
    """A match that the recogniser proposed, and what became of it.

    Attributes:
        query, match: frame indices.
        image_query, image_match: (H, W) uint8; None where an image is no longer at hand.
        pixels_query, pixels_match: (K, 2) matches that agree with the relative pose, pixels.
        accepted: geometry and back end took it for a loop.
        reason: the verdict in plain words.
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

    def recall(self, timestamps: Array, odometry: Array, poses: Array, loops: list[tuple[int, int, bool]]) -> None:
        """Show what was known when an earlier run stopped that is now gone on with; called before the first step.

        Args:
            timestamps: (N,) seconds.
            odometry: T_world_camera (N, 4, 4) by odometry alone, metres.
            poses: (N, 4, 4) by all that was known.
            loops: query, match, and whether it was closed.
        """
        ...

    def step(self, step: Step) -> None:
        """Show one frame; frames come in order."""
        ...

    def loop(self, closed: ClosedLoop, poses: Array) -> None:
        """Show the fate of a proposed loop, and the online trajectory (N, 4, 4), metres, after it.

        Poses (0, 4, 4) leave the trajectory as it is shown: to copy a long one for every loop is dear.
        """
        ...

    def matrix(self, matrix: SimilarityMatrix) -> None:
        """Show what the recogniser thinks of all pairs of images so far."""
        ...

    def finish(self, record: RunRecord) -> None:
        """Show the end of the drive: final trajectories, maps and errors."""
        ...

    def close(self) -> None:
        """Write out what is pending and let go of files and connections; called once, also after an error."""
        ...


class NullViewer:
    """Shows nothing."""

    def recall(self, timestamps: Array, odometry: Array, poses: Array, loops: list[tuple[int, int, bool]]) -> None:
        """Do nothing."""

    def step(self, step: Step) -> None:
        """Do nothing."""

    def loop(self, closed: ClosedLoop, poses: Array) -> None:
        """Do nothing."""

    def matrix(self, matrix: SimilarityMatrix) -> None:
        """Do nothing."""

    def finish(self, record: RunRecord) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""
