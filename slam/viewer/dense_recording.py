"""The dense map of a run as a second recording: opened together with the run's, both are one."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from odometry.camera import StereoCamera
from slam.errors import DataError, OutputError
from slam.mapping.fusion import Surface
from slam.report import colours
from slam.storage.atomic import replacing
from slam.viewer import shapes
from slam.viewer.blueprint import blueprint

Array = NDArray[np.float64]

_COLOURS = {"before": colours.ODOMETRY, "after": colours.CORRECTED}


@dataclass(frozen=True)
class PlacedMap:
    """A dense map where a trajectory puts it.

    Attributes:
        state: before or after.
        surfaces: metres, world frame.
        positions: (N, 3) metres, of the cameras.
    """

    state: str
    surfaces: Iterable[Surface]
    positions: Array


def record_dense_map(path: Path, run: Path, camera: StereoCamera, maps: Iterable[PlacedMap]) -> None:
    """Write maps into a recording that a viewer takes for more of the same run.

    Args:
        path: the file.
        run: recording of the run.
        camera: of its left images.
        maps: the last one tells the viewer where to look.

    Raises:
        DataError: `run` is no recording.
        OutputError: the file cannot be written.
    """
    with replacing(path) as temporary:
        temporary.touch()  # names what is wrong with the folder, which rerun does not
        recording = more_of(run)
        recording.set_sinks(rr.FileSink(str(temporary)))
        positions = np.empty((0, 3))
        for placed in maps:
            positions = placed.positions
            _log(recording, placed)
        recording.send_blueprint(blueprint(camera.width, camera.height, positions, dense=True))
        try:
            recording.flush(timeout_sec=60.0)
        except RuntimeError as error:
            raise OutputError(f"{path}: the recording is incomplete ({error}); make room") from error
        finally:
            recording.disconnect()


def more_of(path: Path) -> rr.RecordingStream:
    """A stream that a viewer takes for more of the recording in a file.

    Raises:
        DataError: the file holds none.
    """
    try:
        known = RrdReader(path).recordings()[0]
    except (OSError, ValueError, RuntimeError, IndexError) as error:
        raise DataError(f"{path}: expected a recording of the rerun viewer, {error}; make the run again") from error
    return rr.RecordingStream(known.application_id, recording_id=known.recording_id, send_properties=False)


def _log(recording: rr.RecordingStream, placed: PlacedMap) -> None:
    root = f"world/dense_{placed.state}"
    recording.log(f"{root}/way", shapes.line(_COLOURS[placed.state])(placed.positions), static=True)
    for number, surface in enumerate(placed.surfaces):
        if len(surface.triangles):
            recording.log(f"{root}/submap_{number:04d}", shapes.mesh(surface), static=True)
