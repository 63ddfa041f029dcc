"""Errors of a trajectory against ground truth: ATE, KITTI's t_rel and r_rel, and the end error.

* ATE: root mean square position error after alignment of all poses (Sturm et al., IROS 2012; alignment: Umeyama,
  PAMI 1991).
* t_rel and r_rel: mean errors of segments by the KITTI odometry rule (Geiger et al., CVPR 2012), without alignment.
* End error: distance of the last positions after the first poses are made equal.

Ground truth is always the reference. The choice of these rules: docs/decisions/evaluation_rules.md.

Poses are paired by time where both trajectories have times, else pose by pose. A true pose is interpolated at the time
of an estimated one, as the readers of recordings do: between two true poses at most `MAX_GAP_S` apart. Elsewhere an
estimated pose takes the true pose within `MAX_TIME_DIFFERENCE_S`, and else it has none. The motion between two true
poses is one of constant twist, so a constant delay of one of the clocks costs no ATE.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.datasets.time_sync import MAX_GAP_S, MAX_TIME_DIFFERENCE_S
from slam.errors import DataError
from slam.io.trajectory_reader import Trajectory
from slam.pose_graph.optimization.lie_groups import SE3, inverse

Array = NDArray[np.float64]
Rows = NDArray[np.int64]
Alignment = Literal["se3", "sim3"]

# Lengths and step of the segments as in the devkit of the KITTI odometry benchmark.
SEGMENT_LENGTHS_M = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)
SEGMENT_STEP_FRAMES = 10  # frames between the starts of segments
# Poses 1 to 10 s apart may be 1 to 10 ms apart: only the other trajectory tells.
_UNCLEAR_STEPS_S = (0.9, 10.5)
_MAX_WRONG_SHARE, _MIN_RIGHT_SHARE = 0.2, 0.5  # of the poses that have a partner, as read and divided
_MIN_SPAN_SHARE = 0.1  # of the other's span: all poses within a moment of the other trajectory prove nothing


@dataclass(frozen=True)
class Similarity:
    """A similarity transformation of positions, p -> scale * R @ p + t, metres.

    Attributes:
        R: (d, d) rotation, d = 3 in space or 2 in the plane.
        t: (d,) translation, metres.
        scale: scale factor; 1 for a rigid motion.
    """

    R: Array
    t: Array
    scale: float

    def apply(self, points: Array) -> Array:
        """Transform points (N, d)."""
        return self.scale * points @ self.R.T + self.t

    def apply_poses(self, T_world_camera: Array) -> Array:
        """Transform poses (N, 4, 4): positions as points, orientations by R."""
        out = T_world_camera.copy()
        out[:, :3, :3] = self.R @ T_world_camera[:, :3, :3]
        out[:, :3, 3] = self.apply(T_world_camera[:, :3, 3])
        return out


@dataclass(frozen=True)
class SegmentRule:
    """Which segments of a trajectory the KITTI rule takes.

    Attributes:
        lengths_m: lengths of the segments, metres.
        step_frames: frames between the starts of segments.
    """

    lengths_m: tuple[float, ...] = SEGMENT_LENGTHS_M
    step_frames: int = SEGMENT_STEP_FRAMES


@dataclass(frozen=True)
class SegmentErrors:
    """Mean errors of all segments by the KITTI rule.

    Attributes:
        t_rel_percent: translation error, per cent of the segment length.
        r_rel_deg_per_100m: rotation error, degrees per 100 m.
    """

    t_rel_percent: float
    r_rel_deg_per_100m: float


@dataclass(frozen=True)
class TrajectoryErrors:
    """Errors of one trajectory, named as in metrics.json; None if a value cannot be computed.

    Attributes:
        ate_m: root mean square position error after alignment of all poses, metres.
        ate_alignment: alignment of the ATE, "se3" or "sim3".
        t_rel_percent: KITTI translation error, per cent; after scaling if the alignment is sim3.
        r_rel_deg_per_100m: KITTI rotation error, degrees per 100 m.
        end_error_m: distance of the last positions, first poses made equal, metres; after scaling as above.
        end_error_percent: the same, per cent of the path length.
        reasons: reason why a value is None, by the name of the value.
    """

    ate_m: float | None
    ate_alignment: Alignment | None
    t_rel_percent: float | None
    r_rel_deg_per_100m: float | None
    end_error_m: float | None
    end_error_percent: float | None
    reasons: dict[str, str] = field(default_factory=dict)

    def as_metrics(self) -> dict[str, object]:
        """Return the errors without the reasons, for metrics.json."""
        return {name: value for name, value in vars(self).items() if name != "reasons"}


def unknown_errors(reason: str) -> TrajectoryErrors:
    """Return errors that are all unknown, such as those of a recording without ground truth."""
    errors = TrajectoryErrors(None, None, None, None, None, None)
    errors.reasons.update(dict.fromkeys(errors.as_metrics(), reason))
    return errors


def trajectory_errors(estimate: Array, truth: Array, alignment: Alignment = "se3") -> TrajectoryErrors:
    """Compute all errors of an estimated trajectory.

    Args:
        estimate: estimated poses T_world_camera (N, 4, 4), metres.
        truth: true poses (N, 4, 4), metres, in any world frame.
        alignment: "se3" for stereo; "sim3" for one camera, whose scale is unknown: all errors then use the scale of the
            alignment.

    Raises:
        DataError: the two have different numbers of poses.
    """
    _check_lengths(estimate, truth)
    fit = umeyama(estimate[:, :3, 3], truth[:, :3, 3], alignment)
    # A rigid motion changes neither the segment errors nor the end error, so the aligned trajectory serves for all.
    aligned = fit.apply_poses(estimate)
    segments = kitti_errors(aligned, truth)
    end, length_m = end_error(aligned, truth), path_length(truth)
    reasons: dict[str, str] = {}
    if segments is None:
        reason = f"the drive is {length_m:.1f} m long, segments need {SEGMENT_LENGTHS_M[0]:.0f} m"
        reasons |= dict.fromkeys(("t_rel_percent", "r_rel_deg_per_100m"), reason)
    if length_m == 0:
        reasons["end_error_percent"] = "the camera does not move in the ground truth"
    return TrajectoryErrors(
        ate_m=_rms(aligned[:, :3, 3] - truth[:, :3, 3]),
        ate_alignment=alignment,
        t_rel_percent=None if segments is None else segments.t_rel_percent,
        r_rel_deg_per_100m=None if segments is None else segments.r_rel_deg_per_100m,
        end_error_m=end,
        end_error_percent=None if length_m == 0 else 100.0 * end / length_m,
        reasons=reasons,
    )


def umeyama(source: Array, target: Array, alignment: Alignment = "se3") -> Similarity:
    """Align positions (N, d) to target (N, d), metres, by least squares (Umeyama 1991, eq. 34 to 43).

    If the positions do not determine the rotation (all on one line, or at one point), one of the best is returned. The
    scale of positions that do not move is 1.
    """
    mean_source, mean_target = source.mean(axis=0), target.mean(axis=0)
    spread = source - mean_source
    U, singular, Vt = np.linalg.svd((target - mean_target).T @ spread / len(source))
    # Flip the last singular direction if the best orthogonal matrix would be a reflection (eq. 39 and 43).
    signs = np.ones(len(singular))
    signs[-1] = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    R = (U * signs) @ Vt
    # Eq. 42: the scale is the trace of D S over the variance of the source; without variance it is undefined.
    variance = float((spread**2).sum() / len(source))
    scale = float(singular @ signs) / variance if alignment == "sim3" and variance > 0 else 1.0
    return Similarity(R, mean_target - scale * R @ mean_source, scale)


def absolute_trajectory_error(estimate: Array, truth: Array, alignment: Alignment = "se3") -> float:
    """Compute the ATE, metres, of T_world_camera (N, 4, 4) after alignment of all poses.

    Raises:
        DataError: the two have different numbers of poses.
    """
    _check_lengths(estimate, truth)
    positions, target = estimate[:, :3, 3], truth[:, :3, 3]
    return _rms(umeyama(positions, target, alignment).apply(positions) - target)


def kitti_errors(estimate: Array, truth: Array, rule: SegmentRule | None = None) -> SegmentErrors | None:
    """Compute mean errors over segments, by default of 100 to 800 m that start at every tenth frame; no alignment.

    A segment ends at the first frame whose path length from its start exceeds the segment length, as in KITTI's devkit.
    The rotation angle is computed differently (see `_angles`): with ground truth of seven digits the formula of the
    devkit gives 0.06 to 0.3 deg/100 m more for a good trajectory. State this beside published figures.

    Returns:
        The errors, or None if the path is shorter than every segment.
    """
    starts, ends, lengths = _segments(distances_along(truth), rule or SegmentRule())
    if len(starts) == 0:
        return None
    motion_truth = se3.inverse(truth[starts]) @ truth[ends]
    motion_estimate = se3.inverse(estimate[starts]) @ estimate[ends]
    # Relative motions need no alignment: a world transformation of the estimate cancels.
    errors = se3.inverse(motion_estimate) @ motion_truth
    translation = np.linalg.norm(errors[:, :3, 3], axis=1) / lengths
    rotation = np.degrees(_angles(errors)) / lengths
    return SegmentErrors(100.0 * float(translation.mean()), 100.0 * float(rotation.mean()))


def end_error(estimate: Array, truth: Array) -> float:
    """Distance of the last positions of two trajectories (N, 4, 4), metres, after their first poses are made equal."""
    last = se3.inverse(estimate[0]) @ estimate[-1], se3.inverse(truth[0]) @ truth[-1]
    return float(np.linalg.norm(last[0][:3, 3] - last[1][:3, 3]))


def distances_along(T_world_camera: Array) -> Array:
    """Path length up to each pose (N,), metres, of poses (N, 4, 4)."""
    steps = np.linalg.norm(np.diff(T_world_camera[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def path_length(T_world_camera: Array) -> float:
    """Path length of a trajectory (N, 4, 4), metres."""
    return float(distances_along(T_world_camera)[-1])


def _segments(distances_m: Array, rule: SegmentRule) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    starts = np.repeat(np.arange(0, len(distances_m), rule.step_frames), len(rule.lengths_m))
    lengths = np.tile(rule.lengths_m, len(starts) // len(rule.lengths_m))
    ends = np.searchsorted(distances_m, distances_m[starts] + lengths, side="right")
    fits = ends < len(distances_m)
    return starts[fits], ends[fits], lengths[fits]


def _angles(T: Array) -> Array:
    # The devkit uses arccos of the trace alone, whose derivative is infinite at angle 0: the rounding of seven-digit
    # ground truth becomes 0.06 degrees. The arc tangent of sine and cosine has no such error.
    R = T[:, :3, :3]
    axis = [R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]]
    return np.arctan2(np.linalg.norm(axis, axis=0), np.trace(R, axis1=1, axis2=2) - 1.0)


def _rms(differences: Array) -> float:
    return float(np.sqrt((differences**2).sum(axis=1).mean()))


def _check_lengths(estimate: Array, truth: Array) -> None:
    if len(estimate) != len(truth) or len(truth) == 0:
        raise DataError(
            f"expected one estimated pose for each of {len(truth)} true ones, found {len(estimate)};"
            " compare trajectories of the same recording"
        )


@dataclass(frozen=True)
class PosePairs:
    """Estimated poses that have a true one.

    Attributes:
        estimate: (N, 4, 4) estimated poses, metres.
        truth: (N, 4, 4) true poses at the same times, metres.
        rows: (N,) rows of the estimated poses in their trajectory, increasing.
    """

    estimate: Array
    truth: Array
    rows: Rows


def pair_by_time(estimate: Trajectory, truth: Trajectory) -> PosePairs:
    """Pair poses of two trajectories that both have times."""
    assert estimate.times is not None
    assert truth.times is not None
    times, true_times = estimate.times, truth.times
    between = _rows_between(times, true_times)
    near, true_rows = _rows_near(times, true_times)
    alone = ~np.isin(near, between)
    rows = np.concatenate([between, near[alone]])
    poses = np.concatenate([_interpolate(times[between], true_times, truth.poses), truth.poses[true_rows[alone]]])
    order = np.argsort(rows)
    return PosePairs(estimate.poses[rows[order]], poses[order], rows[order])


def scale_to_other(path: Path, trajectory: Trajectory, other: Trajectory) -> Trajectory:
    """Divide times by a thousand, with a remark, where the step leaves the unit open and only so they fit the other's.

    Args:
        path: file of the trajectory, for the remark.
        trajectory: poses with or without times.
        other: trajectory of the same drive.
    """
    times, others = trajectory.times, other.times
    if times is None or others is None or len(times) < 2 or len(others) < 2:
        return trajectory
    step, scaled = float(np.median(np.diff(times))), times / 1e3
    is_unclear = _UNCLEAR_STEPS_S[0] <= step <= _UNCLEAR_STEPS_S[1]
    if not is_unclear or np.ptp(scaled) < _MIN_SPAN_SHARE * np.ptp(others):
        return trajectory
    if _matched_share(times, others) >= _MAX_WRONG_SHARE or _matched_share(scaled, others) < _MIN_RIGHT_SHARE:
        return trajectory
    remark = (
        f"{path}: the times are {times[0]:g} to {times[-1]:g} in steps of {step:g} and fit the others only if divided"
        " by 1000, and were"
    )
    return replace(trajectory, times=scaled, remarks=(*trajectory.remarks, remark))


def _matched_share(times: Array, others: Array) -> float:
    """Return which share of the times (N,) has a partner among others (M,), or of the others, whichever is larger."""
    pairs = ((times, others), (others, times))
    return max(len(np.union1d(_rows_between(a, b), _rows_near(a, b)[0])) / len(a) for a, b in pairs)


def _rows_between(times: Array, true_times: Array) -> Rows:
    """Return the rows of times (N,) that lie between two true ones that are close enough for interpolation."""
    if len(true_times) < 2:
        return np.zeros(0, np.int64)
    before = np.clip(np.searchsorted(true_times, times, side="right") - 1, 0, len(true_times) - 2)
    is_inside = (times >= true_times[0]) & (times <= true_times[-1])
    return np.flatnonzero(is_inside & (np.diff(true_times)[before] <= MAX_GAP_S))


def _interpolate(times: Array, true_times: Array, poses: Array) -> Array:
    """Return true poses (N, 4, 4) at times (N,) between the first and the last of at least two true ones."""
    if not len(times):
        return np.zeros((0, 4, 4))
    before = np.clip(np.searchsorted(true_times, times, side="right") - 1, 0, len(true_times) - 2)
    share = (times - true_times[before]) / (true_times[before + 1] - true_times[before])
    twist = SE3().log(inverse(poses[before]) @ poses[before + 1])
    return np.asarray(poses[before] @ SE3().exp(share[:, None] * twist))


def _rows_near(times: Array, true_times: Array) -> tuple[Rows, Rows]:
    """Return rows of times (N,) and of the true times within the bound; each true one serves its nearest time alone."""
    after = np.clip(np.searchsorted(true_times, times), 1, max(len(true_times) - 1, 1))
    candidates = np.clip(np.stack([after - 1, after]), 0, len(true_times) - 1)
    differences = np.abs(true_times[candidates] - times)
    nearest, difference = candidates[differences.argmin(axis=0), np.arange(len(times))], differences.min(axis=0)
    by_difference = np.argsort(difference, kind="stable")
    _, first = np.unique(nearest[by_difference], return_index=True)
    rows = np.sort(by_difference[first])
    rows = rows[difference[rows] <= MAX_TIME_DIFFERENCE_S]
    return rows, nearest[rows]
