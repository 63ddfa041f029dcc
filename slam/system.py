"""The loop of Figure 4.1: odometry drifts, a recogniser proposes, geometry proves, the graph corrects."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from odometry.motion import Motion
from place_recognition.image_processing.features import LocalFeatures, SharedFeatures
from place_recognition.recognizer import Belief, PlaceRecognizer
from slam.clock import StageClock
from slam.datasets.dataset import Frame
from slam.eyes import Eyes
from slam.keyframes import KeyFrameSelector
from slam.loop_closing import FrameLandmarks, LoopCloser, LoopClosure, LoopVerification, Rejection
from slam.loop_trust import LoopDecision
from slam.map_store.rows import StoredAttempt, StoredFrame
from slam.mapping.landmarks import LandmarkMap
from slam.pose_graph import PoseGraph
from slam.robust import OptimizationResult

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parts:
    """The interchangeable parts of the system."""

    eyes: Eyes
    features: SharedFeatures
    recognizer: PlaceRecognizer
    loop_closer: LoopCloser
    graph: PoseGraph
    key_frames: KeyFrameSelector
    landmarks: LandmarkMap


@dataclass(frozen=True)
class LoopAttempt:
    """What became of one belief.

    Attributes:
        belief: what the recogniser thought; images before the drive's first one, of earlier drives through the same
            map, have negative numbers.
        geometry: the relative pose, or why there is none; None for a belief that was not accepted.
        admission: what the graph said of the closure; None where there was no closure.
    """

    belief: Belief
    geometry: LoopVerification
    admission: LoopDecision | None

    @property
    def reason(self) -> str:
        """The verdict so far, in plain words; empty for a belief that was not accepted."""
        if self.admission is not None:
            return self.admission.reason
        if isinstance(self.geometry, LoopClosure):
            return "a place of the map"
        return self.geometry.reason if isinstance(self.geometry, Rejection) else ""

    @property
    def elsewhere(self) -> bool:
        """Whether the match is an image of an earlier drive."""
        return self.belief.match is not None and self.belief.match < 0

    @property
    def closed(self) -> bool:
        """Whether the online map leaned on the loop from that moment."""
        return self.admission is not None and self.admission.used


@dataclass(frozen=True)
class Processed:
    """What the system knows the moment a frame has been processed.

    Attributes:
        frame: the images.
        motion: since the previous frame.
        T_world_camera_odometry: (4, 4) by odometry alone, metres.
        T_world_camera: (4, 4) online estimate, loops so far included.
        landmarks: what was seen with depth, in the camera's frame.
        is_key_frame: whether the landmarks joined the map.
        attempts: the beliefs that became ready, and what came of them.
        stage_ms: milliseconds by stage.
    """

    frame: Frame
    motion: Motion
    T_world_camera_odometry: Array
    T_world_camera: Array
    landmarks: FrameLandmarks
    is_key_frame: bool
    attempts: tuple[LoopAttempt, ...]
    stage_ms: dict[str, float]


@dataclass(frozen=True)
class Beginning:
    """Where a drive begins for parts that have seen others before it.

    Attributes:
        image: number of its first image.
        travelled: way driven before it, metres, so much larger than it was that no place seen before is near.
    """

    image: int = 0
    travelled: float = 0.0


class Slam:
    """Takes frames one by one; knows no files, no ground truth and no viewer."""

    def __init__(self, parts: Parts, beginning: Beginning | None = None) -> None:
        beginning = beginning or Beginning()
        self.parts = parts
        self.clock = StageClock()
        self._first = beginning.image
        self._T_world_odometry = np.eye(4)
        self._travelled = beginning.travelled
        self._frames = 0

    def process(self, frame: Frame, features: LocalFeatures | None = None) -> Processed:
        """Process the next frame of a drive.

        Args:
            frame: `frame.index` counts from 0 without gaps.
            features: of the left image, by `parts.features.extractor`; None to find them here.
        """
        motion = self._move(frame)
        landmarks = self._look(frame, features)
        beliefs = self._recognise(frame)
        attempts = self._close_all(beliefs)
        is_key_frame = self._map(frame.index, landmarks)
        with self.clock.stage("pose graph"):
            T_world_camera = self.parts.graph.current_pose()
        return Processed(
            frame,
            motion,
            self._T_world_odometry,
            T_world_camera,
            landmarks,
            is_key_frame,
            attempts,
            self.clock.lap(),
        )

    def recall(self, frame: StoredFrame, attempts: Iterable[StoredAttempt]) -> tuple[LoopAttempt, ...]:
        """Take over what was found out about the next frame before; no image is looked at.

        Graph and map become what they were. Odometry and recogniser do not: they go on where a checkpoint has
        left them.
        """
        self._advance(frame.motion)
        self.parts.loop_closer.restore_frame(frame.image, frame.landmarks)
        recalled = tuple(self._enter(attempt.belief, attempt.geometry) for attempt in attempts)
        if frame.key_frame:
            self._draw(frame.image - self._first, frame.landmarks)
        return recalled

    def finish(self, robust: str) -> tuple[tuple[LoopAttempt, ...], OptimizationResult]:
        """End the drive: answer the beliefs still open, then optimise everything with the named robust back end."""
        attempts = self._close_all(self.parts.recognizer.finish())
        return attempts, self.parts.graph.optimize(robust)

    def _move(self, frame: Frame) -> Motion:
        with self.clock.stage("odometry"):
            motion = self.parts.eyes.track(frame)
        self._advance(motion)
        return motion

    def _advance(self, motion: Motion) -> None:
        if self._frames:
            self._T_world_odometry = self._T_world_odometry @ motion.T_previous_current
            self._travelled += float(np.linalg.norm(motion.T_previous_current[:3, 3]))
            with self.clock.stage("pose graph"):
                self.parts.graph.add_odometry(motion.T_previous_current, motion.covariance)
        self._frames += 1

    def _look(self, frame: Frame, features: LocalFeatures | None) -> FrameLandmarks:
        image = self._first + frame.index
        if features is not None:
            self.parts.features.give(image, features)
        with self.clock.stage("features"):
            self.parts.features.of(image, frame.left)
        with self.clock.stage("landmarks"):
            return self.parts.loop_closer.add_frame(image, frame.left, frame.right)

    def _recognise(self, frame: Frame) -> list[Belief]:
        with self.clock.stage("place recognition"):
            return self.parts.recognizer.observe(self._first + frame.index, frame.left, self._travelled)

    def _close_all(self, beliefs: Iterable[Belief]) -> tuple[LoopAttempt, ...]:
        """Try the beliefs about images of this drive; the last ones of the drive before come late."""
        return tuple(self._close(belief) for belief in beliefs if belief.query >= self._first)

    def _close(self, belief: Belief) -> LoopAttempt:
        if belief.match is None or not belief.accepted:
            return self._enter(belief, None)
        with self.clock.stage("loop closing"):
            geometry = self.parts.loop_closer.verify(belief.query, belief.match)
        return self._enter(belief, geometry)

    def _enter(self, belief: Belief, geometry: LoopVerification) -> LoopAttempt:
        """Enter a loop within this drive into its graph; images are counted from its first one from here on."""
        belief = replace(belief, query=belief.query - self._first, match=self._counted(belief.match))
        if not isinstance(geometry, LoopClosure):
            return LoopAttempt(belief, geometry, None)
        geometry = replace(geometry, query=geometry.query - self._first, match=geometry.match - self._first)
        if geometry.match < 0:
            return LoopAttempt(belief, geometry, None)
        with self.clock.stage("pose graph"):
            return LoopAttempt(belief, geometry, self.parts.graph.add_loop(geometry))

    def _counted(self, image: int | None) -> int | None:
        return None if image is None else image - self._first

    def _map(self, index: int, landmarks: FrameLandmarks) -> bool:
        is_key_frame = self.parts.key_frames.accepts(self._T_world_odometry)
        if is_key_frame:
            self._draw(index, landmarks)
        return is_key_frame

    def _draw(self, index: int, landmarks: FrameLandmarks) -> None:
        self.parts.landmarks.add(index, landmarks.points.astype(np.float64), landmarks.grey)
