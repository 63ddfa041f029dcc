"""`revisit evaluate`: a trajectory against the true one, and a table of matches against the true revisits."""

import json as json_format
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from place_recognition.evaluation.precision_recall import PrecisionRecall, precision_recall
from place_recognition.evaluation.revisit_ground_truth import RevisitRule
from place_recognition.recognizer import Belief
from slam.datasets.formats.euroc import read_sensor_yaml
from slam.datasets.time_sync import MAX_GAP_S, MAX_TIME_DIFFERENCE_S
from slam.errors import ConfigError, DataError
from slam.evaluation.place_metrics import COMMON_TOLERANCE_IMAGES, measure_scores
from slam.evaluation.revisit_truth_files import RevisitTruth, describe_remarks, read_revisit_truth
from slam.evaluation.trajectory_errors import (
    PosePairs,
    TrajectoryErrors,
    pair_by_time,
    path_length,
    scale_to_other,
    trajectory_errors,
    umeyama,
)
from slam.io.frames_and_loops_csv import read_frames
from slam.io.matches import read_matches, write_curve
from slam.io.metrics import metrics_text, write_metrics
from slam.io.run_folder import RunFolder
from slam.io.trajectory_reader import Trajectory, read_trajectory

# KITTI's segments end at the first pose beyond their length: with poses farther apart they are longer than they count.
MAX_POSE_SPACING_M = 10.0
# Between the axes of estimate and truth after alignment: a body's and a camera's axes differ by about 90 degrees.
MAX_AXES_ANGLE_DEG = 20.0
# Pairs of which errors are computed; fewer, such as every thousandth pose, match by chance.
MIN_PAIRS, MIN_MATCHED_SHARE = 3, 0.02
MIN_WIDTH = 0.05  # of a path, against its length, that determines the alignment

FRAMES_FILE = "frames.csv"  # beside the tables of a run: the times of its images

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


@dataclass(frozen=True)
class _Comparison:
    """Two trajectories of one drive, and their errors.

    Attributes:
        pairs: estimated and true poses.
        num_estimated: number of estimated poses, with and without a true one.
        is_by_time: whether poses were paired by time, not one by one.
        errors: errors of the pairs.
        warnings: what was left out or changed, a sentence each.
    """

    pairs: PosePairs
    num_estimated: int
    is_by_time: bool
    errors: TrajectoryErrors
    warnings: tuple[str, ...]

    @property
    def path_length_m(self) -> float:
        """Length of the true path through all pairs, metres."""
        return path_length(self.pairs.truth)


def evaluate_trajectory_files(estimate: Path, truth: Path, mono: bool = False, json: bool = False) -> str:
    """Compute the errors of an estimated trajectory, as text or as JSON with the keys of metrics.json.

    Args:
        estimate: file of estimated poses T_world_camera, metres: KITTI, TUM or EuRoC's csv.
        truth: file of true poses, likewise. Two files with times are matched by time, others pose by pose.
        mono: whether to align with Sim(3) instead of SE(3).
        json: whether to return JSON.

    Raises:
        DataError: a file is missing or damaged, or the two are not of the same recording.
    """
    done = _compare(estimate, truth, mono)
    if json:
        size = {
            "poses": len(done.pairs.rows),
            "estimated_poses": done.num_estimated,
            "matched_by": "time" if done.is_by_time else "number",
            "path_length_m": done.path_length_m,
        }
        rest = {"notes": done.errors.reasons, "warnings": done.warnings}
        return json_format.dumps(size | done.errors.as_metrics() | rest, indent=2)
    return "\n".join(_trajectory_lines(done))


