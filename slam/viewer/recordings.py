"""Recordings of a run: room on the disk, merging of the parts of a resumed run, the dense map as a second recording.

rerun's own sink writes the file. It must not fill the disk: the results of the run are written after it, and rerun
may wait for ever once its writer has failed on a full disk (docs/decisions/recordings.md). rerun shows the recording of
the dense map as part of the run's own recording.
"""

import logging
import shutil
import subprocess
import sys
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
from slam.report import style
from slam.viewer import rerun_archetypes
from slam.viewer.rerun_archetypes import blueprint

Array = NDArray[np.float64]

_LOG = logging.getLogger(__name__)

# Kept free for the results that are written at the end of the run: the report may take 25 MB, a map 27 bytes a point.
RESERVE_BYTES = 200_000_000
_MERGE_TIMEOUT_S = 600.0  # a recording of several gigabytes takes a minute
_COLOURS = {"before": style.ODOMETRY, "after": style.CORRECTED}


def has_room(recording: Path) -> bool:
    """Return whether the disk of a recording has more than the reserve left.

    Raises:
        OutputError: its folder is gone.
    """
    try:
        return shutil.disk_usage(recording.parent).free > RESERVE_BYTES
    except OSError as error:
        raise _unwritable(recording, error) from error


def rotate_recording(recording: Path) -> None:
    """Rename the recording of an earlier part of the run, so that a new one can be written.

    Raises:
        OutputError: the file cannot be written.
    """
    try:
        if recording.exists():
            number = len(_parts(recording))
            recording.rename(recording.with_name(f"{recording.stem}.part-{number:03d}{recording.suffix}"))
        recording.touch()  # gives the reason if the folder cannot be written, which rerun does not
    except OSError as error:
        raise _unwritable(recording, error) from error


def merge_recordings(recording: Path) -> None:
    """Merge the earlier parts of a recording into it; if that fails they stay, and can be opened together."""
    parts = _parts(recording)
    if not parts:
        return
    merged = recording.with_name(f".merged{recording.suffix}")
    command = [_rerun(), "rrd", "merge", "--continue-on-error", "-o", str(merged), *map(str, (*parts, recording))]
    try:
        subprocess.run(command, check=True, capture_output=True, timeout=_MERGE_TIMEOUT_S)
    except (OSError, subprocess.SubprocessError) as error:
        _LOG.warning("the parts of the recording were not merged (%s); open them together with: rerun *.rrd", error)
        merged.unlink(missing_ok=True)
        return
    merged.replace(recording)
    for part in parts:
        part.unlink()


def _parts(recording: Path) -> list[Path]:
    return sorted(recording.parent.glob(f"{recording.stem}.part-*{recording.suffix}"))


def _rerun() -> str:
    beside = Path(sys.executable).with_name("rerun")
    return str(beside) if beside.exists() else shutil.which("rerun") or "rerun"


def _unwritable(recording: Path, error: OSError) -> OutputError:
    return OutputError(f"{recording}: cannot write the recording ({error.strerror}); choose another folder")


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
            _log_map(recording, placed)
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


def _log_map(recording: rr.RecordingStream, placed: PlacedMap) -> None:
    root = f"world/dense_{placed.state}"
    recording.log(f"{root}/path", rerun_archetypes.line_drawer(_COLOURS[placed.state])(placed.positions), static=True)
    for number, surface in enumerate(placed.surfaces):
        if len(surface.triangles):
            recording.log(f"{root}/submap_{number:04d}", rerun_archetypes.draw_mesh(surface), static=True)
