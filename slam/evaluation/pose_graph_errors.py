"""Ground truth of a stored graph: where its poses were, and which of its loops are true."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.errors import DataError
from slam.evaluation.trajectory_errors import umeyama
from slam.io.files import read_numbers
from slam.io.g2o import Graph
from slam.io.trajectory_reader import read_trajectory

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

LABELS = "_GT_LC.txt"  # beside GRAPH.g2o: pairs of ids of its true loops
# Planes of a truth by the axis (x, y, z) that they leave out, each as the signed axes of the plane's x and y. KITTI's
# camera looks along z with x to the right: in the plane x is forward and y to the left.
_PLANES = {1: ("z, -x", (2, 0), (1.0, -1.0)), 2: ("x, y", (0, 1), (1.0, 1.0)), 0: ("y, z", (1, 2), (1.0, 1.0))}
_KITTI_UP = 1
_MAX_FLATNESS = 0.4  # spread along the axis left out, against the middle one; KITTI's hills reach 0.36
_MIN_WIDTH = 0.05  # spread along y, against the largest, that is a motion: on a straight road noise decides
_NO_POSES = "no ground truth was given"
_NO_LABELS = f"there is no list of true loops beside the graph (GRAPH{LABELS})"


@dataclass(frozen=True)
class GraphTruth:
    """Ground truth of a graph.

    Attributes:
        positions: (N, n - 1) true positions of the poses by id, metres, or None.
        loops: (L,) bool, which loops are true, in the file's order, or None.
        warnings: what of the files was changed or could not be used, a sentence each.
    """

    positions: Array | None
    loops: Mask | None
    warnings: tuple[str, ...] = ()

    @staticmethod
    def missing_reason(name: str) -> str:
        """Return why a value of metrics.json is missing."""
        return _NO_POSES if name.startswith("ate") else _NO_LABELS


def find_truth(path: Path, graph: Graph, trusted: Mask, ground_truth: Path | None) -> GraphTruth:
    """Find the ground truth of a graph's poses in a file or a folder, and of its loops in the list beside the graph.

    The pose of id i is that of line i, counted from zero. Of a planar graph the truth is taken in the plane in which it
    moves: KITTI's (z, -x) unless another is clearly the plane.

    Args:
        path: file of the graph.
        graph: the graph as read.
        trusted: (M,) bool, edges that are not loops.
        ground_truth: file of poses (KITTI, TUM), or a folder of such files, or None.

    Raises:
        DataError: a file is missing or damaged, or has too few poses.
    """
    positions: Array | None = None
    remarks: tuple[str, ...] = ()
    if ground_truth is not None:
        file = _file_for(path, ground_truth) if ground_truth.is_dir() else ground_truth
        positions, remarks = _positions(file, graph)
    loops, unknown = _labels(path, graph, trusted)
    return GraphTruth(positions, loops, (*remarks, *unknown))


def _file_for(path: Path, folder: Path) -> Path:
    """Return the file of a folder whose name is a word of the graph's name: `05.txt` for `kitti_05_alpha_0.15.g2o`."""
    words = re.split(r"[_\-\s]", path.stem)
    found = [file for file in sorted(folder.iterdir()) if file.is_file() and file.stem in words]
    if len(found) != 1:
        names = ", ".join(file.name for file in found) or "none"
        raise DataError(
            f"{folder}: expected one file of poses named as a word of {path.stem}, found {names}; name the file itself"
        )
    return found[0]


def _positions(file: Path, graph: Graph) -> tuple[Array, tuple[str, ...]]:
    trajectory = read_trajectory(file)
    if trajectory.num_left_out:
        raise DataError(
            f"{'; '.join(trajectory.remarks)}; expected a pose in each line, as line i is the pose of id i;"
            " complete the file"
        )
    poses, ids = trajectory.poses, np.sort(graph.ids)
    if ids[0] < 0 or ids[-1] >= len(poses):
        raise DataError(
            f"{file}: expected a pose for each id from {ids[0]} to {ids[-1]} of the graph, found {len(poses)} poses; "
            "give the truth of the same recording"
        )
    positions = poses[ids, :3, 3]
    if graph.poses.shape[-1] != 3:
        return positions, trajectory.remarks
    planar, remark = _in_plane(file, positions)
    return planar, (*trajectory.remarks, *remark)


def _in_plane(file: Path, positions: Array) -> tuple[Array, list[str]]:
    """Return true positions (N, 3) in the plane (N, 2) in which they move, and a remark unless it is KITTI's."""
    spread = positions.std(axis=0)
    up = min(_PLANES, key=lambda axis: float(spread[axis]))  # of equal ones the first
    across, middle, along = np.sort(spread)
    is_flat = across <= _MAX_FLATNESS * middle
    if up != _KITTI_UP and not (is_flat and spread[_KITTI_UP] > _MIN_WIDTH * along):
        up, is_flat = _KITTI_UP, False
    name, axes, signs = _PLANES[up]
    moves = f"the truth spreads by {spread[0]:.3g}, {spread[1]:.3g} and {spread[2]:.3g} m along x, y and z"
    planar = positions[:, list(axes)] * signs
    if not is_flat:
        return planar, [
            f"{file}: {moves}, which is no clear plane; KITTI's ({name}) is taken, so turn the truth if y is not up or"
            " down"
        ]
    return planar, [] if up == _KITTI_UP else [f"{file}: {moves}; its plane is taken as ({name}), not KITTI's (z, -x)"]


def _labels(path: Path, graph: Graph, trusted: Mask) -> tuple[Mask | None, list[str]]:
    """Return which loops are listed as true, and a sentence about listed pairs that are no loops of the graph."""
    file = path.with_name(path.stem + LABELS)
    if not file.is_file():
        return None, []
    # An empty list is an answer too: none of the loops is true.
    listed = {(int(min(pair)), int(max(pair))) for pair in read_numbers(file, 2, min_rows=0)}
    ends = np.sort(np.column_stack([graph.first[~trusted], graph.second[~trusted]]), axis=1)
    loops = [(first, second) for first, second in ends.tolist()]
    unknown = sorted(listed - set(loops))
    warnings = []
    if unknown:
        first, second = unknown[0]
        warnings = [
            f"{file}: passed over {len(unknown)} pairs that are no loops of the graph, such as {first} {second}"
        ]
    return np.array([pair in listed for pair in loops], dtype=bool), warnings


def align_positions(estimate: Array, positions: Array) -> Array:
    """Align positions (N, d) with true ones (N, d), metres, by the best rigid motion."""
    return umeyama(estimate, positions).apply(estimate)


def absolute_error(poses: Array, positions: Array | None) -> float | None:
    """Return the ATE, metres, of poses (N, n, n) after rigid alignment to positions (N, n - 1); None without truth."""
    if positions is None:
        return None
    difference = align_positions(poses[:, :-1, -1], positions) - positions
    return float(np.sqrt(np.square(difference).sum(axis=1).mean()))
