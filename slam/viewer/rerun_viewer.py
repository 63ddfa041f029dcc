"""A run as a rerun recording: written to a file, watched in a window, or in a browser on this machine.

Entities: `world` (x right, y down, z forward) with camera, tracks, trajectories, landmarks and loops; `loop` with the
image pair of the latest accepted loop; `places` with the recogniser's matrix; `plots` with curves. Timelines: `frame`
and `time` (seconds since the first frame).
"""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from odometry.camera import StereoCamera
from odometry.se3 import inverse
from place_recognition.evaluation.similarity_matrix import SimilarityMatrix
from slam.errors import OutputError
from slam.report import style
from slam.report.formatting import is_scaled, kept, rejected
from slam.report.trajectory_figure import anchor_ground_truth, position_errors
from slam.run_result import LoopRow, RunRecord
from slam.viewer import rerun_archetypes
from slam.viewer.recordings import RESERVE_BYTES, has_room, merge_recordings, rotate_recording
from slam.viewer.rerun_archetypes import GrowingEntity, MovableLandmarks, blueprint
from slam.viewer.viewer import FrameView, LoopView
from slam.viewer.viewer_process import start_viewer

_LOG = logging.getLogger(__name__)

Array = NDArray[np.float64]
Mode = Literal["record", "native", "web"]

# Between two images recorded where the camera has been often enough: images are nine tenths of a recording.
_KNOWN_PLACE_INTERVAL_FRAMES = 5
_MAX_LANDMARKS = 150  # drawn of each key frame during the run
_MAX_LINE_ROWS, _MAX_LANDMARK_ROWS = 150, 1600  # of one part of a growing entity
_IMAGE_DISTANCE = 0.04  # of the drawn image from its camera, as a share of the extent of the path
_IMAGE_DISTANCE_LIMITS_M = (0.5, 4.0)
_VIEWER_FLUSH_S = 5.0  # a viewer that has not received the rest by then is closed
_FILE_FLUSH_S = 60.0  # a slow disk needs some time, a dead writer would keep us waiting for ever
_CURVES = {
    "plots/inliers": style.CORRECTED,
    "plots/score": style.ONLINE,
    "plots/error/odometry": style.ODOMETRY,
    "plots/error/online": style.ONLINE,
    "plots/error/corrected": style.CORRECTED,
}


