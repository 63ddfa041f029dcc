"""The loop of Figure 4.1: odometry drifts, a recogniser proposes, geometry verifies, the graph corrects."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from odometry.motion import Motion
from odometry.stereo.stereo_self_calibration import Calibration
from place_recognition.image_processing.local_features import FeatureCache, LocalFeatures
from place_recognition.image_processing.static_regions import ImageMasks
from place_recognition.recognizer import Belief, ForgetfulRecognizer, PlaceRecognizer, can_forget, no_pixels
from slam.datasets.dataset import Frame
from slam.frame_record import FrameRecord, LoopRecord
from slam.keyframes import KeyFrameSelector, RevisitCounter
from slam.loop_closing.loop_closer import FrameLandmarks, LoopClosure, LoopVerification, Rejection
from slam.mapping.landmark_map import LandmarkMap
from slam.pose_graph.online_loop_selection import LoopDecision
from slam.pose_graph.pose_graph import PoseGraph
from slam.pose_graph.robust.backends import OptimizationResult
from slam.timing import StageTimer

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


class VisualOdometry(Protocol):
    """Measures the motion between frames, and the depth of pixels of the latest frame."""

    @property
    def has_metric_scale(self) -> bool:
        """Whether all frames have one unit of length; the scale of one camera drifts."""
        ...

    @property
    def calibration(self) -> Calibration | None:
        """Calibration error of a stereo pair as estimated so far; None where it is not estimated."""
        ...

    def track(self, frame: Frame) -> Motion:
        """Motion since the previous frame; always finite."""
        ...

    def disparity(self, left: Image, right: Image | None, pixels: Array) -> Array:
        """Disparity (N,), pixels, at pixels (N, 2) of the frame tracked last; NaN where it is unknown."""
        ...

    def array_bytes(self) -> int:
        """Memory of all arrays held, bytes."""
        ...

    def state(self) -> dict[str, Any]:
        """Everything that changes from frame to frame, for a checkpoint."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state of another odometry with the same configuration."""
        ...


class LoopVerifier(Protocol):
    """Keeps the landmarks of frames and verifies loops between them, as `slam.loop_closing.loop_closer` does."""

    def extract_landmarks(
        self, index: int, features: LocalFeatures, left: Image, right: Image | None
    ) -> FrameLandmarks:
        """Landmarks of the frame that the odometry has tracked last; keeps nothing, so that any thread may do it."""
        ...

    def add_frame(self, index: int, landmarks: FrameLandmarks) -> None:
        """Keep the landmarks of a frame."""
        ...

    def forget(self, index: int) -> None:
        """Keep no landmarks of a frame: it is matched with no other one any more."""
        ...

    def verify(self, query: int, match: int) -> LoopClosure | Rejection:
        """Relative pose of two frames, or why there is none."""
        ...


@dataclass(frozen=True)
class Components:
    """The interchangeable components of the system, built by `slam.components.build_components`."""

    odometry: VisualOdometry
    masks: ImageMasks
    features: FeatureCache
    recognizer: PlaceRecognizer
    loop_closer: LoopVerifier
    graph: PoseGraph
    key_frames: KeyFrameSelector
    landmarks: LandmarkMap


@dataclass(frozen=True)
class MeasuredFrame:
    """What the images of a frame alone say: the first half of `Slam.process`.

    Attributes:
        frame: the images, with mask and features.
        motion: motion since the previous frame.
        landmarks: features with depth, in the camera's frame.
        stage_ms: milliseconds by stage.
    """

    frame: Frame
    motion: Motion
    landmarks: FrameLandmarks
    stage_ms: dict[str, float]


@dataclass(frozen=True)
class LoopCandidate:
    """A belief of the recogniser, with its geometric verification and the decision of the pose graph.

    Attributes:
        belief: belief of the recogniser about one frame.
        geometry: the relative pose, or why there is none; None for a belief that was not accepted.
        admission: decision of the pose graph about the closure; None where there was no closure.
        is_redundant: whether the map has the place of the query often enough, and keeps of it pose and loop alone.
    """

    belief: Belief
    geometry: LoopVerification
    admission: LoopDecision | None
    is_redundant: bool = False

    @property
    def reason(self) -> str:
        """The decision so far and its reason; empty for a belief that was not accepted."""
        if self.admission is not None:
            return self.admission.reason
        return self.geometry.reason if isinstance(self.geometry, Rejection) else ""

    @property
    def closed(self) -> bool:
        """Whether the online graph has used the loop since it was proposed."""
        return self.admission is not None and self.admission.used


