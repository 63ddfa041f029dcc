"""Results of a run: its record, compared with ground truth, and its files."""

import dataclasses
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.memory import map_size
from place_recognition.evaluation.similarity_matrix import MatrixRecorder, SimilarityMatrix
from place_recognition.recognizer import Belief
from slam.config import RunConfig, changed_settings, to_toml
from slam.datasets.dataset import Dataset
from slam.errors import DataError
from slam.evaluation.loops import LoopCounts, count_loops, kept_loop_errors, revisit_truth, summarize_loop_errors
from slam.evaluation.place_metrics import DriveData, PlaceMetrics, evaluate_places
from slam.evaluation.trajectory_errors import (
    Alignment,
    TrajectoryErrors,
    distances_along,
    path_length,
    trajectory_errors,
    umeyama,
    unknown_errors,
)
from slam.io.calibration import write_calibration
from slam.io.files import atomic_writer
from slam.io.frames_and_loops_csv import FrameTable, write_events, write_frames, write_loops, write_stages
from slam.io.g2o import chain_graph, write_g2o
from slam.io.landmarks import write_cloud, write_landmark_observers
from slam.io.matches import write_matches
from slam.io.metrics import write_metrics
from slam.io.trajectory_files import write_covariances, write_kitti, write_tum
from slam.map_database.session_merging import MergeResult
from slam.pipeline.loop_log import (
    LoopTruth,
    PoseLoopTruth,
    UnknownLoopTruth,
    event_rows,
    loop_rows,
    matched_pixels,
    stage_rows,
)
from slam.pipeline.provenance import UNKNOWN, memory_mb, peak_memory_mb
from slam.pipeline.run_warnings import RunWarnings
from slam.pose_graph.robust.backends import OptimizationResult
from slam.report.formatting import describe_motions
from slam.report.html_report import DENSE_PAGE, write_report
from slam.report.style import save_png
from slam.report.trajectory_figure import draw_before_after
from slam.run_log import RunLog
from slam.run_result import PointCloud, RunRecord
from slam.system import Components
from slam.timing import timing_ms

Array = NDArray[np.float64]

_MAX_USUAL_PREDICTED_SHARE = 0.1
_NUMBER = re.compile(r"\d[\d.]*")


@dataclass(frozen=True, kw_only=True)
class PipelineResult:
    """Result of a run: everything that its files are written from.

    Attributes:
        dataset: the dataset that was processed.
        config: configuration of the run.
        components: the components of the system, with the pose graph and the landmark map.
        run_log: log of the frames and loop candidates.
        matrix: the recogniser's similarity matrix.
        optimized: the final trajectory and the decisions on the loops.
        interrupted: True where the run ended before the last frame.
        unreadable: error of the frame that ended it; None if none did.
        wall_seconds: time from the first frame to the end of the final optimisation, seconds.
        warnings: warnings so far; takes those of the files.
        num_restored: number of frames that were processed before the run was resumed.
        merge: result of merging with the other sessions of the map; None where there are none.
    """

    dataset: Dataset
    config: RunConfig
    components: Components
    run_log: RunLog
    matrix: MatrixRecorder
    optimized: OptimizationResult
    interrupted: bool
    unreadable: DataError | None
    warnings: RunWarnings
    wall_seconds: float
    num_restored: int = 0
    merge: MergeResult | None = None

    @property
    def alignment(self) -> Alignment:
        """Alignment of trajectories with ground truth: with scale for one camera, which cannot measure it."""
        return "sim3" if self.config.mono else "se3"


