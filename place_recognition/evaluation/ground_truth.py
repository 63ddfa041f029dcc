"""Which images show the same place: matrices from poses or from the files that authors publish.

A truth matrix is (N, N) bool, row = query, column = an earlier image, True = the same place; all else is False.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Truth = NDArray[np.bool_]


@dataclass(frozen=True)
class SamePlace:
    """The rule by which two poses count as one place.

    Attributes:
        radius: greatest distance of the positions, metres.
        heading: greatest angle between the viewing directions, degrees; 180 lets every direction pass.
        gap: least time between the images, seconds.
    """

    radius: float = 6.0
    heading: float = 45.0
    gap: float = 40.0


def truth_from_poses(T_world_camera: Array, timestamps: Array, rule: SamePlace | None = None) -> Truth:
    """Truth matrix (N, N) of poses (N, 4, 4), metres, taken at timestamps (N,), seconds, under a rule.

    The viewing direction is the camera's z axis.
    """
    rule = rule or SamePlace()
    poses, times = np.asarray(T_world_camera, np.float64), np.asarray(timestamps, np.float64)
    if poses.shape != (len(times), 4, 4):
        raise ValueError(f"expected poses ({len(times)}, 4, 4) for as many timestamps, got {poses.shape}")
    positions, directions = poses[:, :3, 3], poses[:, :3, 2]
    truth = np.zeros((len(times), len(times)), np.bool_)
    for query in range(len(times)):  # row by row: (N, N, 3) would not fit into memory for a long drive
        near = np.linalg.norm(positions[:query] - positions[query], axis=1) <= rule.radius
        aligned = directions[:query] @ directions[query] >= np.cos(np.radians(rule.heading)) - 1e-12
        truth[query, :query] = near & aligned & (times[query] - times[:query] >= rule.gap)
    return truth


def load_truth(path: Path) -> Truth:
    """Truth matrix (N, N) from a file: .npz with `truth`, or a MATLAB .mat with one square matrix.

    A matrix for both directions of time keeps its lower triangle; one with an upper triangle only is turned.

    Raises:
        ValueError: the file holds no such matrix.
    """
    matrix = _matrix_in(path)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise ValueError(f"{path}: expected a square truth matrix (N, N), found {matrix.shape}")
    truth = matrix.astype(np.float64) > 0
    lower, upper = np.tril(truth, -1), np.triu(truth, 1)
    return lower if lower.any() or not upper.any() else np.ascontiguousarray(upper.T)


def _matrix_in(path: Path) -> NDArray[np.generic]:
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            if "truth" not in arrays:
                raise ValueError(f"{path}: expected an array named truth, found {', '.join(arrays.files) or 'none'}")
            return np.asarray(arrays["truth"])
    if path.suffix == ".mat":
        return _matrix_in_matlab(path)
    raise ValueError(f"{path}: expected a truth file .npz or .mat, found {path.suffix or 'no suffix'}")


def _matrix_in_matlab(path: Path) -> NDArray[np.generic]:
    from scipy.io import loadmat, matlab

    try:
        variables = loadmat(path)
    except (matlab.MatReadError, ValueError, NotImplementedError) as error:
        raise ValueError(f"{path}: expected a MATLAB file up to version 7.2, found: {error}") from error
    matrices = {name: value for name, value in variables.items() if not name.startswith("__") and np.size(value) > 1}
    if len(matrices) != 1:
        raise ValueError(f"{path}: expected one matrix, found {', '.join(matrices) or 'none'}")
    value = next(iter(matrices.values()))
    return np.asarray(value.toarray() if hasattr(value, "toarray") else value)
