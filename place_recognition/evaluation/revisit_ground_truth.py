"""Ground truth of revisits: matrices from poses, or from the files that authors publish.

A truth matrix is (N, N) bool, row = query, column = an earlier image, True = the same place; the rest is False.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from place_recognition.evaluation.ground_truth_files import array_names, read_array, read_positive

Array = NDArray[np.float64]
Truth = NDArray[np.bool_]

_BLOCK = 256  # rows computed at a time: all N^2 distances of a long recording at once would need a gigabyte


@dataclass(frozen=True)
class RevisitRule:
    """The rule by which two poses count as one place, for published datasets, runs and simulations alike.

    The figures of the literature depend on this rule, so it is one object with every number in it.

    Attributes:
        max_distance_m: maximum distance of the positions. In the matrices of the chapter's authors half of the pairs
            with one viewing direction are one place up to 16 m (KITTI 00), 11 m (05) and 6 m (02, 06).
        max_angle_deg: maximum angle between the viewing directions; 180 admits every direction.
        min_time_gap_s: minimum time between the images; 40 in most papers. 0 needs no times.
        min_path_length_m: minimum length of the path between the images. Neighbours on the road never count, and a stop
            is no revisit, however short the recording.
        is_one_to_one: whether only the nearest of the earlier images that the rest admits is the same place.
    """

    max_distance_m: float = 10.0
    max_angle_deg: float = 45.0
    min_time_gap_s: float = 0.0
    min_path_length_m: float = 20.0
    is_one_to_one: bool = False


def truth_from_poses(T_world_camera: Array, timestamps: Array | None = None, rule: RevisitRule | None = None) -> Truth:
    """Compute the truth matrix (N, N) of poses under a rule; the viewing direction is the camera's z axis.

    Args:
        T_world_camera: (N, 4, 4) finite poses, metres.
        timestamps: (N,) seconds; not needed by a rule without `min_time_gap_s`.
        rule: definition of one place; None for the default.

    Raises:
        ValueError: the poses are not finite matrices of 4 x 4, there are more or fewer times than poses, or there are
            no times but the rule needs them.
    """
    rule = rule or RevisitRule()
    poses = _checked(T_world_camera)
    positions, directions = poses[:, :3, 3], poses[:, :3, 2]
    path_lengths_m, times = _path_lengths_m(positions), _checked_times(timestamps, len(poses), rule)
    truth = np.zeros((len(poses), len(poses)), np.bool_)
    for first in range(0, len(poses), _BLOCK):
        query = np.arange(first, min(first + _BLOCK, len(poses)))
        earlier = np.arange(query[-1] + 1)
        distances = cdist(positions[query], positions[earlier])
        same = (distances <= rule.max_distance_m) & (earlier < query[:, None])
        same &= directions[query] @ directions[earlier].T >= np.cos(np.radians(rule.max_angle_deg)) - 1e-12
        same &= path_lengths_m[query, None] - path_lengths_m[earlier] >= rule.min_path_length_m
        same &= times[query, None] - times[earlier] >= rule.min_time_gap_s
        truth[first : first + len(query), : len(earlier)] = _nearest(same, distances) if rule.is_one_to_one else same
    return truth


def _checked(T_world_camera: Array) -> Array:
    poses = np.asarray(T_world_camera, np.float64)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or not np.isfinite(poses).all():
        raise ValueError(f"expected finite poses (N, 4, 4), got {poses.shape}")
    return poses


def _checked_times(timestamps: Array | None, count: int, rule: RevisitRule) -> Array:
    if timestamps is None:
        if rule.min_time_gap_s > 0:
            raise ValueError(
                f"expected the times of the {count} poses for a gap of {rule.min_time_gap_s:g} s, got none"
            )
        return np.zeros(count)
    times = np.asarray(timestamps, np.float64)
    if times.shape != (count,):
        raise ValueError(f"expected as many times as there are poses, {count}, got {times.shape}")
    return times


def _path_lengths_m(positions: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])[: len(positions)]


def _nearest(same: Truth, distances: Array) -> Truth:
    """Keep only the True cell of the smallest distance in each row."""
    nearest = np.argmin(np.where(same, distances, np.inf), axis=1)
    return same & (np.arange(same.shape[1]) == nearest[:, None])


def load_truth(path: Path) -> Truth:
    """Read a truth matrix (N, N) from a file: .npz with `truth`, or a MATLAB .mat with one square matrix.

    A matrix for both directions of time keeps its lower triangle; one with an upper triangle only is turned.

    Raises:
        ValueError: the file holds no such matrix.
    """
    matrix = _matrix_in(path)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise ValueError(f"{path}: expected a square truth matrix (N, N), found {matrix.shape}")
    if matrix.dtype.kind not in "biuf":
        raise ValueError(f"{path}: expected a truth matrix of numbers, found {matrix.dtype}")
    truth = np.greater(matrix, 0)
    lower, upper = np.tril(truth, -1), np.triu(truth, 1)
    return lower if lower.any() or not upper.any() else np.ascontiguousarray(upper.T)


def _matrix_in(path: Path) -> NDArray[np.generic]:
    if not path.is_file():
        raise ValueError(f"{path}: expected a truth file, found none; check the path")
    if path.suffix == ".npz":
        return _matrix_in_numpy(path)
    if path.suffix == ".mat":
        return _matrix_in_matlab(path)
    raise ValueError(f"{path}: expected a truth file .npz or .mat, found {path.suffix or 'no suffix'}")


def _matrix_in_numpy(path: Path) -> NDArray[np.generic]:
    try:
        truth = read_array(path, "truth")
    except ValueError as error:
        raise ValueError(f"{path}: expected an intact .npz file, found a damaged one ({error})") from error
    if truth is None:
        raise ValueError(f"{path}: expected an array named truth, found {', '.join(array_names(path)) or 'none'}")
    return truth


def _matrix_in_matlab(path: Path) -> NDArray[np.generic]:
    try:
        matrices = read_positive(path)
    except ValueError as error:
        raise ValueError(
            f"{path}: expected an intact MATLAB file of version 4 to 7.2, found another: {error}"
        ) from error
    if len(matrices) != 1:
        raise ValueError(f"{path}: expected one matrix of numbers, found {', '.join(matrices) or 'none'}")
    return next(iter(matrices.values()))