class RerunViewer:
    """Sends a run to rerun while it happens. Memory and file grow linearly with the number of frames."""

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
            path: the .rrd file to write, or None to write no file.
            camera: camera of the left images.
            ground_truth: T_world_camera (N, 4, 4), metres, in any world frame, or None.
            mode: `record` writes the file only; `native` opens a window and `web` serves a page as well.
            run: unique name of the run; an earlier recording in `path` becomes its first part.

        Raises:
            OutputError: the file cannot be written or no viewer starts.
        """
        self._recording = rr.RecordingStream("revisit", recording_id=run, send_properties=False)
        self._recording.set_log_time_enabled(False)
        self._recording.set_log_tick_enabled(False)
        truth = None if ground_truth is None else inverse(ground_truth[0]) @ ground_truth
        self._positions = None if truth is None else truth[:, :3, 3]
        self._viewer = None if mode == "record" else start_viewer(web=mode == "web")
        if self._viewer is not None and self._viewer.page_url is not None:
            _LOG.warning("watch the run at %s", self._viewer.page_url)
        self._camera, self._path = camera, path
        self._open_file()
        self._send_blueprint(self._positions)
        self._log_scenery()
        self._first_time: float | None = None
        self._odometry = self._growing("world/odometry", rerun_archetypes.line_drawer(style.ODOMETRY), _MAX_LINE_ROWS)
        self._corrected = self._growing(
            "world/corrected", rerun_archetypes.line_drawer(style.CORRECTED), _MAX_LINE_ROWS
        )
        landmarks = self._growing("world/landmarks", rerun_archetypes.draw_landmarks, _MAX_LANDMARK_ROWS)
        self._landmarks = MovableLandmarks(landmarks)
        self._loops: dict[bool, list[tuple[int, int]]] = {True: [], False: []}

    def restore(self, timestamps: Array, odometry: Array, poses: Array, loops: list[tuple[int, int, bool]]) -> None:
        """Show the state of a resumed run: trajectories (N, 4, 4), metres, and loops (query, match, accepted)."""
        self._first_time = float(timestamps[0])
        self._set_time(len(timestamps) - 1, float(timestamps[-1]))
        self._odometry.replace(odometry[:, :3, 3])
        self._corrected.replace(poses[:, :3, 3])
        for query, match, closed in loops:
            self._loops[closed].append((query, match))
        self._log_loops(poses)

    def show_frame(self, view: FrameView) -> None:
        """Show one frame; the file ends here if the disk is short of room."""
        if self._path is not None and not has_room(self._path):
            self._close_file(f"{self._path.name}: it ends before frame {view.index}")
        self._set_time(view.index, view.timestamp)
        log, T = self._recording.log, view.T_world_camera
        log("world/camera", rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))
        if not view.is_known_place or self._viewer is not None or view.index % _KNOWN_PLACE_INTERVAL_FRAMES == 0:
            log("world/camera/image", rerun_archetypes.encode_jpeg(view.image))
            log("world/camera/image/tracks", rerun_archetypes.draw_tracks(view))
        self._odometry.append(view.T_world_camera_odometry[None, :3, 3])
        self._corrected.append(T[None, :3, 3])
        if view.landmarks_world is not None:
            self._landmarks.append(view.index, T, rerun_archetypes.subsample(view.landmarks_world, _MAX_LANDMARKS))
        self._log_curves(view)

    def show_loop(self, view: LoopView, poses: Array) -> None:
        """Show the outcome of a proposed loop; with poses also corrected trajectory, landmarks and all loops."""
        self._loops[view.accepted].append((view.query, view.match))
        level = "INFO" if view.accepted else "WARN"
        message = f"{'closed' if view.accepted else 'rejected'} {view.query} - {view.match}: {view.reason}"
        self._recording.log("loop/log", rr.TextLog(message, level=level))
        if len(poses):
            self._log_loops(poses)
            self._corrected.replace(poses[:, :3, 3])
            self._landmarks.correct(poses)
        if view.accepted:
            self._log_matched("loop/query", view.image_query, view.pixels_query)
            self._log_matched("loop/match", view.image_match, view.pixels_match)

    def show_matrix(self, matrix: SimilarityMatrix) -> None:
        """Show the similarity matrix of the recogniser."""
        if len(matrix.values):
            self._recording.log("places/matrix", rerun_archetypes.render_matrix(matrix))

    def finish(self, record: RunRecord) -> None:
        """Show the final trajectories, loops, maps and position errors."""
        if not len(record.timestamps):
            return
        self._set_time(len(record.timestamps), float(record.timestamps[-1]))
        self._landmarks.clear()
        self._odometry.conclude(record.odometry[:, :3, 3])
        self._corrected.conclude(record.corrected[:, :3, 3])
        self._loops = {True: _pairs(kept(record)), False: _pairs(rejected(record))}
        self._log_loops(record.corrected)
        self._recording.log("world/map_before", rerun_archetypes.draw_cloud(record.map_before, style.ODOMETRY))
        self._recording.log("world/map_after", rerun_archetypes.draw_cloud(record.map_after, "#ffffff"))
        self._log_errors(record)
        if self._viewer is None:  # whoever watches has chosen a viewpoint, which a new blueprint would reset
            self._send_blueprint(record.corrected[:, :3, 3])

    def close(self) -> None:
        """Write what is pending; a web server ends with it, a window stays open.

        Raises:
            OutputError: the file could not be written to its end and was removed.
        """
        try:
            # Never disconnect() alone: it waits without limit, and rerun may have lost its writer to a full disk.
            self._recording.flush(timeout_sec=_FILE_FLUSH_S if self._viewer is None else _VIEWER_FLUSH_S)
        except RuntimeError as error:
            self._give_up(error)
        finally:
            self._recording.disconnect()
            if self._viewer is not None:
                self._viewer.stop()
        if self._path is not None:
            merge_recordings(self._path)

    def _give_up(self, error: RuntimeError) -> None:
        """Handle a flush that failed: the viewer was closed, or the file cannot be written."""
        if self._viewer is not None:
            _LOG.warning("the viewer was closed before the run ended")
        elif self._path is not None:
            self._path.unlink(missing_ok=True)
            raise OutputError(
                f"{self._path.name}: expected room for the recording, found none; it is left out, make room"
            ) from error

    def _growing(self, path: str, draw: Callable[[Array], object], max_rows: int) -> GrowingEntity:
        return GrowingEntity(self._recording, path, draw, max_rows)

    def _open_file(self) -> None:
        if self._path is not None and not has_room(self._path):
            self._close_file(f"{self._path.name}: it is left out")
            return
        if self._path is not None:
            rotate_recording(self._path)
        self._connect()

    def _close_file(self, consequence: str) -> None:
        """End the file while there is room for its end, and continue without it."""
        _LOG.warning(
            "%s, as the disk has less than %.0f MB left for the results; make room", consequence, RESERVE_BYTES / 1e6
        )
        self._path = None
        self._connect()

    def _connect(self) -> None:
        sinks: list[object] = []
        if self._path is not None:
            sinks.append(rr.FileSink(str(self._path)))
        if self._viewer is not None:
            sinks.append(rr.GrpcSink(self._viewer.data_url))
        self._recording.set_sinks(*sinks)  # with none at all, what is logged is dropped

    def _send_blueprint(self, positions: Array | None) -> None:
        self._recording.send_blueprint(blueprint(self._camera.width, self._camera.height, positions))

    def _log_scenery(self) -> None:
        log, camera = self._recording.log, self._camera
        log("world", rr.ViewCoordinates.RDF, static=True)
        pinhole = rr.Pinhole(
            image_from_camera=camera.K, resolution=[camera.width, camera.height],
            camera_xyz=rr.ViewCoordinates.RDF, image_plane_distance=self._image_distance_m(),
        )  # fmt: skip
        log("world/camera/image", pinhole, static=True)
        if self._positions is not None:
            log("world/ground_truth", rerun_archetypes.draw_dashed_line(self._positions), static=True)
        for path, colour in _CURVES.items():
            log(
                path,
                rr.SeriesLines(colors=style.rgb(colour), widths=1.5, names=path.split("/")[-1]),
                static=True,
            )
        dots = rr.SeriesPoints(colors=style.rgb(style.ACCEPTED), marker_sizes=4.0, names="accepted as a revisit")
        log("plots/score/accepted", dots, static=True)

    def _image_distance_m(self) -> float:
        if self._positions is None:
            return float(np.mean(_IMAGE_DISTANCE_LIMITS_M))
        return float(np.clip(_IMAGE_DISTANCE * np.ptp(self._positions, axis=0).max(), *_IMAGE_DISTANCE_LIMITS_M))

    def _set_time(self, index: int, timestamp: float) -> None:
        if self._first_time is None:
            self._first_time = timestamp
        self._recording.set_time("frame", sequence=index)
        self._recording.set_time("time", duration=timestamp - self._first_time)

    def _log_curves(self, view: FrameView) -> None:
        log = self._recording.log
        log("plots/inliers", rr.Scalars(float(np.count_nonzero(view.inliers))))
        for name, milliseconds in view.stage_ms.items():
            if np.isfinite(milliseconds):
                log(f"plots/stages/{rr.escape_entity_path_part(name)}", rr.Scalars(milliseconds))
        if np.isfinite(view.score):
            log("plots/score", rr.Scalars(view.score))
            if view.accepted:
                log("plots/score/accepted", rr.Scalars(view.score))

    def _log_loops(self, poses: Array) -> None:
        for accepted, name, colour in (
            (True, "accepted", style.ACCEPTED),
            (False, "rejected", style.REJECTED),
        ):
            arrows, ends = rerun_archetypes.draw_loops(self._loops[accepted], poses, colour)
            self._recording.log(f"world/loops/{name}", arrows)
            self._recording.log(f"world/loops/{name}/queries", ends)

    def _log_matched(self, path: str, image: NDArray[np.uint8] | None, pixels: Array) -> None:
        if image is not None:
            # half the size in each direction: a quarter of the bytes, and enough to compare the two images
            self._recording.log(path, rerun_archetypes.encode_jpeg(np.ascontiguousarray(image[::2, ::2])))
            self._recording.log(f"{path}/inliers", rerun_archetypes.draw_matches(pixels / 2))

    def _log_errors(self, record: RunRecord) -> None:
        truth = anchor_ground_truth(record)
        if truth is None:
            return
        seconds = record.timestamps - record.timestamps[0]
        times = [
            rr.TimeColumn("frame", sequence=np.arange(len(seconds))),
            rr.TimeColumn("time", duration=seconds),
        ]
        for name in ("odometry", "online", "corrected"):
            error = position_errors(getattr(record, name), truth, is_scaled(record.metrics, name))
            self._recording.send_columns(f"plots/error/{name}", times, rr.Scalars.columns(scalars=error))


def _pairs(rows: list[LoopRow]) -> list[tuple[int, int]]:
    return [(row.query, row.match) for row in rows]
