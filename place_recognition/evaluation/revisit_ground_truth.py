"""Ground truth of revisits: matrices from poses, or from the files that authors publish.

A truth matrix is (N, N) bool, row = query, column = an earlier image, True = the same place; the rest is False.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from place_recognition.evaluation.ground_truth_files import NumberMatrix, array_names, read_array, read_matrices
from place_recognition.evaluation.matlab_process import MAX_VALUES, count_nans, count_values
from place_recognition.evaluation.precision_recall import Truth as AnyTruth
from place_recognition.evaluation.precision_recall import is_correct
from place_recognition.recognizer import Belief

Array = NDArray[np.float64]
Truth = NDArray[np.bool_]

MAX_TRUTH_VALUES = 3  # different numbers in a truth: 0 and 1, perhaps a mark for what is not known
MIN_IMAGES_FOR_SHARE = 10  # in fewer images most pairs may be the same place
_HDF5, _HDF5_AT = b"\x89HDF\r\n\x1a\n", 512  # begins a file of MATLAB 7.3, after MATLAB's own header of that size
_BLOCK = 256  # rows computed at a time: all N^2 distances of a long recording at once would need a gigabyte
_QUERIES, _EARLIER = 32, 4096  # images of a block whose rows are searched for any true cell


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


class PoseTruth:
    """The matrix of `truth_from_poses`, whose cells are computed where they are asked for (a Truth).

    Of a day's drive the matrix itself would take gigabytes.
    """

    def __init__(self, T_world_camera: Array, timestamps: Array | None = None, rule: RevisitRule | None = None) -> None:
        """Take poses, times and the rule, as `truth_from_poses` does.

        Raises:
            ValueError: as there, and for a rule that is one to one.
        """
        self._rule = rule or RevisitRule()
        if self._rule.is_one_to_one:
            raise ValueError("expected a rule that takes each pair by itself, got one that is one to one")
        poses = _checked(T_world_camera)
        self._positions, self._directions = poses[:, :3, 3], poses[:, :3, 2]
        self._path_lengths_m = _path_lengths_m(self._positions)
        self._times = _checked_times(timestamps, len(poses), self._rule)
        self._rows: Truth | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """(N, N)."""
        return len(self), len(self)

    def __len__(self) -> int:
        return len(self._positions)

    def __getitem__(self, cells: tuple[NDArray[np.int64], NDArray[np.int64]], /) -> Truth:
        """Cells of rows and columns, which are broadcast against one another."""
        query, earlier = cells
        rule = self._rule
        apart = np.linalg.norm(self._positions[query] - self._positions[earlier], axis=-1)
        cosines = np.sum(self._directions[query] * self._directions[earlier], axis=-1)
        same = (apart <= rule.max_distance_m) & (earlier < query)
        same &= cosines >= np.cos(np.radians(rule.max_angle_deg)) - 1e-12
        same &= self._path_lengths_m[query] - self._path_lengths_m[earlier] >= rule.min_path_length_m
        same &= self._times[query] - self._times[earlier] >= rule.min_time_gap_s
        return np.asarray(same)

    def any(self, axis: int | None = None) -> Any:
        """Whether there is any true cell: in all, or in each row (N,) with axis 1."""
        if self._rows is None:
            blocks = [np.arange(k, min(k + _QUERIES, len(self))) for k in range(0, len(self), _QUERIES)]
            self._rows = np.concatenate([self._find_any(block) for block in blocks] or [np.zeros(0, np.bool_)])
        return self._rows if axis == 1 else bool(self._rows.any())

    def _find_any(self, queries: NDArray[np.int64]) -> Truth:
        """Whether each of the successive queries (Q,) revisits an earlier image."""
        there = self._positions[queries]
        low, high = there.min(axis=0) - self._rule.max_distance_m, there.max(axis=0) + self._rule.max_distance_m
        found = np.zeros(len(queries), np.bool_)
        for first in range(0, int(queries[-1]), _EARLIER):
            before = self._positions[first : min(first + _EARLIER, int(queries[-1]))]
            near = first + np.flatnonzero(((before >= low) & (before <= high)).all(axis=1))
            left = np.flatnonzero(~found)
            found[left] = self[queries[left, None], near[None]].any(axis=1)
            if found.all():
                break
        return found


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


@dataclass(frozen=True)
class TruthMatrix:
    """A truth matrix of a file.

    Attributes:
        matrix: (N, N) bool, row = query, column = an earlier image.
        remarks: how the file was taken where it can be taken in several ways, and what was left out.
    """

    matrix: Truth
    remarks: tuple[str, ...] = ()


def load_truth(path: Path) -> Truth:
    """Read a truth matrix (N, N) from a file, as `read_truth_matrix` does, without its remarks.

    Raises:
        ValueError: the file holds no such matrix.
    """
    return read_truth_matrix(path).matrix


def read_truth_matrix(path: Path) -> TruthMatrix:
    """Read a truth matrix (N, N) from a file: .npz with `truth`, or a MATLAB .mat with one square matrix.

    The triangle with more entries is the truth: the lower one of a symmetric matrix; an upper one is turned.

    Raises:
        ValueError: the file holds no such matrix; the message ends with what to do.
    """
    found, remarks = _matrix_in(path)
    if found.positive.shape[0] != found.positive.shape[1]:
        raise ValueError(
            f"{path}: expected a square truth matrix (N, N), found {found.positive.shape}; choose the truth of one"
            " recording"
        )
    if found.num_values > MAX_TRUTH_VALUES:
        count = f"{found.num_values}{' or more' if found.num_values == MAX_VALUES else ''}"
        raise ValueError(
            f"{path}: expected 0 and 1 (1 = the same place), found {count} different values, such as scores"
            " or distances; compare them with a threshold first"
        )
    truth, which = _one_triangle(found.positive)
    if 2 * np.count_nonzero(truth) > len(truth) * (len(truth) - 1) / 2 and len(truth) >= MIN_IMAGES_FOR_SHARE:
        raise ValueError(
            f"{path}: expected 1 for the same place and 0 for another, found that most pairs of images are the same"
            " place; exchange 0 and 1 if 0 is the same place"
        )
    if found.num_nans:
        cells = "cell is" if found.num_nans == 1 else "cells are"
        remarks = [*remarks, f"{found.num_nans} {cells} NaN and count as another place; write 0 or 1"]
    remarks = [*remarks, *which, *_describe_neighbours(truth)]
    return TruthMatrix(truth, tuple(f"{path}: {remark}" for remark in remarks))


def _one_triangle(positive: Truth) -> tuple[Truth, list[str]]:
    """Return the triangle with more entries, as a lower one, and a remark about what the other one has besides."""
    lower, upper = np.tril(positive, -1), np.ascontiguousarray(np.triu(positive, 1).T)
    is_upper = np.count_nonzero(upper) > np.count_nonzero(lower)
    used, other = (upper, lower) if is_upper else (lower, upper)
    left_out = np.argwhere(other & ~used)
    if not len(left_out):
        return used, ["the upper triangle is used: row = earlier image, column = query"] if is_upper else []
    row, column = left_out[0] if is_upper else left_out[0, ::-1]
    name, side = ("upper", "below") if is_upper else ("lower", "above")
    entries = "entry" if len(left_out) == 1 else "entries"
    return used, [
        f"the {name} triangle is used with {np.count_nonzero(used)} entries; passed over {len(left_out)} {entries}"
        f" {side} the diagonal without a mirror image (first in row {row}, column {column}, from 0)"
    ]


def _describe_neighbours(truth: Truth) -> list[str]:
    """Say where images count as revisits of the image before them, which no recogniser reports."""
    count = int(np.diagonal(truth, -1).sum())
    if 2 * count <= len(truth):
        return []
    return [f"{count} images are the same place as the image before them, which counts as a revisit to be found"]


def _matrix_in(path: Path) -> tuple[NumberMatrix, list[str]]:
    if not path.is_file():
        raise ValueError(f"{path}: expected a truth file, found none; check the path")
    readers = {".npz": _matrix_in_numpy, ".mat": _matrix_in_matlab}
    suffix = path.suffix.lower()
    if suffix not in readers:
        raise ValueError(
            f"{path}: expected a truth file .npz or .mat, found {path.suffix or 'no suffix'}; save it as one of them"
        )
    return readers[suffix](path)


def _matrix_in_numpy(path: Path) -> tuple[NumberMatrix, list[str]]:
    try:
        truth = read_array(path, "truth")
    except ValueError as error:
        raise ValueError(
            f"{path}: expected an intact .npz file, found a damaged one ({error}); copy it again"
        ) from error
    if truth is None:
        names = ", ".join(array_names(path)) or "none"
        raise ValueError(f"{path}: expected an array named truth, found {names}; name it truth")
    if truth.ndim != 2:
        raise ValueError(f"{path}: expected a square truth matrix (N, N), found {truth.shape}; save one matrix")
    if truth.dtype.kind not in "biuf":
        raise ValueError(f"{path}: expected a truth matrix of numbers, found {truth.dtype}; save 0 and 1")
    return NumberMatrix(np.greater(truth, 0), count_values(truth), count_nans(truth)), []


def _matrix_in_matlab(path: Path) -> tuple[NumberMatrix, list[str]]:
    with path.open("rb") as file:
        begin = file.read(_HDF5_AT + len(_HDF5))
    if begin.startswith(b"MATLAB 7.3") or begin.startswith(_HDF5) or begin.endswith(_HDF5):
        raise ValueError(
            f"{path}: expected a MATLAB file of version 4 to 7.2, found version 7.3 (HDF5); load it in MATLAB or Octave"
            " and save it with -v7"
        )
    if begin.startswith(b"# Created by Octave"):
        raise ValueError(f"{path}: expected a MATLAB file, found Octave's text format; save it with -v7")
    try:
        matrices = read_matrices(path)
    except ValueError as error:
        raise ValueError(
            f"{path}: expected an intact MATLAB file of version 4 to 7.2, found another: {error}; copy it again, or"
            " save it with -v7"
        ) from error
    square = [name for name, matrix in matrices.items() if matrix.positive.shape[0] == matrix.positive.shape[1]]
    chosen = square if len(square) == 1 else list(matrices)
    if len(chosen) != 1:
        names = ", ".join(chosen) or "none"
        raise ValueError(f"{path}: expected one matrix of numbers, found {names}; save the truth alone")
    others = [name for name in matrices if name not in chosen]
    remarks = [f"the truth is {chosen[0]}, the one square matrix; passed over {', '.join(others)}"] if others else []
    return matrices[chosen[0]], remarks


# Images without truth that do not end an event: a second at ten images a second. The holes in the published matrices
# have 1 to 6 images, what lies between two revisits has 13, and mostly 31 or more.
MAX_GAP_IMAGES = 10


@dataclass(frozen=True)
class RevisitEvent:
    """A stretch of queries with truth, and its first detection.

    Attributes:
        first, last: ids of its first and last query with truth.
        detected: id of its first query with an accepted true match; None where there is none.
        answered_at: id of the latest image when the first accepted true match of the event became known, which may be
            that of a later query; None where there is none, or where the beliefs do not say.
    """

    first: int
    last: int
    detected: int | None = None
    answered_at: int | None = None


def find_revisit_events(beliefs: Sequence[Belief], truth: AnyTruth, tolerance: int = 0) -> tuple[RevisitEvent, ...]:
    """Find the revisit events of a recording, and what was recognised of each.

    Args:
        beliefs: one belief for each query.
        truth: (N, N) truth matrix, row = query, column = earlier image. Queries with truth that are at most
            MAX_GAP_IMAGES images without truth apart belong to one event.
        tolerance: images by which a match may miss a true one, as in `is_correct`.
    """
    right = is_correct(beliefs, truth, tolerance)
    detections = sorted((b.query, b.answered_at) for b, r in zip(beliefs, right, strict=True) if r and b.accepted)
    return tuple(_describe(first, last, detections) for first, last in _stretches(truth))


def answer_delays(beliefs: Sequence[Belief]) -> NDArray[np.int64]:
    """Return (K, 2) query and latest image when its belief became ready, of the beliefs that say so."""
    known = [(b.query, b.answered_at) for b in beliefs if b.answered_at is not None]
    return np.array(known, np.int64).reshape(-1, 2)


def _stretches(truth: AnyTruth) -> list[tuple[int, int]]:
    queries = np.flatnonzero(truth.any(axis=1))
    ends = np.flatnonzero(np.diff(queries) > MAX_GAP_IMAGES + 1)
    firsts, lasts = queries[np.append(0, ends + 1)[: len(queries)]], queries[np.append(ends, -1)[: len(queries)]]
    return list(zip(firsts.tolist(), lasts.tolist(), strict=True))


def _describe(first: int, last: int, detections: list[tuple[int, int | None]]) -> RevisitEvent:
    begin = bisect_left(detections, first, key=lambda detection: detection[0])
    inside = detections[begin : bisect_right(detections, last, key=lambda detection: detection[0])]
    ready_at = [ready for _, ready in inside if ready is not None]
    return RevisitEvent(first, last, inside[0][0] if inside else None, min(ready_at, default=None))
