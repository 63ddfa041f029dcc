"""`revisit evaluate trajectory`: errors of an estimated trajectory file against a true one."""

import json as json_format
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.errors import DataError
from slam.evaluation.trajectory import TrajectoryErrors, path_length, trajectory_errors
from slam.storage.trajectory import read_trajectory

Array = NDArray[np.float64]

MAX_TIME_DIFFERENCE_S = 0.01  # largest difference of the timestamps of two poses that are compared

_LINES = {
    "ate_m": "ATE, metres",
    "t_rel_percent": "t_rel, per cent",
    "r_rel_deg_per_100m": "r_rel, degrees per 100 m",
    "end_error_m": "end error, metres",
    "end_error_percent": "end error, % of the path length",
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
        DataError: a file is missing or damaged, or the two are not of the same drive.
    """
    poses, reference = _read_pairs(estimate, truth)
    errors = trajectory_errors(poses, reference, "sim3" if mono else "se3")
    size: dict[str, object] = {"poses": len(poses), "path_length_m": path_length(reference)}
    if json:
        return json_format.dumps(size | errors.as_metrics() | {"notes": errors.reasons}, indent=2)
    return "\n".join([f"{len(poses)} poses, {path_length(reference):.1f} m", *_format_lines(errors)])


def _format_lines(errors: TrajectoryErrors) -> list[str]:
    values = errors.as_metrics()
    shown = {name: errors.reasons.get(name) or f"{values[name]:.4g}" for name in _LINES}
    shown["ate_m"] += f"  {_ALIGNMENTS[str(errors.ate_alignment)]}"
    return [f"{title:<31} {shown[name]}" for name, title in _LINES.items()]


def _read_pairs(estimate: Path, truth: Path) -> tuple[Array, Array]:
    times, poses = read_trajectory(estimate)
    reference_times, reference = read_trajectory(truth)
    if times is not None and reference_times is not None:
        ours, theirs = _associate(times, reference_times)
        if len(ours) < 2:
            raise DataError(
                f"{estimate}: expected times within {MAX_TIME_DIFFERENCE_S} s of those in {truth},"
                f" found {len(ours)} of {len(times)}; compare files of the same drive"
            )
        return poses[ours], reference[theirs]
    if len(poses) != len(reference):
        raise DataError(
            f"{estimate}: expected {len(reference)} poses as in {truth}, found {len(poses)};"
            " compare files of the same drive, or give both as TUM"
        )
    return poses, reference


def _associate(times: Array, reference: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    # Each pose is paired with the reference nearest in time; of several poses with one reference the nearest stays.
    # `order` because a reference need not be sorted by time.
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
