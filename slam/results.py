"""From a finished drive to its record, and from the record to the files of a run."""

import dataclasses
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from odometry.stereo import StereoOdometry
from place_recognition.evaluation.map_size import map_size
from place_recognition.evaluation.matrix import MatrixRows
from slam.clock import timing_ms
from slam.config import RunConfig, to_toml
from slam.datasets.dataset import Dataset
from slam.drive_log import DriveLog
from slam.errors import DataError
from slam.evaluation.loops import LoopCounts, count_loops, is_same_place, is_true_loop, revisit_matrix
from slam.evaluation.trajectory import (
    Alignment,
    TrajectoryErrors,
    path_length,
    trajectory_errors,
    umeyama,
    unknown_errors,
)
from slam.ledger import Judge, matched_pixels, stage_rows, write_ledger
from slam.loop_closing import LoopClosure
from slam.map_store.ending import Met
from slam.memory import UNKNOWN, held_mb
from slam.place_metrics import PlaceResult, judge_places
from slam.provenance import peak_memory_mb
from slam.record import DriveRecord
from slam.report.figures import draw_before_after, save_png
from slam.report.page import DENSE_PAGE, write_report
from slam.robust import Optimized
from slam.storage.atomic import atomic_writer
from slam.storage.calibration import write_calibration
from slam.storage.covariances import write_covariances
from slam.storage.g2o import chain_graph, write_g2o
from slam.storage.landmarks import write_landmark_observers
from slam.storage.metrics import write_metrics
from slam.storage.tables import write_frames, write_loops, write_stages
from slam.storage.trajectory import write_kitti, write_tum
from slam.system import Slam

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Finished:
    """A drive that has ended.

    Attributes:
        drive: the recording.
        config: the settings.
        slam: the system, with its graph and landmarks.
        drive_log: what it said of each frame.
        rows: the recogniser's matrix.
        optimized: the final trajectory and the verdicts on the loops.
        interrupted: stopped by the user.
        wall_seconds: from the first frame to the end of the final optimisation.
        behind: frames that an earlier run had driven, which this one has gone on with.
        met: what the drive has to do with others in its map; None where there are none.
    """

    drive: Dataset
    config: RunConfig
    slam: Slam
    drive_log: DriveLog
    rows: MatrixRows
    optimized: Optimized
    interrupted: bool
    wall_seconds: float
    behind: int = 0
    met: Met | None = None

    @property
    def alignment(self) -> Alignment:
        """How trajectories are compared with ground truth: one camera does not know how long a metre is."""
        return "sim3" if self.config.mono else "se3"


def make_record(finished: Finished, provenance: dict[str, object]) -> DriveRecord:
    """Gather everything known about the drive, compared with ground truth where there is one."""
    drive, log, optimized = finished.drive, finished.drive_log, finished.optimized
    table, landmarks, graph = log.table(), finished.slam.parts.landmarks, finished.slam.parts.graph
    truth = None if drive.ground_truth is None else drive.ground_truth[: len(table)]
    metres = None if truth is None else _metres(optimized, truth, finished.alignment)
    odometry = np.array(log.odometry)
    places = _places(finished, truth)
    record = DriveRecord(
        name=f"{Path(str(provenance['source'])).resolve().name} {drive.name}",
        timestamps=table.timestamps,
        odometry=odometry,
        online=np.array(log.online),
        corrected=optimized.poses,
        ground_truth=truth,
        predicted=table.predicted,
        inliers=table.inliers,
        loops=write_ledger(log.attempts, optimized, judge_by(truth, metres)),
        stage_ms=dict(table.stage_ms),
        map_before=landmarks.cloud(odometry),
        map_after=landmarks.cloud(optimized.similarities),
        metrics={},
        stages=stage_rows(log.attempts, graph.gates, graph.history),
        matched=matched_pixels(log.attempts),
        curve=places.curve,
        matrices={stage: finished.rows.matrix(len(table), stage) for stage in finished.rows.stages},
        odometry_covariances=graph.odometry_covariances(),
        corrected_covariances=graph.covariances(optimized),
    )
    record.metrics.update(provenance | _measured(record, finished, places))
    return record


def _metres(optimized: Optimized, truth: Array, alignment: Alignment) -> Array:
    """Length (N,), metres, of the unit of each frame, by the ground truth (N, 4, 4)."""
    fit = umeyama(optimized.poses[:, :3, 3], truth[:, :3, 3], alignment)
    return fit.scale * optimized.lengths


def judge_by(truth: Array | None, metres: Array | None) -> Judge:
    """Tell true revisits from false ones by ground truth (N, 4, 4) and the units (N,) of frames, or not at all."""

    def judge(query: int, match: int, closure: LoopClosure | None) -> bool | None:
        if truth is None or metres is None:
            return None
        if closure is None:
            return is_same_place(truth, query, match)
        T_match_query = closure.T_match_query.copy()
        T_match_query[:3, 3] *= metres[match]
        return is_true_loop(truth, query, match, T_match_query)

    return judge


