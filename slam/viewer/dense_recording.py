"""The dense map of a run as a second recording, which rerun shows as part of the run's own recording."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from odometry.camera import StereoCamera
from slam.errors import DataError, OutputError
from slam.io.files import replacing
from slam.mapping.tsdf import Surface
from slam.report import colours
from slam.viewer import rerun_archetypes
from slam.viewer.rerun_archetypes import blueprint

Array = NDArray[np.float64]

_COLOURS = {"before": colours.ODOMETRY, "after": colours.CORRECTED}


@dataclass(frozen=True)
class PlacedMap:
    """A dense map in the world frame of one trajectory.

    Attributes:
        state: `before` or `after` correction.
        surfaces: surfaces of the submaps, metres, world frame.
        positions: camera positions, (N, 3), metres.
    """

    state: str
    surfaces: Iterable[Surface]
    positions: Array


def record_dense_map(path: Path, run: Path, camera: StereoCamera, maps: Iterable[PlacedMap]) -> None:
    """Write dense maps into a recording file that has the identity of a run's recording.

    Args:
        path: the file to write.
        run: the recording of the run.
        camera: camera of its left images.
        maps: dense maps; the positions of the last one set the viewpoint.

    Raises:
        DataError: `run` is not a recording.
        OutputError: the file cannot be written.
    """
    with replacing(path) as temporary:
        temporary.touch()  # gives the reason if the folder cannot be written, which rerun does not
        recording = continue_recording(run)
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


def continue_recording(path: Path) -> rr.RecordingStream:
    """Return a stream with the application and recording id of a file: viewers show both as one recording.

    Raises:
        DataError: the file is not a recording.
    """
    try:
        info = RrdReader(path).recordings()[0]
    except (OSError, ValueError, RuntimeError, IndexError) as error:
        raise DataError(f"{path}: expected a recording of the rerun viewer, {error}; make the run again") from error
    return rr.RecordingStream(info.application_id, recording_id=info.recording_id, send_properties=False)


def _log(recording: rr.RecordingStream, placed: PlacedMap) -> None:
    root = f"world/dense_{placed.state}"
    recording.log(f"{root}/path", rerun_archetypes.line_drawer(_COLOURS[placed.state])(placed.positions), static=True)
    for number, surface in enumerate(placed.surfaces):
        if len(surface.triangles):
            recording.log(f"{root}/submap_{number:04d}", rerun_archetypes.draw_mesh(surface), static=True)
