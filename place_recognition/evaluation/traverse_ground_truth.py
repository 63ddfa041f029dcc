"""Ground truth of two recordings: which images of a reference show the place of each image of a query recording.

A truth has two matrices (N, M), row = query, column = reference image. In the hard one are the images that must be
found, in the other those that are tolerated: neither right nor wrong. So it is done in Schubert, Neubert, Garg,
Milford, Fischer, 'Visual Place Recognition: A Tutorial', IEEE Robotics and Automation Magazine 31(3) 2024, whose soft
truth is both of ours together.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from place_recognition.evaluation.ground_truth_files import NumberMatrix, array_names, read_array, read_matrices
from place_recognition.evaluation.matlab_process import count_nans, count_values
from place_recognition.evaluation.revisit_ground_truth import MAX_TRUTH_VALUES, MIN_IMAGES_FOR_SHARE

Array = NDArray[np.float64]
Truth = NDArray[np.bool_]

# Names of the matrices in files: ours, and those of the tutorial's data sets, whose rows are reference images.
_HARD, _SOFT = "truth", "soft"
_TUTORIAL_HARD, _TUTORIAL_SOFT = "GThard", "GTsoft"
_BLOCK = 256  # queries computed at a time


@dataclass(frozen=True)
class TraverseTruth:
    """Which images of a reference show the place of each query.

    Attributes:
        hard: (N, M) bool, the pairs to be found.
        tolerated: (N, M) bool, pairs that count neither as right nor as wrong, none of them hard; None for none.
        remarks: how a file was taken where it can be taken in several ways.
    """

    hard: Truth
    tolerated: Truth | None = None
    remarks: tuple[str, ...] = ()

    @classmethod
    def of(cls, hard: Truth, soft: Truth | None, remarks: tuple[str, ...] = ()) -> "TraverseTruth":
        """Make a truth of a hard and a soft matrix; what is soft alone is tolerated."""
        return cls(hard, None if soft is None else soft & ~hard, remarks)


def truth_of_equal_numbers(images: int, tolerance: int, soft_tolerance: int | None = None) -> TraverseTruth:
    """Return the truth of two recordings of which the images of one number show one place.

    Args:
        images: number of images of each.
        tolerance: largest difference of the numbers of a pair to be found.
        soft_tolerance: that of a tolerated pair; None to tolerate none.
    """
    apart = np.abs(np.arange(images)[:, None] - np.arange(images))
    return TraverseTruth.of(apart <= tolerance, None if soft_tolerance is None else apart <= soft_tolerance)


def truth_of_positions(
    queries: Array, references: Array, max_distance_m: float, soft_distance_m: float | None = None
) -> TraverseTruth:
    """Return the truth of images that were taken at positions (N, D) and (M, D), metres, of one frame.

    Args:
        queries: (N, D) of the query recording.
        references: (M, D) of the reference.
        max_distance_m: largest distance of a pair to be found.
        soft_distance_m: that of a tolerated pair; None to tolerate none.
    """
    hard = np.zeros((len(queries), len(references)), np.bool_)
    soft = None if soft_distance_m is None else np.zeros_like(hard)
    for first in range(0, len(queries), _BLOCK):
        block = slice(first, first + _BLOCK)
        distances = cdist(queries[block], references)
        hard[block] = distances <= max_distance_m
        if soft is not None:
            soft[block] = distances <= soft_distance_m
    return TraverseTruth.of(hard, soft)


def truth_of_poses(
    T_world_query: Array,
    T_world_reference: Array,
    max_distance_m: float,
    max_angle_deg: float,
    soft_distance_m: float | None = None,
) -> TraverseTruth:
    """Return the truth of images with poses (N, 4, 4) and (M, 4, 4) in one frame; cameras look along z.

    Args:
        T_world_query: (N, 4, 4) of the query recording, metres.
        T_world_reference: (M, 4, 4) of the reference.
        max_distance_m: largest distance of a pair to be found.
        max_angle_deg: largest angle between the viewing directions of a pair, to be found or tolerated.
        soft_distance_m: largest distance of a tolerated pair; None to tolerate none.
    """
    near = truth_of_positions(T_world_query[:, :3, 3], T_world_reference[:, :3, 3], max_distance_m, soft_distance_m)
    cosines = T_world_query[:, :3, 2] @ T_world_reference[:, :3, 2].T
    alike = cosines >= np.cos(np.radians(max_angle_deg)) - 1e-12
    return TraverseTruth(near.hard & alike, None if near.tolerated is None else near.tolerated & alike)


def read_traverse_truth(path: Path, shape: tuple[int, int]) -> TraverseTruth:
    """Read the truth of N queries and M reference images from a file: .npz, or a MATLAB .mat.

    An .npz holds `truth` (N, M) and perhaps `soft` (N, M), or `GThard` and `GTsoft` (M, N) as the tutorial has them. A
    .mat holds matrices of these names, or one matrix that fits. A matrix (M, N) is turned.

    Args:
        path: file to read.
        shape: N and M.

    Raises:
        ValueError: the file holds no such matrix; the message ends with what to do.
    """
    if not path.is_file():
        raise ValueError(f"{path}: expected a truth file, found none; check the path")
    suffix = path.suffix.lower()
    matrices = _numpy_matrices(path) if suffix == ".npz" else _matlab_matrices(path)
    hard_name = _find_hard(path, matrices, shape)
    soft_name = _TUTORIAL_SOFT if hard_name == _TUTORIAL_HARD else _SOFT
    hard, remarks = _turn(path, hard_name, matrices[hard_name], shape)
    if soft_name not in matrices:
        return TraverseTruth(hard, None, remarks)
    soft, more = _turn(path, soft_name, matrices[soft_name], shape)
    return TraverseTruth.of(hard, soft, (*remarks, *more))


def _numpy_matrices(path: Path) -> dict[str, NumberMatrix]:
    try:
        names = array_names(path)
        wanted = [name for name in (_HARD, _SOFT, _TUTORIAL_HARD, _TUTORIAL_SOFT) if name in names]
        arrays: dict[str, Any] = {name: read_array(path, name) for name in wanted}
    except Exception as error:  # the library lets whatever a damaged byte provokes through
        raise ValueError(
            f"{path}: expected an intact .npz file, found a damaged one ({' '.join(str(error).split())}); copy it again"
        ) from error
    for name, array in arrays.items():
        if array.ndim != 2 or array.dtype.kind not in "biuf":
            found = f"{array.dtype} {array.shape}"
            raise ValueError(f"{path}: expected a matrix of numbers in {name}, found {found}; save 0 and 1")
    if not arrays:
        found = ", ".join(names) or "none"
        raise ValueError(f"{path}: expected an array named truth, found {found[:80]}; name it truth")
    return {
        name: NumberMatrix(np.greater(array, 0), count_values(array), count_nans(array))
        for name, array in arrays.items()
    }


def _matlab_matrices(path: Path) -> dict[str, NumberMatrix]:
    try:
        return read_matrices(path)
    except ValueError as error:
        raise ValueError(
            f"{path}: expected an intact MATLAB file of version 4 to 7.2, found another: {error}; copy it again, or"
            " save it with -v7"
        ) from error


def _find_hard(path: Path, matrices: dict[str, NumberMatrix], shape: tuple[int, int]) -> str:
    """Return the name of the hard matrix: a known one, else the only one that fits."""
    for name in (_HARD, _TUTORIAL_HARD):
        if name in matrices:
            return name
    fitting = [name for name, matrix in matrices.items() if matrix.positive.shape in (shape, shape[::-1])]
    if len(fitting) == 1:
        return fitting[0]
    found = ", ".join(f"{name} {matrix.positive.shape}" for name, matrix in matrices.items()) or "none"
    raise ValueError(
        f"{path}: expected one matrix of {shape[0]} queries and {shape[1]} reference images, found {found[:120]}; save"
        " the truth of these two recordings as truth"
    )


def _turn(path: Path, name: str, matrix: NumberMatrix, shape: tuple[int, int]) -> tuple[Truth, tuple[str, ...]]:
    """Return a matrix with a row for each query, and a remark where it was turned."""
    found = matrix.positive.shape
    if found not in (shape, shape[::-1]):
        raise ValueError(
            f"{path}: expected {name} with {shape[0]} queries and {shape[1]} reference images, found {found}; choose"
            " the truth of these two recordings"
        )
    if matrix.num_values > MAX_TRUTH_VALUES:
        raise ValueError(
            f"{path}: expected 0 and 1 (1 = the same place) in {name}, found more different values, such as scores or"
            " distances; compare them with a threshold first"
        )
    if 2 * np.count_nonzero(matrix.positive) > matrix.positive.size and min(shape) >= MIN_IMAGES_FOR_SHARE:
        raise ValueError(
            f"{path}: expected 1 for the same place and 0 for another in {name}, found that most pairs of images are"
            " the same place; exchange 0 and 1 if 0 is the same place"
        )
    is_tutorial = name in (_TUTORIAL_HARD, _TUTORIAL_SOFT)
    if found == shape and not (is_tutorial and found == shape[::-1]):
        return matrix.positive, ()
    remark = f"{path}: {name} is read with a row for each reference image"
    return np.ascontiguousarray(matrix.positive.T), (remark,)