def write_results(folder: Path, record: DriveRecord, finished: Finished) -> None:
    """Write every file of a run into a folder."""
    config, drive = finished.config, finished.drive
    write_metrics(folder / "metrics.json", record.metrics)
    with atomic_writer(folder / "config.toml") as file:
        file.write(to_toml(config))
    for name in ("odometry", "online", "corrected"):
        poses = getattr(record, name)
        write_kitti(folder / f"trajectory_{name}.txt", poses)
        write_tum(folder / f"trajectory_{name}.tum", record.timestamps, poses)
    if finished.met is not None and finished.met.joined:
        in_map = finished.met.T_map_session @ record.corrected
        write_kitti(folder / "trajectory_map.txt", in_map)
        write_tum(folder / "trajectory_map.tum", record.timestamps, in_map)
    write_frames(folder / "frames.csv", finished.drive_log.table())
    write_loops(folder / "loops.csv", record.loops)
    write_stages(folder / "loop_stages.csv", record.stages)
    write_covariances(folder / "covariances.npz", record)
    _write_calibration(folder, finished)
    _write_graphs(folder, record, finished)
    _write_maps(folder, record)
    write_landmark_observers(folder / "landmarks.npz", finished.slam.parts.landmarks.frames, drive.camera)
    save_png(draw_before_after(record), folder / "before_after.png")
    dense_page = None if config.mono else DENSE_PAGE
    write_report(record, folder / "report.html", partial(_left_image, drive), dataclasses.asdict(config), dense_page)


def _left_image(drive: Dataset, index: int) -> NDArray[np.uint8] | None:
    """The left image of a frame; None where it can no longer be read, which is no reason to lose the run."""
    try:
        return drive[index].left
    except DataError:
        return None


def _write_calibration(folder: Path, finished: Finished) -> None:
    odometry = finished.slam.parts.eyes.odometry
    if isinstance(odometry, StereoOdometry):  # others learn none
        write_calibration(folder / "calibration.toml", odometry.calibration)


def _write_graphs(folder: Path, record: DriveRecord, finished: Finished) -> None:
    graph, optimized = finished.slam.parts.graph, finished.optimized
    motions, loops = graph.levelled(optimized.lengths)
    closed = [loop for loop, keep in zip(loops, optimized.kept, strict=True) if keep]
    write_g2o(folder / "pose_graph_before.g2o", chain_graph(record.odometry, graph.odometry, graph.loops))
    write_g2o(folder / "pose_graph_after.g2o", chain_graph(record.corrected, motions, closed))


def _write_maps(folder: Path, record: DriveRecord) -> None:
    from slam.mapping.ply import write_cloud

    write_cloud(folder / "map_before.ply", record.map_before)
    write_cloud(folder / "map_after.ply", record.map_after)


def _measured(record: DriveRecord, finished: Finished, places: PlaceResult) -> dict[str, object]:
    errors = {
        name: _errors(getattr(record, name), record.ground_truth, finished.alignment)
        for name in ("odometry", "online", "corrected")
    }
    loops = count_loops(record.loops, np.arange(len(record.timestamps)), record.ground_truth)
    notes = places.notes | _notes("loops", loops) | UNKNOWN
    for name, error in errors.items():
        notes |= _notes(name, error)
    return {
        "seed": finished.config.seed,
        "frames": len(record.timestamps),
        "path_length_m": path_length(record.corrected if record.ground_truth is None else record.ground_truth),
        **{name: error.as_metrics() for name, error in errors.items()},
        "loops": loops.as_metrics(),
        "places": places.section,
        "graph": _graph_metrics(record, errors, finished.optimized),
        **_map_metrics(finished.met),
        "timing_ms": timing_ms(record.stage_ms),
        "frames_per_second": (len(record.timestamps) - finished.behind) / finished.wall_seconds,
        "wall_seconds": finished.wall_seconds,
        "peak_memory_mb": peak_memory_mb(),
        "memory_mb": held_mb(finished.slam.parts),
        "interrupted": finished.interrupted,
        "notes": notes,
    }


def _map_metrics(met: Met | None) -> dict[str, object]:
    if met is None:
        return {}
    said = dataclasses.asdict(met) | {"sessions": list(met.sessions), "T_map_session": met.T_map_session.tolist()}
    return {"map": said}


def _places(finished: Finished, ground_truth: Array | None) -> PlaceResult:
    truth = None if ground_truth is None else revisit_matrix(ground_truth)
    beliefs = [attempt.belief for attempt in finished.drive_log.attempts]
    size = map_size(finished.slam.parts.recognizer)
    return judge_places(finished.config.paradigm, beliefs, truth, size)


def _errors(estimate: Array, truth: Array | None, alignment: Alignment) -> TrajectoryErrors:
    if truth is None:
        return unknown_errors("there is no ground truth")
    return trajectory_errors(estimate, truth, alignment)


def _notes(name: str, result: TrajectoryErrors | LoopCounts) -> dict[str, str]:
    return {f"{name}.{value}": reason for value, reason in result.reasons.items()}


def _graph_metrics(record: DriveRecord, errors: dict[str, TrajectoryErrors], optimized: Optimized) -> dict[str, object]:
    judged = [row.truth for row in record.loops if row.in_graph and row.truth is not None]
    known = record.ground_truth is not None
    return {
        "poses": len(optimized.poses),
        "odometry_edges": len(optimized.poses) - 1,
        "loop_edges": len(optimized.kept),
        "loops_kept": int(optimized.kept.sum()),
        "true_kept": sum(judged) if known else None,
        "false_kept": len(judged) - sum(judged) if known else None,
        "ate_initial_m": errors["odometry"].ate_m,
        "ate_m": errors["corrected"].ate_m,
        "error_initial": optimized.error_initial,
        "error_final": optimized.error_final,
        "seconds": optimized.seconds,
    }
