"""`revisit evaluate`: a trajectory against the true one, and a table of matches against the true revisits."""

import json as json_format
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from place_recognition.evaluation.precision_recall import PrecisionRecall, precision_recall
from place_recognition.evaluation.revisit_ground_truth import RevisitRule
from place_recognition.recognizer import Belief
from slam.errors import ConfigError, DataError
from slam.evaluation.place_metrics import COMMON_TOLERANCE_IMAGES, measure_scores
from slam.evaluation.revisit_truth_files import RevisitTruth, read_revisit_truth
from slam.evaluation.trajectory_errors import TrajectoryErrors, path_length, trajectory_errors
from slam.io.matches import read_matches, write_curve
from slam.io.metrics import metrics_text, write_metrics
from slam.io.run_folder import RunFolder
from slam.io.trajectory_files import read_trajectory

Array = NDArray[np.float64]

MAX_TIME_DIFFERENCE_S = 0.01  # between the timestamps of two poses that are compared

_ERROR_TITLES = {
    "ate_m": "ATE, metres",
    "t_rel_percent": "t_rel, per cent",
    "r_rel_deg_per_100m": "r_rel, degrees per 100 m",
    "end_error_m": "end error, metres",
    "end_error_percent": "end error, % of the path length",
}
_SCORE_TITLES = {
    "recall_at_100_precision": "R@P100",
    "average_precision": "average precision",
    "threshold_at_100_precision": "threshold at R@P100",
    "true_positives": "accepted, true",
    "false_positives": "accepted, false",
}
_ALIGNMENTS = {"se3": "after SE(3) alignment of all poses", "sim3": "after Sim(3) alignment of all poses"}


def evaluate_trajectory_files(estimate: Path, truth: Path, mono: bool = False, json: bool = False) -> str:
    """Compute the errors of an estimated trajectory, as text or as JSON with the keys of metrics.json.

    Args:
        estimate: file of estimated poses T_world_camera, metres, KITTI or TUM.
        truth: file of true poses, KITTI or TUM. Two TUM files are matched by time, others pose by pose.
        mono: whether to align with Sim(3) instead of SE(3).
        json: whether to return JSON.

    Raises:
        DataError: a file is missing or damaged, or the two are not of the same recording.
    """
    poses, reference = _read_pairs(estimate, truth)
    errors = trajectory_errors(poses, reference, "sim3" if mono else "se3")
    size: dict[str, object] = {"poses": len(poses), "path_length_m": path_length(reference)}
    if json:
        return json_format.dumps(size | errors.as_metrics() | {"notes": errors.reasons}, indent=2)
    return "\n".join([f"{len(poses)} poses, {path_length(reference):.1f} m", *_format_lines(errors)])


def _format_lines(errors: TrajectoryErrors) -> list[str]:
    values = errors.as_metrics()
    shown = {name: errors.reasons.get(name) or f"{values[name]:.4g}" for name in _ERROR_TITLES}
    shown["ate_m"] += f"  {_ALIGNMENTS[str(errors.ate_alignment)]}"
    return [f"{title:<31} {shown[name]}" for name, title in _ERROR_TITLES.items()]


def _read_pairs(estimate: Path, truth: Path) -> tuple[Array, Array]:
    times, poses = read_trajectory(estimate)
    reference_times, reference = read_trajectory(truth)
    if times is not None and reference_times is not None:
        ours, theirs = _associate(times, reference_times)
        if len(ours) < 2:
            raise DataError(
                f"{estimate}: expected times within {MAX_TIME_DIFFERENCE_S} s of those in {truth},"
                f" found {len(ours)} of {len(times)}; compare files of the same recording"
            )
        return poses[ours], reference[theirs]
    if len(poses) != len(reference):
        raise DataError(
            f"{estimate}: expected {len(reference)} poses as in {truth}, found {len(poses)};"
            " compare files of the same recording, or give both as TUM"
        )
    return poses, reference