def _compare(estimate: Path, truth: Path, mono: bool) -> _Comparison:
    ours, theirs = read_trajectory(estimate), _in_camera(truth, read_trajectory(truth))
    theirs = scale_to_other(truth, theirs, ours)
    ours = scale_to_other(estimate, ours, theirs)
    pairs = _pair(estimate, ours, truth, theirs)
    errors = trajectory_errors(pairs.estimate, pairs.truth, "sim3" if mono else "se3")
    spacing_m = path_length(pairs.truth) / max(len(pairs.rows) - 1, 1)
    if errors.t_rel_percent is not None and spacing_m > MAX_POSE_SPACING_M:
        reason = (
            f"the {len(pairs.rows)} poses are {spacing_m:.0f} m apart, segments need one in {MAX_POSE_SPACING_M:.0f} m"
        )
        unknown = dict.fromkeys(("t_rel_percent", "r_rel_deg_per_100m"), reason)
        errors = replace(errors, t_rel_percent=None, r_rel_deg_per_100m=None, reasons=errors.reasons | unknown)
    warnings = (*ours.remarks, *theirs.remarks, *_describe_pairs(estimate, ours, pairs), *_describe_axes(pairs))
    is_by_time = ours.times is not None and theirs.times is not None
    return _Comparison(pairs, len(ours.poses), is_by_time, errors, warnings)


def _in_camera(truth: Path, trajectory: Trajectory) -> Trajectory:
    """Return EuRoC's poses of the vehicle as those of its left camera, where the calibration lies beside the file."""
    sensor = truth.absolute().parent.parent / "cam0" / "sensor.yaml"
    if truth.suffix.lower() != ".csv" or trajectory.times is None or not sensor.is_file():
        return trajectory
    remark = f"{truth}: poses of the vehicle, moved to the left camera by {sensor}"
    T_body_camera = read_sensor_yaml(sensor).T_body_camera
    return replace(trajectory, poses=trajectory.poses @ T_body_camera, remarks=(*trajectory.remarks, remark))


def _trajectory_lines(done: _Comparison) -> list[str]:
    count, errors = len(done.pairs.rows), done.errors
    poses = f"{count} of {done.num_estimated} poses, matched by time" if done.is_by_time else f"{count} poses"
    values = errors.as_metrics()
    shown = {name: errors.reasons.get(name) or f"{values[name]:.4g}" for name in _ERROR_TITLES}
    shown["ate_m"] += f"  {_ALIGNMENTS[str(errors.ate_alignment)]}"
    return [
        f"{poses}, {done.path_length_m:.1f} m",
        *(f"{title:<31} {shown[name]}" for name, title in _ERROR_TITLES.items()),
        *(f"warning: {warning}" for warning in done.warnings),
    ]


def _pair(estimate: Path, ours: Trajectory, truth: Path, theirs: Trajectory) -> PosePairs:
    if ours.times is not None and theirs.times is not None:
        pairs = pair_by_time(ours, theirs)
        possible = min(len(ours.times), len(theirs.times))
        if len(pairs.rows) < max(2, min(MIN_PAIRS, possible), MIN_MATCHED_SHARE * possible):
            raise DataError(
                f"{estimate}: expected times within {MAX_TIME_DIFFERENCE_S} s of those in {truth},"
                f" found {len(pairs.rows)} of {len(ours.times)}, from {ours.times[0]:.3f} to {ours.times[-1]:.3f} s"
                f" against {theirs.times[0]:.3f} to {theirs.times[-1]:.3f} s; compare files of the same recording,"
                " with times of one clock, in seconds"
            )
        return pairs
    if len(ours.poses) != len(theirs.poses):
        left_out = " ".join(("", *ours.remarks, *theirs.remarks))
        raise DataError(
            f"{estimate}: expected {len(theirs.poses)} poses as in {truth}, found {len(ours.poses)};"
            f" compare files of the same recording, or give both as TUM{left_out}"
        )
    return PosePairs(ours.poses, theirs.poses, np.arange(len(ours.poses)))


def _describe_pairs(estimate: Path, ours: Trajectory, pairs: PosePairs) -> list[str]:
    """Say how many estimated poses have no true one, and which is the first."""
    missing = np.setdiff1d(np.arange(len(ours.poses)), pairs.rows)
    if ours.times is None or not len(missing):
        return []
    return [
        f"{estimate}: {len(pairs.rows)} of {len(ours.poses)} poses have a true pose within {MAX_TIME_DIFFERENCE_S} s or"
        f" between two at most {MAX_GAP_S} s apart; {len(missing)} are left out, the first at"
        f" {ours.times[missing[0]]:.6f} s"
    ]


