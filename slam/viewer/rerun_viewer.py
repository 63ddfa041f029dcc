"""A run as a rerun recording: written to a file, watched in a window, or in a browser on this machine.

Entities: `world` (right, down, forward) with camera, tracks, trajectories, landmarks and loops; `loop` with
the image pair of the latest accepted loop; `places` with the recogniser's matrix; `plots`. Timelines: `frame`
and `time` (seconds since the first).
"""

import logging
from pathlib import Path
from typing import Literal

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from odometry.se3 import inverse
from place_recognition.evaluation.matrix import SimilarityMatrix
from slam.record import LoopRow, RunRecord
from slam.report import colours
from slam.report.alignment import anchored_truth, position_error
from slam.report.reading import kept, rejected, scaled
from slam.viewer import shapes
from slam.viewer.blueprint import blueprint
from slam.viewer.growing import Growing
from slam.viewer.listener import listen
from slam.viewer.recording_file import RecordingFile
from slam.viewer.viewer import ClosedLoop, Step

_LOG = logging.getLogger(__name__)

Array = NDArray[np.float64]
Mode = Literal["record", "native", "web"]

_LANDMARKS = 150  # drawn for a key frame while driving
_LINE_PART, _LANDMARKS_PART = 150, 1600
_CAMERA_SIZE = 0.04  # distance at which the image hangs before the camera, of the size of the drive
_CAMERA_LIMITS_M = (0.5, 4.0)
_FLUSH_S = 5.0  # a viewer that does not take the rest by then is gone