def _associate(times: Array, reference: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    # Each pose is paired with the reference nearest in time; of several poses with one reference the nearest stays.
    # A reference need not be sorted by time: `order` sorts it.
    order = np.argsort(reference, kind="stable")
    after = np.clip(np.searchsorted(reference[order], times), 1, max(len(reference) - 1, 1))
    candidates = order[np.clip(np.stack([after - 1, after]), 0, len(reference) - 1)]
    differences = np.abs(reference[candidates] - times)
    nearest, difference = candidates[differences.argmin(axis=0), np.arange(len(times))], differences.min(axis=0)
    order_by_difference = np.argsort(difference, kind="stable")
    _, first = np.unique(nearest[order_by_difference], return_index=True)
    ours = np.sort(order_by_difference[first])
    ours = ours[difference[ours] <= MAX_TIME_DIFFERENCE_S]
    return ours, nearest[ours]


@dataclass(frozen=True)
class LoopsOptions:
    """Options of `revisit evaluate loops`.

    Attributes:
        matches: CSV table with the columns query, match and score.
        truth: ground truth, a matrix of revisits (.mat, .npz) or poses (KITTI, TUM).
        frame_tolerance: maximum distance of a match from the nearest true one, images, for a third count; None for the
            two rules in use alone.
        rule: what counts as a revisit, for ground truth given as poses.
        fps: poses per second, if the rule has a minimum time and the poses have no times.
        out: folder for metrics.json and the curve; None to write no files.
        overwrite: whether to replace earlier results.
    """

    matches: Path
    truth: Path
    frame_tolerance: int | None = None
    rule: RevisitRule = field(default_factory=RevisitRule)
    fps: float | None = None
    out: Path | None = None
    overwrite: bool = False


def evaluate_loops(options: LoopsOptions, json: bool = False) -> str:
    """Evaluate matches by two rules in use: exact ground truth, and a tolerance of 10 images.

    Args:
        options: files and rule.
        json: whether to return JSON instead of text.

    Raises:
        DataError: a file is missing or damaged, or the two are not of the same recording.
        ConfigError: an option has a value that cannot work.
        OutputError: the results cannot be written.
    """
    _check(options)
    beliefs, truth = read_matches(options.matches), _truth(options)
    _check_queries(options.matches, beliefs, truth)
    tolerances = dict.fromkeys((0, COMMON_TOLERANCE_IMAGES, options.frame_tolerance or 0))
    results = {tolerance: measure_scores(beliefs, truth.required_matrix, tolerance) for tolerance in tolerances}
    metrics: dict[str, object] = {
        "matches": str(options.matches),
        "ground_truth": truth.origin,
        "queries": len(beliefs),
        "rules": {f"tolerance_{tolerance}": section for tolerance, section in results.items()},
    }
    if options.out is not None:
        _write(options, options.out, metrics, precision_recall(beliefs, truth.required_matrix))
    return metrics_text(metrics) if json else "\n".join(_lines(truth, beliefs, results))


def _check(options: LoopsOptions) -> None:
    rule = options.rule
    numbers = {
        "--max-distance": rule.max_distance_m,
        "--max-angle": rule.max_angle_deg,
        "--min-time-gap": rule.min_time_gap_s,
        "--min-distance": rule.min_path_length_m,
    }
    for name, value in numbers.items():
        if not 0 <= value < np.inf:
            raise ConfigError(f"{name}: expected a number from 0, found {value}")
    if options.frame_tolerance is not None and options.frame_tolerance < 0:
        raise ConfigError(f"--frame-tolerance: expected images from 0, found {options.frame_tolerance}")
    if options.fps is not None and not 0 < options.fps < np.inf:
        raise ConfigError(f"--fps: expected poses per second above 0, found {options.fps}")


def _truth(options: LoopsOptions) -> RevisitTruth:
    truth = read_revisit_truth(options.truth, options.rule, options.fps)
    if not truth.required_matrix.any():
        raise DataError(f"{truth.origin}: expected at least one revisit, found none; choose another truth or rule")
    return truth


def _check_queries(matches: Path, beliefs: Sequence[Belief], truth: RevisitTruth) -> None:
    last, count = max((belief.query for belief in beliefs), default=0), len(truth.required_matrix)
    if last >= count:
        raise DataError(
            f"{matches}: expected queries below {count}, the images of {truth.origin}, found {last};"
            " choose the truth of this recording"
        )


def _lines(truth: RevisitTruth, beliefs: Sequence[Belief], results: dict[int, dict[str, object]]) -> list[str]:
    revisits = int(truth.required_matrix.any(axis=1).sum())
    lines = [f"{len(beliefs)} queries; {revisits} revisits by {truth.origin}"]
    for tolerance, section in results.items():
        lines.append(f"\n{_title(tolerance)}")
        lines += [f"  {title:<24} {_text(section[name])}" for name, title in _SCORE_TITLES.items()]
    return lines


def _title(tolerance: int) -> str:
    rules = {
        0: "Exact ground truth (rule of the chapter's authors)",
        COMMON_TOLERANCE_IMAGES: f"Tolerance of {COMMON_TOLERANCE_IMAGES} images (rule of iBoW-LCD and others)",
    }
    return rules.get(tolerance, f"Tolerance of {tolerance} images (--frame-tolerance)")


def _text(value: object) -> str:
    return "none" if value is None else f"{value:.4f}" if isinstance(value, float) else str(value)


def _write(options: LoopsOptions, out: Path, metrics: dict[str, object], curve: PrecisionRecall) -> None:
    from slam.report.place_recognition_figures import plot_precision_recall
    from slam.report.trajectory_figure import save_png

    with RunFolder.create(out, options.overwrite) as folder:
        write_metrics(folder.path / "metrics.json", metrics)
        write_curve(folder.path / "precision_recall.csv", curve)
        picture = plot_precision_recall({"all matches": curve}, options.matches.name)
        save_png(picture, folder.path / "precision_recall.png")
        folder.commit()