def redundant_frames(candidates: Iterable[LoopCandidate]) -> list[int]:
    """Frames whose place the map has often enough, of which it keeps pose and loop alone."""
    return [candidate.belief.query for candidate in candidates if candidate.is_redundant]


@dataclass(frozen=True)
class FrameResult:
    """Result of processing one frame.

    Attributes:
        frame: the images.
        motion: motion since the previous frame.
        T_world_camera_odometry: (4, 4) pose by odometry alone, metres.
        T_world_camera: (4, 4) online estimate, with the loops so far.
        landmarks: features with depth, in the camera's frame.
        is_key_frame: whether the frame is a key frame of the map: its landmarks are added to it.
        candidates: the beliefs that became ready with this frame, with their verification.
        stage_ms: milliseconds by stage.
    """

    frame: Frame
    motion: Motion
    T_world_camera_odometry: Array
    T_world_camera: Array
    landmarks: FrameLandmarks
    is_key_frame: bool
    candidates: tuple[LoopCandidate, ...]
    stage_ms: dict[str, float]


class Slam:
    """The SLAM system: processes frames one by one. Files, sessions, ground truth and viewers are outside of it."""

    def __init__(self, components: Components) -> None:
        self.components = components
        self.timer = StageTimer()
        self.measurement_timer = StageTimer()  # of its own: another thread may measure
        self._T_world_odometry = np.eye(4)
        self._distance_travelled_m = 0.0
        self._num_frames = 0
        self._revisits = RevisitCounter(components.key_frames.config.max_revisits)
        self._can_forget = can_forget(components.recognizer)

    def describe(self, frame: Frame) -> Frame:
        """Return the frame with its mask and its local features; every frame once, in order.

        Another thread may do this ahead of `process`.
        """
        return frame.with_features(self.components.features.extractor, self.components.masks)

    def process(self, frame: Frame) -> FrameResult:
        """Process the next frame of a dataset.

        Args:
            frame: the next frame: `frame.index` counts from 0 without gaps. Its features are extracted if it has none.
        """
        return self.update(self.measure(frame))

    def measure(self, frame: Frame) -> MeasuredFrame:
        """Measure the next frame: how the camera moved, and where its features lie; every frame once, in order.

        Odometry learns from frames alone, never from loops. So another thread may do this while `update` is busy with
        the frame before.
        """
        frame = self._describe(frame)
        motion = self._track(frame)
        landmarks = self._extract_landmarks(frame)
        return MeasuredFrame(frame, motion, landmarks, self.measurement_timer.lap())

    def update(self, measured: MeasuredFrame) -> FrameResult:
        """Add the next measured frame to graph and map, and close the loops that it shows."""
        self._add_measurement(measured)
        candidates = self._verify_all(self._recognize(measured.frame))
        is_key_frame = self._map(measured.frame.index, measured.landmarks)
        self._forget_redundant(candidates)
        with self.timer.stage("pose graph"):
            T_world_camera = self.components.graph.current_pose()
        return FrameResult(
            frame=measured.frame,
            motion=measured.motion,
            T_world_camera_odometry=self._T_world_odometry,
            T_world_camera=T_world_camera,
            landmarks=measured.landmarks,
            is_key_frame=is_key_frame,
            candidates=candidates,
            stage_ms=measured.stage_ms | self.timer.lap(),
        )

    def restore_frame(self, record: FrameRecord, loops: Iterable[LoopRecord]) -> tuple[LoopCandidate, ...]:
        """Restore the next frame of an earlier run from its record, without its images.

        Restores the pose graph, the landmarks and the loop closer. Odometry, recogniser and key frame selector are
        restored from a checkpoint.
        """
        self._advance(record.motion)
        self.components.loop_closer.add_frame(record.image, record.landmarks)
        candidates = tuple(self._add_to_graph(loop.belief, loop.geometry) for loop in loops)
        if record.is_key_frame:
            self._add_landmarks(record.image, record.landmarks)
        for query in redundant_frames(candidates):
            self._forget(query)
        return candidates

    def finish(self, robust: str) -> tuple[tuple[LoopCandidate, ...], OptimizationResult]:
        """Process the late beliefs of the recogniser, then optimise everything with a robust back end."""
        return self.verify_late_beliefs(), self.components.graph.optimize(robust)

    def verify_late_beliefs(self) -> tuple[LoopCandidate, ...]:
        """Process the beliefs with which the recogniser was waiting for more images; once, after the last frame.

        Their frames are kept in full: the checkpoint from which a resumed run or a later session goes on knows nothing
        of these beliefs.
        """
        return self._verify_all(self.components.recognizer.finish())

    def _advance(self, motion: Motion) -> None:
        if self._num_frames:
            self._T_world_odometry = self._T_world_odometry @ motion.T_previous_current
            self._distance_travelled_m += float(np.linalg.norm(motion.T_previous_current[:3, 3]))
            with self.timer.stage("pose graph"):
                self.components.graph.add_odometry(motion.T_previous_current, motion.covariance)
        self._num_frames += 1

    def _describe(self, frame: Frame) -> Frame:
        with self.measurement_timer.stage("features"):
            return self.describe(frame)

    def _track(self, frame: Frame) -> Motion:
        with self.measurement_timer.stage("odometry"):
            return self.components.odometry.track(frame)

    def _extract_landmarks(self, frame: Frame) -> FrameLandmarks:
        assert frame.features is not None
        with self.measurement_timer.stage("landmarks"):
            return self.components.loop_closer.extract_landmarks(frame.index, frame.features, frame.left, frame.right)

    def _add_measurement(self, measured: MeasuredFrame) -> None:
        """Let the parts that remember frames have the next one."""
        frame = measured.frame
        assert frame.features is not None
        self.components.features.put(frame.index, frame.features)
        if frame.mask is not None:
            self.components.masks.confirm(frame.mask)
        self._advance(measured.motion)
        self.components.loop_closer.add_frame(frame.index, measured.landmarks)

    def _recognize(self, frame: Frame) -> list[Belief]:
        with self.timer.stage("place recognition"):
            image = frame.left if frame.color is None else frame.color
            return self.components.recognizer.observe(frame.index, image, self._distance_travelled_m)

    def _verify_all(self, beliefs: Iterable[Belief]) -> tuple[LoopCandidate, ...]:
        return tuple(self._verify(belief) for belief in beliefs)

    def _verify(self, belief: Belief) -> LoopCandidate:
        if belief.match is None or not belief.accepted:
            return LoopCandidate(belief, None, None)
        with self.timer.stage("loop closing"):
            geometry = self.components.loop_closer.verify(belief.query, belief.match)
        return self._add_to_graph(belief, geometry)

    def _add_to_graph(self, belief: Belief, geometry: LoopVerification) -> LoopCandidate:
        if not isinstance(geometry, LoopClosure):
            return LoopCandidate(belief, geometry, None)
        with self.timer.stage("pose graph"):
            admission = self.components.graph.add_loop(geometry)
        # A recogniser that cannot forget may match any frame later, and then it needs all that is known of it.
        is_tied = self._can_forget and admission.used
        is_redundant = is_tied and self._revisits.add(geometry.query, geometry.match)
        if is_redundant:  # the pixels of the relative pose suffice
            belief = replace(belief, pixels=no_pixels())
        return LoopCandidate(belief, geometry, admission, is_redundant)

    def _forget_redundant(self, candidates: Iterable[LoopCandidate]) -> None:
        for query in redundant_frames(candidates):
            self._forget(query)
            assert isinstance(self.components.recognizer, ForgetfulRecognizer)
            self.components.recognizer.forget(query)

    def _forget(self, index: int) -> None:
        """Leave a frame out of the map."""
        self.components.landmarks.remove(index)
        self.components.loop_closer.forget(index)

    def _map(self, index: int, landmarks: FrameLandmarks) -> bool:
        is_key_frame = self.components.key_frames.accepts(self._T_world_odometry)
        if is_key_frame:
            self._add_landmarks(index, landmarks)
        return is_key_frame

    def _add_landmarks(self, index: int, landmarks: FrameLandmarks) -> None:
        self.components.landmarks.add(index, landmarks.points.astype(np.float64), landmarks.grey)
