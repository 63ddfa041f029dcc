"""Replay of a session without its odometry: motions and landmarks come from the map of an earlier run."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from odometry.motion import Motion
from place_recognition.image_processing.local_features import LocalFeatures
from place_recognition.recognizer import MatrixSink
from slam.components import build_components, build_loop_verifier
from slam.config import RunConfig
from slam.datasets.dataset import DatasetSpec, Frame
from slam.errors import DataError
from slam.loop_closing.loop_closer import FrameLandmarks, LoopCloser, LoopClosure, Rejection
from slam.map_database.database import MapDatabase, map_file
from slam.map_database.resume import ResumableRun
from slam.system import Components

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Build = Callable[[StereoCamera, RunConfig, MatrixSink | None], Components]


class ReplayedOdometry:
    """Replays the motions of a map (a VisualOdometry)."""

    calibration = None

    def __init__(self, motions: Sequence[Motion], has_metric_scale: bool) -> None:
        self._motions, self.has_metric_scale = motions, has_metric_scale

    def track(self, frame: Frame) -> Motion:
        """Motion since the previous frame, as the earlier run measured it."""
        return self._motions[frame.index]

    def disparity(self, left: Image, right: Image | None, pixels: Array) -> Array:
        """NaN for every pixel: the map has no depth images."""
        return np.full(len(pixels), np.nan)

    def array_bytes(self) -> int:
        """Zero: replayed motions are no memory of an odometry."""
        return 0

    def state(self) -> dict[str, Any]:
        """Empty: nothing changes from frame to frame."""
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        """Do nothing."""


class ReplayedLandmarks(LoopCloser):
    """Verifies loops by the landmarks of a map.

    Of a frame of a known place the map has a few landmarks alone: the loop that was found with all of them is taken as
    it is. Another match of the frame is verified by those few.
    """

    def __init__(
        self,
        landmarks: Sequence[FrameLandmarks],
        camera: StereoCamera,
        components: Components,
        config: RunConfig,
        loops: Mapping[tuple[int, int], LoopClosure] | None = None,
    ) -> None:
        super().__init__(camera, components.odometry, config.loop_closing)
        self._replayed, self._loops = landmarks, loops or {}
        self._max_known_landmarks = config.loop_closing.max_known_landmarks

    def extract_landmarks(
        self, index: int, features: LocalFeatures, left: Image, right: Image | None
    ) -> FrameLandmarks:
        """Landmarks of frame `index`, as the earlier run extracted them."""
        return self._replayed[index]

    def verify(self, query: int, match: int) -> LoopClosure | Rejection:
        """Relative pose of two frames by their landmarks, or as the map has it."""
        stored = self._loops.get((query, match))
        if stored is not None and len(self._replayed[query]) <= self._max_known_landmarks:
            return stored
        return super().verify(query, match)


def read_session(path: Path) -> ResumableRun:
    """The only session of a map, in a file or in a run's folder.

    Raises:
        DataError: there is no map, it is damaged, or it holds several sessions.
    """
    file = map_file(path)
    with MapDatabase.open(file) as store:
        sessions, frames = store.sessions(), store.images()
    if len(sessions) != 1:
        raise DataError(f"{file}: expected the map of one session, found {len(sessions)}; reprocess each by itself")
    return ResumableRun(file, sessions[0], frames)


def source_of(path: Path) -> DatasetSpec:
    """The dataset from which a map was made.

    Raises:
        DataError: as `read_session`, or the map does not name its dataset.
    """
    run = read_session(path)
    try:
        return DatasetSpec.from_metrics(run.session.provenance["recording"])
    except (KeyError, TypeError) as error:
        raise DataError(
            f"{run.map_file}: expected the map to name its recording, found none; name it with --source DIR"
        ) from error


def replay_components(path: Path) -> Build:
    """Build components that replay the motions and landmarks of a map with one session.

    Raises:
        DataError: the map is damaged.
    """
    with MapDatabase.open(map_file(path)) as store:
        frames = list(store.frames())
        geometries = [loop.geometry for loop in store.loops()]
    loops = {(loop.query, loop.match): loop for loop in geometries if isinstance(loop, LoopClosure)}

    def build(camera: StereoCamera, config: RunConfig, rows: MatrixSink | None = None) -> Components:
        odometry = ReplayedOdometry([frame.motion for frame in frames], has_metric_scale=not config.mono)
        components = replace(build_components(camera, config, rows), odometry=odometry)
        landmarks = [frame.landmarks for frame in frames]
        replayed = ReplayedLandmarks(landmarks, camera, components, config, loops)
        return replace(components, loop_closer=build_loop_verifier(replayed, config))

    return build
