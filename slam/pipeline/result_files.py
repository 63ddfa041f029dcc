"""Results of a run: its record, compared with ground truth, and its files."""

import dataclasses
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.memory import map_size
from place_recognition.evaluation.similarity_matrix import MatrixRecorder
from slam.config import RunConfig, to_toml
from slam.datasets.dataset import Dataset
from slam.errors import DataError
from slam.evaluation.loops import LoopCounts, count_loops, is_same_place, is_true_loop, revisit_matrix
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
from slam.io.frames_and_loops_csv import write_events, write_frames, write_loops, write_stages
from slam.io.g2o import chain_graph, write_g2o
from slam.io.landmarks import write_landmark_observers
from slam.io.metrics import write_metrics
from slam.io.trajectory_files import write_covariances, write_kitti, write_tum
from slam.loop_closing.loop_closer import LoopClosure
from slam.map_database.session_merging import MergeResult
from slam.pipeline.loop_log import LoopTruth, event_rows, loop_rows, matched_pixels, stage_rows
from slam.pipeline.provenance import UNKNOWN, memory_mb, peak_memory_mb
from slam.pose_graph.robust.backends import OptimizationResult
from slam.report.html_report import DENSE_PAGE, write_report
from slam.report.style import save_png
from slam.report.trajectory_figure import draw_before_after
from slam.run_log import RunLog
from slam.run_result import RunRecord
from slam.system import Components
from slam.timing import timing_ms

Array = NDArray[np.float64]


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
        interrupted: True where the user stopped the run.
        wall_seconds: time from the first frame to the end of the final optimisation, seconds.
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
    wall_seconds: float
    num_restored: int = 0
    merge: MergeResult | None = None

    @property
    def alignment(self) -> Alignment:
        """Alignment of trajectories with ground truth: with scale for one camera, which cannot measure it."""
        return "sim3" if self.config.mono else "se3"


def make_record(result: PipelineResult, provenance: dict[str, object]) -> RunRecord:
    """Gather everything known about the run, compared with ground truth where there is one."""
    dataset, log, optimized = result.dataset, result.run_log, result.optimized
    table, landmarks, graph = log.table(), result.components.landmarks, result.components.graph
    truth = None if dataset.ground_truth is None else dataset.ground_truth[: len(table)]
    unit_m = None if truth is None else _unit_m(optimized, truth, result.alignment)
    odometry = np.array(log.odometry)
    places = _places(result, table.timestamps, truth)
    record = RunRecord(
        name=f"{Path(str(provenance['source'])).resolve().name} {dataset.name}",
        timestamps=table.timestamps,
        odometry=odometry,
        online=np.array(log.online),
        corrected=optimized.poses,
        ground_truth=truth,
        predicted=table.predicted,
        inliers=table.inliers,
        loops=loop_rows(log.candidates, optimized, loop_truth_from_poses(truth, unit_m)),
        stage_ms=dict(table.stage_ms),
        map_before=landmarks.cloud(odometry),
        map_after=landmarks.cloud(optimized.similarities),
        metrics={},
        stages=stage_rows(log.candidates, graph.gates),
        events=event_rows(log.candidates, graph.loop_events),
        matched=matched_pixels(log.candidates),
        curve=places.curve,
        place_stages=places.stages,
        reliability=places.reliability,
        matrices={stage: result.matrix.matrix(len(table), stage) for stage in result.matrix.stages},
        odometry_covariances=graph.odometry_covariances(),
        corrected_covariances=graph.covariances(optimized),
    )
    record.metrics.update(provenance | _measure(record, result, places))
    return record


def _unit_m(optimized: OptimizationResult, truth: Array, alignment: Alignment) -> Array:
    """Unit of length (N,) of each frame, metres, by the ground truth (N, 4, 4)."""
    fit = umeyama(optimized.poses[:, :3, 3], truth[:, :3, 3], alignment)
    return fit.scale * optimized.scales


def loop_truth_from_poses(truth: Array | None, unit_m: Array | None) -> LoopTruth:
    """Function that tells whether a loop is a true revisit; it returns None without ground truth.

    Args:
        truth: ground truth T_world_camera (N, 4, 4), metres; None where there is none.
        unit_m: (N,) unit of length of each frame, metres.
    """

    def is_true(query: int, match: int, closure: LoopClosure | None) -> bool | None:
        if truth is None or unit_m is None:
            return None
        if closure is None:
            return is_same_place(truth, query, match)
        T_match_query = closure.T_match_query.copy()
        T_match_query[:3, 3] *= unit_m[match]
        return is_true_loop(truth, query, match, T_match_query)

    return is_true