def make_record(result: PipelineResult, provenance: dict[str, object]) -> RunRecord:
    """Gather everything known about the run, compared with ground truth where there is one.

    What cannot be computed is left out, with a warning: the trajectory does not depend on it.
    """
    dataset, log, optimized = result.dataset, result.run_log, result.optimized
    table, landmarks, graph = log.table(), result.components.landmarks, result.components.graph
    truth = None if dataset.ground_truth is None else dataset.ground_truth[: len(table)]
    attempt = result.warnings.attempt
    unit_m = attempt("unit of length by ground truth", lambda: _unit_m(result, truth), _nothing)
    odometry = np.array(log.odometry)
    places = attempt("evaluation of places", lambda: _places(result, table.timestamps, truth), _no_places)
    loop_truth = _loop_truth(truth, unit_m)
    record = RunRecord(
        name=f"{Path(str(provenance['source'])).resolve().name} {dataset.name}",
        timestamps=table.timestamps,
        odometry=odometry,
        online=np.array(log.online),
        corrected=optimized.poses,
        ground_truth=truth,
        predicted=table.predicted,
        inliers=table.inliers,
        loops=attempt("table of loops", lambda: loop_rows(log.candidates, optimized, loop_truth), _no_rows),
        stage_ms=dict(table.stage_ms),
        map_before=attempt("landmarks before correction", lambda: landmarks.cloud(odometry), _no_points),
        map_after=attempt("landmarks after correction", lambda: landmarks.cloud(optimized.similarities), _no_points),
        metrics={},
        stages=attempt("stages of the loops", lambda: stage_rows(log.candidates, graph.gates, loop_truth), _no_rows),
        events=attempt("events of the loops", lambda: event_rows(log.candidates, graph.loop_events), _no_rows),
        matched=attempt("matched pixels", lambda: matched_pixels(log.candidates), _no_rows),
        curve=places.curve,
        place_stages=places.stages,
        reliability=places.reliability,
        matrices=attempt("similarity matrices", lambda: _matrices(result.matrix, len(table)), lambda _reason: {}),
        odometry_covariances=attempt("covariances of odometry", graph.odometry_covariances, _nothing),
        corrected_covariances=attempt("corrected covariances", lambda: graph.covariances(optimized), _nothing),
    )
    warn_of_predictions(table, result.warnings)
    measured = attempt("metrics", lambda: _measure(record, result, places), lambda _reason: {})
    record.metrics.update(provenance | measured | _always_known(result, table))
    return record


def _always_known(result: PipelineResult, table: FrameTable) -> dict[str, object]:
    """Metrics that need no computation that can fail."""
    return {
        "frames": len(table),
        "motions": motion_metrics(table),
        "interrupted": result.interrupted,
        "warnings": result.warnings.texts,
    }


def warn_of_predictions(table: FrameTable, warnings: RunWarnings) -> None:
    """Warn where so many motions were predicted that the trajectory suffers."""
    motions = motion_metrics(table)
    if table.predicted.mean() > _MAX_USUAL_PREDICTED_SHARE:
        warnings.add(describe_motions({"motions": motions}))


def motion_metrics(table: FrameTable) -> dict[str, object]:
    """How many motions between frames were measured and how many predicted, and the commonest reason of the latter."""
    reasons = [reason for reason, predicted in zip(table.reasons, table.predicted, strict=True) if predicted]
    return {
        "measured": len(table) - int(not table.predicted[0]) - len(reasons),
        "predicted": len(reasons),
        "commonest_reason": _commonest(reasons),
    }


def _commonest(reasons: Sequence[str]) -> str | None:
    """The commonest reason; those that differ in their numbers alone are one, with N for the numbers."""
    kinds = Counter(_NUMBER.sub("N", reason) for reason in reasons)
    if not kinds:
        return None
    ((commonest, _),) = kinds.most_common(1)
    alike = {reason for reason in reasons if _NUMBER.sub("N", reason) == commonest}
    return alike.pop() if len(alike) == 1 else commonest


def _nothing(_reason: str) -> None:
    return None


def _no_rows(_reason: str) -> tuple[()]:
    return ()


def _no_points(_reason: str) -> PointCloud:
    return PointCloud(np.empty((0, 3)), np.empty(0, np.uint8))


def _no_places(reason: str) -> PlaceMetrics:
    return PlaceMetrics({}, {"places": reason})


def _matrices(rows: MatrixRecorder, frames: int) -> dict[str, SimilarityMatrix]:
    return {stage: rows.matrix(frames, stage) for stage in rows.stages}


def _unit_m(result: PipelineResult, truth: Array | None) -> Array | None:
    """Unit of length (N,) of each frame, metres, by the ground truth (N, 4, 4); None without one."""
    if truth is None:
        return None
    fit = umeyama(result.optimized.poses[:, :3, 3], truth[:, :3, 3], result.alignment)
    return fit.scale * result.optimized.scales