class RerunViewer:
    """Sends a run to rerun as it happens. Memory and file grow with the number of frames, not faster."""

    def __init__(
        self,
        path: Path | None,
        camera: StereoCamera,
        ground_truth: Array | None = None,
        mode: Mode = "record",
        run: str | None = None,
    ) -> None:
        """Open the recording.

        Args:
            path: the .rrd file to write; None for none.
            camera: of the left images.
            ground_truth: T_world_camera (N, 4, 4), metres, in any world frame, or None.
            mode: `record` writes the file only; `native` opens a window and `web` serves a page as well.
            run: names the run; what an earlier part of the same one has recorded in `path` stays in it.

        Raises:
            OutputError: the file cannot be written or no viewer starts.
        """
        self._recording = rr.RecordingStream("revisit", recording_id=run, send_properties=False)
        self._recording.set_log_time_enabled(False)
        self._recording.set_log_tick_enabled(False)
        truth = None if ground_truth is None else inverse(ground_truth[0]) @ ground_truth
        self._positions = None if truth is None else truth[:, :3, 3]
        self._listener = None if mode == "record" else listen(web=mode == "web")
        self._camera, self._file = camera, None if path is None else RecordingFile(path)
        self._connect()
        self._send_blueprint(self._positions)
        self._log_scenery()
        self._first_time: float | None = None
        self._odometry = Growing(self._recording, "world/odometry", shapes.line(colours.ODOMETRY), _LINE_PART)
        self._corrected = Growing(self._recording, "world/corrected", shapes.line(colours.CORRECTED), _LINE_PART)
        self._landmarks = Growing(self._recording, "world/landmarks", shapes.dots, _LANDMARKS_PART)
        self._loops: dict[bool, list[tuple[int, int]]] = {True: [], False: []}

    def recall(self, timestamps: Array, odometry: Array, poses: Array, loops: list[tuple[int, int, bool]]) -> None:
        """Show what was known when an earlier run stopped."""
        self._first_time = float(timestamps[0])
        self._set_time(len(timestamps) - 1, float(timestamps[-1]))
        self._odometry.replace(odometry[:, :3, 3])
        self._corrected.replace(poses[:, :3, 3])
        for query, match, closed in loops:
            self._loops[closed].append((query, match))
        self._log_loops(poses)

    def step(self, step: Step) -> None:
        """Show one frame."""
        self._set_time(step.index, step.timestamp)
        log, T = self._recording.log, step.T_world_camera
        log("world/camera", rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))
        log("world/camera/image", shapes.jpeg(step.image))
        log("world/camera/image/tracks", shapes.tracks(step))
        self._odometry.append(step.T_world_camera_odometry[None, :3, 3])
        self._corrected.append(T[None, :3, 3])
        if step.landmarks_world is not None:
            self._landmarks.append(shapes.some(step.landmarks_world, _LANDMARKS))
        self._log_curves(step)

    def loop(self, closed: ClosedLoop, poses: Array) -> None:
        """Show the fate of a proposed loop, and with poses the trajectory and all loops so far on it."""
        self._loops[closed.accepted].append((closed.query, closed.match))
        level = "INFO" if closed.accepted else "WARN"
        words = f"{'closed' if closed.accepted else 'rejected'} {closed.query} - {closed.match}: {closed.reason}"
        self._recording.log("loop/log", rr.TextLog(words, level=level))
        if len(poses):
            self._log_loops(poses)
            self._corrected.replace(poses[:, :3, 3])
        if closed.accepted:
            self._log_matched("loop/query", closed.image_query, closed.pixels_query)
            self._log_matched("loop/match", closed.image_match, closed.pixels_match)

    def matrix(self, matrix: SimilarityMatrix) -> None:
        """Show what the recogniser thinks of all pairs of images so far."""
        if len(matrix.values):
            self._recording.log("places/matrix", shapes.matrix(matrix))

    def finish(self, record: RunRecord) -> None:
        """Show the final trajectories, loops and maps, and the errors over the whole drive."""
        if not len(record.timestamps):
            return
        self._set_time(len(record.timestamps), float(record.timestamps[-1]))
        self._landmarks.clear()
        self._odometry.conclude(record.odometry[:, :3, 3])
        self._corrected.conclude(record.corrected[:, :3, 3])
        self._loops = {True: _pairs(kept(record)), False: _pairs(rejected(record))}
        self._log_loops(record.corrected)
        self._recording.log("world/map_before", shapes.cloud(record.map_before, colours.ODOMETRY))
        self._recording.log("world/map_after", shapes.cloud(record.map_after, "#ffffff"))
        self._log_errors(record)
        if self._listener is None:  # someone who watches has turned the eye to his liking
            self._send_blueprint(record.corrected[:, :3, 3])

    def close(self) -> None:
        """Write out what is pending; a web page's server ends with it, a window stays.

        Raises:
            OutputError: the file could not be written to the end, and is gone.
        """
        try:
            self._recording.flush(timeout_sec=_FLUSH_S)
        except RuntimeError:
            _LOG.warning("the viewer was closed before the run ended")
        finally:
            self._recording.disconnect()
            if self._listener is not None:
                self._listener.stop()
        if self._file is not None:
            self._file.close()

    def _connect(self) -> None:
        sinks: list[object] = []
        if self._file is not None:
            sinks.append(rr.FileSink(str(self._file.pipe)))
        if self._listener is not None:
            sinks.append(rr.GrpcSink(self._listener.address))
        if sinks:
            self._recording.set_sinks(*sinks)

    def _send_blueprint(self, positions: Array | None) -> None:
        self._recording.send_blueprint(blueprint(self._camera.width, self._camera.height, positions))

    def _log_scenery(self) -> None:
        log, camera = self._recording.log, self._camera
        log("world", rr.ViewCoordinates.RDF, static=True)
        pinhole = rr.Pinhole(
            image_from_camera=camera.K, resolution=[camera.width, camera.height],
            camera_xyz=rr.ViewCoordinates.RDF, image_plane_distance=self._camera_size(),
        )  # fmt: skip
        log("world/camera/image", pinhole, static=True)
        if self._positions is not None:
            log("world/ground_truth", shapes.dashes(self._positions), static=True)
        for path, colour in _CURVES.items():
            log(
                path,
                rr.SeriesLines(colors=colours.rgb(colour), widths=1.5, names=path.split("/")[-1]),
                static=True,
            )
        dots = rr.SeriesPoints(colors=colours.rgb(colours.ACCEPTED), marker_sizes=4.0, names="taken for a revisit")
        log("plots/score/accepted", dots, static=True)

    def _camera_size(self) -> float:
        if self._positions is None:
            return float(np.mean(_CAMERA_LIMITS_M))
        return float(np.clip(_CAMERA_SIZE * np.ptp(self._positions, axis=0).max(), *_CAMERA_LIMITS_M))

    def _set_time(self, index: int, timestamp: float) -> None:
        if self._first_time is None:
            self._first_time = timestamp
        self._recording.set_time("frame", sequence=index)
        self._recording.set_time("time", duration=timestamp - self._first_time)

    def _log_curves(self, step: Step) -> None:
        log = self._recording.log
        log("plots/inliers", rr.Scalars(float(np.count_nonzero(step.inliers))))
        for name, milliseconds in step.stage_ms.items():
            if np.isfinite(milliseconds):
                log(f"plots/stages/{rr.escape_entity_path_part(name)}", rr.Scalars(milliseconds))
        if np.isfinite(step.score):
            log("plots/score", rr.Scalars(step.score))
            if step.accepted:
                log("plots/score/accepted", rr.Scalars(step.score))

    def _log_loops(self, poses: Array) -> None:
        for accepted, name, colour in (
            (True, "accepted", colours.ACCEPTED),
            (False, "rejected", colours.REJECTED),
        ):
            arrows, ends = shapes.loops(self._loops[accepted], poses, colour)
            self._recording.log(f"world/loops/{name}", arrows)
            self._recording.log(f"world/loops/{name}/queries", ends)

    def _log_matched(self, path: str, image: NDArray[np.uint8] | None, pixels: Array) -> None:
        if image is not None:
            # half the size in each direction: a quarter of the bytes, and enough to judge a pair
            self._recording.log(path, shapes.jpeg(np.ascontiguousarray(image[::2, ::2])))
            self._recording.log(f"{path}/inliers", shapes.matches(pixels / 2))

    def _log_errors(self, record: RunRecord) -> None:
        truth = anchored_truth(record)
        if truth is None:
            return
        seconds = record.timestamps - record.timestamps[0]
        times = [
            rr.TimeColumn("frame", sequence=np.arange(len(seconds))),
            rr.TimeColumn("time", duration=seconds),
        ]
        for name in ("odometry", "online", "corrected"):
            error = position_error(getattr(record, name), truth, scaled(record.metrics, name))
            self._recording.send_columns(f"plots/error/{name}", times, rr.Scalars.columns(scalars=error))


_CURVES = {
    "plots/inliers": colours.CORRECTED,
    "plots/score": colours.ONLINE,
    "plots/error/odometry": colours.ODOMETRY,
    "plots/error/online": colours.ONLINE,
    "plots/error/corrected": colours.CORRECTED,
}


def _pairs(rows: list[LoopRow]) -> list[tuple[int, int]]:
    return [(row.query, row.match) for row in rows]