def write_results(folder: Path, record: RunRecord, result: PipelineResult) -> None:
    """Write every file of a run into a folder."""
    config, dataset = result.config, result.dataset
    write_metrics(folder / "metrics.json", record.metrics)
    with atomic_writer(folder / "config.toml") as file:
        file.write(to_toml(config))
    for name in ("odometry", "online", "corrected"):
        poses = getattr(record, name)
        write_kitti(folder / f"trajectory_{name}.txt", poses)
        write_tum(folder / f"trajectory_{name}.tum", record.timestamps, poses)
    if result.merge is not None and result.merge.joined:
        in_map = result.merge.T_map_session @ record.corrected
        write_kitti(folder / "trajectory_map.txt", in_map)
        write_tum(folder / "trajectory_map.tum", record.timestamps, in_map)
    write_frames(folder / "frames.csv", result.run_log.table())
    write_loops(folder / "loops.csv", record.loops)
    write_stages(folder / "loop_stages.csv", record.stages)
    write_events(folder / "loop_events.csv", record.events)
    write_covariances(folder / "covariances.npz", record)
    _write_calibration(folder, result)
    _write_graphs(folder, record, result)
    _write_maps(folder, record)
    write_landmark_observers(folder / "landmarks.npz", result.components.landmarks.frames, dataset.camera)
    save_png(draw_before_after(record), folder / "before_after.png")
    dense_page = None if config.mono else DENSE_PAGE
    write_report(record, folder / "report.html", partial(_left_image, dataset), dataclasses.asdict(config), dense_page)


def _left_image(dataset: Dataset, index: int) -> NDArray[np.uint8] | None:
    """The left image of a frame; None where it can no longer be read: the run still keeps its other results."""
    try:
        return dataset[index].left
    except DataError:
        return None


def _write_calibration(folder: Path, result: PipelineResult) -> None:
    calibration = result.components.odometry.calibration
    if calibration is not None:
        write_calibration(folder / "calibration.toml", calibration)


def _write_graphs(folder: Path, record: RunRecord, result: PipelineResult) -> None:
    graph, optimized = result.components.graph, result.optimized
    motions, loops = graph.in_common_scale(optimized.scales)
    closed = [loop for loop, keep in zip(loops, optimized.kept, strict=True) if keep]
    write_g2o(folder / "pose_graph_before.g2o", chain_graph(record.odometry, graph.odometry, graph.loops))
    write_g2o(folder / "pose_graph_after.g2o", chain_graph(record.corrected, motions, closed))


def _write_maps(folder: Path, record: RunRecord) -> None:
    from slam.io.landmarks import write_cloud

    write_cloud(folder / "map_before.ply", record.map_before)
    write_cloud(folder / "map_after.ply", record.map_after)


def _measure(record: RunRecord, result: PipelineResult, places: PlaceMetrics) -> dict[str, object]:
    errors = {
        name: _errors(getattr(record, name), record.ground_truth, result.alignment)
        for name in ("odometry", "online", "corrected")
    }
    loops = count_loops(record.loops, np.arange(len(record.timestamps)), record.ground_truth)
    notes = places.notes | _notes("loops", loops) | UNKNOWN
    for name, error in errors.items():
        notes |= _notes(name, error)
    return {
        "preset": result.config.place_recognition.preset,
        "seed": result.config.seed,
        "frames": len(record.timestamps),
        "path_length_m": path_length(record.corrected if record.ground_truth is None else record.ground_truth),
        **{name: error.as_metrics() for name, error in errors.items()},
        "static_ratio": result.components.masks.mean_static_ratio,
        "loops": loops.as_metrics(),
        "places": places.section,
        "graph": _graph_metrics(record, errors, result.optimized),
        **_map_metrics(result.merge),
        "timing_ms": timing_ms(record.stage_ms),
        "frames_per_second": (len(record.timestamps) - result.num_restored) / result.wall_seconds,
        "wall_seconds": result.wall_seconds,
        "peak_memory_mb": peak_memory_mb(),
        "memory_mb": memory_mb(result.components),
        "interrupted": result.interrupted,
        "notes": notes,
    }


def _map_metrics(merge: MergeResult | None) -> dict[str, object]:
    if merge is None:
        return {}
    lists = {"sessions": list(merge.sessions), "T_map_session": merge.T_map_session.tolist()}
    return {"map": dataclasses.asdict(merge) | lists}


def _places(result: PipelineResult, timestamps: Array, ground_truth: Array | None) -> PlaceMetrics:
    truth = None if ground_truth is None else revisit_matrix(ground_truth)
    path_lengths_m = None if ground_truth is None else distances_along(ground_truth)
    beliefs = [candidate.belief for candidate in result.run_log.candidates]
    size = map_size(result.components.recognizer)
    return evaluate_places(result.config.paradigm, beliefs, truth, size, DriveData(timestamps, path_lengths_m))


def _errors(estimate: Array, truth: Array | None, alignment: Alignment) -> TrajectoryErrors:
    if truth is None:
        return unknown_errors("there is no ground truth")
    return trajectory_errors(estimate, truth, alignment)


def _notes(name: str, result: TrajectoryErrors | LoopCounts) -> dict[str, str]:
    return {f"{name}.{value}": reason for value, reason in result.reasons.items()}


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