def _loop_truth(truth: Array | None, unit_m: Array | None) -> LoopTruth:
    return UnknownLoopTruth() if truth is None or unit_m is None else PoseLoopTruth(truth, unit_m)


def write_results(folder: Path, record: RunRecord, result: PipelineResult) -> None:
    """Write every file of a run into a folder.

    A file that fails is left out, with a warning: a disk may have room for the trajectory and not for the map.

    Raises:
        OutputError: not even the trajectories and the metrics can be written.
    """
    config, dataset, attempt_to = result.config, result.dataset, result.warnings.attempt_to
    for name in ("odometry", "online", "corrected"):
        poses = getattr(record, name)
        write_kitti(folder / f"trajectory_{name}.txt", poses)
        write_tum(folder / f"trajectory_{name}.tum", record.timestamps, poses)
    write_metrics(folder / "metrics.json", record.metrics)
    with atomic_writer(folder / "config.toml") as file:
        file.write(to_toml(config))
    dense_page = None if config.mono else DENSE_PAGE
    images, settings = partial(_left_image, dataset), dataclasses.asdict(config)
    landmarks = result.components.landmarks
    files: dict[str, Callable[[Path], None]] = {
        "trajectory_map": lambda path: _write_trajectory_in_map(path, record, result),
        "frames.csv": lambda path: write_frames(path, result.run_log.table()),
        "matches.csv": lambda path: write_matches(path, _beliefs(result)),
        "loops.csv": lambda path: write_loops(path, record.loops),
        "loop_stages.csv": lambda path: write_stages(path, record.stages),
        "loop_events.csv": lambda path: write_events(path, record.events),
        "covariances.npz": lambda path: write_covariances(path, record),
        "calibration.toml": lambda path: _write_calibration(path, result),
        "pose_graph_before.g2o": lambda path: _write_graph_before(path, record, result),
        "pose_graph_after.g2o": lambda path: _write_graph_after(path, record, result),
        "map_before.ply": lambda path: write_cloud(path, record.map_before),
        "map_after.ply": lambda path: write_cloud(path, record.map_after),
        "landmarks.npz": lambda path: write_landmark_observers(path, landmarks.frames, dataset.camera),
        "before_after.png": lambda path: save_png(draw_before_after(record), path),
        "report.html": lambda path: write_report(record, path, images, settings, dense_page),
    }
    for name, write in files.items():
        if not attempt_to(name, partial(write, folder / name)):
            (folder / name).unlink(missing_ok=True)  # half a file is none
    attempt_to("metrics.json with the last warnings", partial(write_metrics, folder / "metrics.json", record.metrics))


def _write_trajectory_in_map(path: Path, record: RunRecord, result: PipelineResult) -> None:
    if result.merge is None or not result.merge.joined:
        return
    in_map = result.merge.T_map_session @ record.corrected
    write_kitti(path.with_suffix(".txt"), in_map)
    write_tum(path.with_suffix(".tum"), record.timestamps, in_map)


def _left_image(dataset: Dataset, index: int) -> NDArray[np.uint8] | None:
    """The left image of a frame; None where it can no longer be read: the run still keeps its other results."""
    try:
        return dataset.read_left(index)
    except DataError:
        return None


def _write_calibration(path: Path, result: PipelineResult) -> None:
    calibration = result.components.odometry.calibration
    if calibration is not None:
        write_calibration(path, calibration)


def _write_graph_before(path: Path, record: RunRecord, result: PipelineResult) -> None:
    graph = result.components.graph
    write_g2o(path, chain_graph(record.odometry, graph.odometry, graph.loops))


def _write_graph_after(path: Path, record: RunRecord, result: PipelineResult) -> None:
    motions, loops = result.components.graph.in_common_scale(result.optimized.scales)
    closed = [loop for loop, keep in zip(loops, result.optimized.kept, strict=True) if keep]
    write_g2o(path, chain_graph(record.corrected, motions, closed))