def _describe_axes(pairs: PosePairs) -> list[str]:
    """Say where the poses of the two are of differently turned axes, such as a camera's and a vehicle's."""
    positions = pairs.truth[:, :3, 3]
    extent = np.linalg.svd(positions - positions.mean(axis=0), compute_uv=False)
    if len(positions) < 3 or extent[1] < MIN_WIDTH * extent[0]:
        return []  # on a straight line the alignment may turn about the line
    fit = umeyama(pairs.estimate[:, :3, 3], positions)
    turns = Rotation.from_matrix(np.swapaxes(fit.R @ pairs.estimate[:, :3, :3], 1, 2) @ pairs.truth[:, :3, :3])
    mean = turns.mean()
    angle, spread = np.degrees(mean.magnitude()), np.degrees(np.median((mean.inv() * turns).magnitude()))
    if angle < MAX_AXES_ANGLE_DEG or spread > angle / 2:
        return []
    return [
        f"the axes of the poses differ by {angle:.0f} degrees, as those of a camera and of a vehicle do; the ATE does"
        " not depend on them, but t_rel, r_rel and the end error do: give both for the same sensor"
    ]


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
    warnings = [*truth.remarks, *_check_queries(options, beliefs, truth)]
    tolerances = dict.fromkeys((0, COMMON_TOLERANCE_IMAGES, options.frame_tolerance or 0))
    results = {tolerance: measure_scores(beliefs, truth.required_matrix, tolerance) for tolerance in tolerances}
    metrics: dict[str, object] = {
        "matches": str(options.matches),
        "ground_truth": truth.origin,
        "queries": len(beliefs),
        "rules": {f"tolerance_{tolerance}": section for tolerance, section in results.items()},
        "warnings": warnings,
    }
    if options.out is not None:
        _write(options, options.out, metrics, precision_recall(beliefs, truth.required_matrix))
    lines = [*_lines(truth, beliefs, results), *(f"warning: {warning}" for warning in warnings)]
    return metrics_text(metrics) if json else "\n".join(lines)


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
    frames = options.matches.with_name(FRAMES_FILE)  # of a run, whose table lies beside
    times = read_frames(frames).timestamps if frames.is_file() else None
    truth = read_revisit_truth(options.truth, options.rule, options.fps, times)
    if not truth.required_matrix.any():
        raise DataError(f"{truth.origin}: expected at least one revisit, found none; choose another truth or rule")
    return truth


def _check_queries(options: LoopsOptions, beliefs: Sequence[Belief], truth: RevisitTruth) -> list[str]:
    """Check that the truth has a row for each image; return a remark where the table does not say how many there are.

    Raises:
        DataError: a query is not among the images of the truth, or the table has a line for each image and the truth
            another number of images.
    """
    matches, count = options.matches, len(truth.required_matrix)
    last = max((belief.query for belief in beliefs), default=0)
    if last >= count:
        raise DataError(
            f"{matches}: expected queries below {count}, the images of {options.truth}, found {last};"
            " choose the truth of this recording"
        )
    if len(beliefs) == count:
        return []
    if len(beliefs) == last + 1:  # from 0 without a gap: a line for each image
        raise DataError(
            f"{options.truth}: expected a truth of {len(beliefs)} images, one for each line of {matches}, found"
            f" {count};"
            f" choose the truth of this recording, with one pose for each image{describe_remarks(truth)}"
        )
    return [f"{matches}: {len(beliefs)} lines for {count} images; image i is the one of row i of the truth, from 0"]


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
    from slam.report.style import save_png

    with RunFolder.create(out, options.overwrite) as folder:
        write_metrics(folder.path / "metrics.json", metrics)
        write_curve(folder.path / "precision_recall.csv", curve)
        picture = plot_precision_recall({"all matches": curve}, options.matches.name)
        save_png(picture, folder.path / "precision_recall.png")
        folder.commit()
