"""A drive once more, without its odometry: motions and landmarks come from the map that it has left."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from odometry.motion import Motion
from place_recognition.recognizer import RowSink
from slam.config import RunConfig
from slam.datasets.dataset import Frame
from slam.datasets.source import DatasetSpec
from slam.errors import DataError
from slam.loop_closing import Landmarks, LoopCloser, same_unit
from slam.loop_geometry import compare_units
from slam.map_store.resuming import Stopped
from slam.map_store.store import MapStore, map_file
from slam.parts import build_parts
from slam.system import Parts

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Build = Callable[[StereoCamera, RunConfig, RowSink | None], Parts]


class RememberedEyes:
    """Gives the motions of a map (Eyes); sees nothing itself."""

    odometry = None

    def __init__(self, motions: Sequence[Motion]) -> None:
        self._motions = motions

    def track(self, frame: Frame) -> Motion:
        """Motion since the previous frame, as it was measured then."""
        return self._motions[frame.index]

    def disparity(self, left: Image, right: Image | None, pixels: Array) -> Array:
        """Nothing is known of pixels."""
        return np.full(len(pixels), np.nan)


class RememberedLandmarks(LoopCloser):
    """Closes loops by the landmarks of a map."""

    def __init__(self, landmarks: Sequence[Landmarks], camera: StereoCamera, parts: Parts, config: RunConfig) -> None:
        compare = compare_units if config.mono else same_unit
        super().__init__(camera, parts.features, config.loop_closing, compare=compare)
        self._landmarks = landmarks

    def remember(self, index: int, left: Image, right: Image | None) -> Landmarks:
        """Landmarks of frame `index`, as they were found then."""
        self.recall(index, self._landmarks[index])
        return self._landmarks[index]


def read_drive(path: Path) -> Stopped:
    """The one drive of a map, in a file or in a run's folder.

    Raises:
        DataError: there is no map, it is damaged, or it holds several drives.
    """
    file = map_file(path)
    with MapStore.open(file) as store:
        sessions, frames = store.sessions(), store.images()
    if len(sessions) != 1:
        raise DataError(f"{file}: expected the map of one drive, found {len(sessions)}; reprocess each drive by itself")
    return Stopped(file, sessions[0], frames)


def source_of(path: Path) -> DatasetSpec:
    """The recording of which a map was made.

    Raises:
        DataError: as `read_drive`, or the map does not say.
    """
    drive = read_drive(path)
    try:
        return DatasetSpec.from_metrics(drive.session.provenance["recording"])
    except (KeyError, TypeError) as error:
        raise DataError(
            f"{drive.map_file}: expected the map to name its recording, found none; --source DIR"
        ) from error


def remembering(path: Path) -> Build:
    """Build parts that remember the drive of a map.

    Raises:
        DataError: it is damaged.
    """
    with MapStore.open(map_file(path)) as store:
        frames = list(store.frames())

    def build(camera: StereoCamera, config: RunConfig, rows: RowSink | None = None) -> Parts:
        parts = build_parts(camera, config, rows)
        return replace(
            parts,
            eyes=RememberedEyes([frame.motion for frame in frames]),
            loop_closer=RememberedLandmarks([frame.landmarks for frame in frames], camera, parts, config),
        )

    return build