def _measure(record: RunRecord, result: PipelineResult, places: PlaceMetrics) -> dict[str, object]:
    errors = {name: _errors(name, record, result) for name in ("odometry", "online", "corrected")}
    loops = count_loops(record.loops, np.arange(len(record.timestamps)), record.ground_truth)
    loop_errors = summarize_loop_errors(kept_loop_errors(record.loops, record.stages))
    notes = places.notes | _notes("loops", loops) | _loop_error_notes(loop_errors, record) | UNKNOWN
    for name, error in errors.items():
        notes |= _notes(name, error)
    return {
        "preset": result.config.place_recognition.preset,
        "seed": result.config.seed,
        "changed_settings": {
            change.name: {"value": change.value, "default": change.default}
            for change in changed_settings(result.config)
        },
        "path_length_m": path_length(record.corrected if record.ground_truth is None else record.ground_truth),
        **{name: error.as_metrics() for name, error in errors.items()},
        "static_ratio": result.components.masks.mean_static_ratio,
        "loops": loops.as_metrics() | loop_errors,
        "places": places.section,
        "graph": _graph_metrics(record, errors, result.optimized),
        **_map_metrics(result.merge),
        "timing_ms": timing_ms(record.stage_ms),
        "frames_per_second": (len(record.timestamps) - result.num_restored) / result.wall_seconds,
        "wall_seconds": result.wall_seconds,
        "peak_memory_mb": peak_memory_mb(),
        "memory_mb": memory_mb(result.components),
        "notes": notes,
    }


def _map_metrics(merge: MergeResult | None) -> dict[str, object]:
    if merge is None:
        return {}
    lists = {"sessions": list(merge.sessions), "T_map_session": merge.T_map_session.tolist()}
    return {"map": dataclasses.asdict(merge) | lists}


def _beliefs(result: PipelineResult) -> list[Belief]:
    """Return one belief for each frame, the surest where a file of matches gave several."""
    best: dict[int, Belief] = {}
    for candidate in result.run_log.candidates:
        best.setdefault(candidate.belief.query, candidate.belief)
    return list(best.values())


def _places(result: PipelineResult, timestamps: Array, ground_truth: Array | None) -> PlaceMetrics:
    truth = None if ground_truth is None else revisit_truth(ground_truth)
    path_lengths_m = None if ground_truth is None else distances_along(ground_truth)
    beliefs = _beliefs(result)
    size = map_size(result.components.recognizer)
    return evaluate_places(result.config.paradigm, beliefs, truth, size, DriveData(timestamps, path_lengths_m))


def _errors(name: str, record: RunRecord, result: PipelineResult) -> TrajectoryErrors:
    truth = record.ground_truth
    if truth is None:
        return unknown_errors("there is no ground truth")
    return result.warnings.attempt(
        f"errors of the {name} trajectory",
        lambda: trajectory_errors(getattr(record, name), truth, result.alignment),
        unknown_errors,
    )


def _notes(name: str, result: TrajectoryErrors | LoopCounts) -> dict[str, str]:
    return {f"{name}.{value}": reason for value, reason in result.reasons.items()}


def _loop_error_notes(errors: Mapping[str, object], record: RunRecord) -> dict[str, str]:
    reason = "there is no ground truth" if record.ground_truth is None else "no loop was kept"
    return {f"loops.{name}": reason for name, values in errors.items() if values is None}


def _graph_metrics(
    record: RunRecord, errors: dict[str, TrajectoryErrors], optimized: OptimizationResult
) -> dict[str, object]:
    correct = [row.truth for row in record.loops if row.in_graph and row.truth is not None]
    has_truth = record.ground_truth is not None
    return {
        "poses": len(optimized.poses),
        "odometry_edges": len(optimized.poses) - 1,
        "loop_edges": len(optimized.kept),
        "loops_kept": int(optimized.kept.sum()),
        "true_kept": sum(correct) if has_truth else None,
        "false_kept": len(correct) - sum(correct) if has_truth else None,
        "ate_initial_m": errors["odometry"].ate_m,
        "ate_m": errors["corrected"].ate_m,
        "error_initial": optimized.error_initial,
        "error_final": optimized.error_final,
        "seconds": optimized.seconds,
    }
