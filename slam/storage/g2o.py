"""Pose graphs as g2o text, in the plane (`VERTEX_SE2`, `EDGE_SE2`) and in space (`VERTEX_SE3:QUAT`, `EDGE_SE3:QUAT`).

In the file an edge's information belongs to the right perturbation of its transform, upper triangle by rows:
x, y, theta in the plane; in space translation first, while `Graph` has our order, rotation first. As GTSAM does,
the three rotation numbers are taken as a rotation vector in radians.

What is repaired, with a warning: an edge from a pose to itself and one of zero information say nothing and go;
information that is zero along some direction gets a billionth of its largest; quaternions and poses are
normalised where rounding explains it. Several edges between two poses are several measurements. Everything else
that is wrong is an error with its line.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.loop_closing import LoopClosure
from slam.pose_graph_lie import planar_poses
from slam.storage.atomic import atomic_writer
from slam.storage.g2o_lines import UPPER, Kind, read_lines_of

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

_SWAPPED = np.array([3, 4, 5, 0, 1, 2])  # rotation first <-> translation first


@dataclass(frozen=True)
class Graph:
    """A pose graph as it stands in a file, in the plane (n = 3, dof 3) or in space (n = 4, dof 6).

    Attributes:
        ids: (N,) of the poses, in the file's order; those of its edges, sorted, where it has no poses.
        poses: (N, n, n) T_world_camera, metres; the identity where the file has none.
        first, second: (M,) ids that each edge joins.
        motions: (M, n, n) T_first_second, metres.
        information: (M, dof, dof) inverse covariances of right perturbations, in GTSAM's order (1/rad^2, 1/m^2).
        fixed: id of the pose that keeps its place (`FIX`), None where the file names none.
        placed: the file says where the poses are.
        warnings: what was repaired or passed over, in plain words.
    """

    ids: Ids
    poses: Array
    first: Ids
    second: Ids
    motions: Array
    information: Array
    fixed: int | None = None
    placed: bool = True
    warnings: tuple[str, ...] = ()


def chain_graph(poses: Array, odometry: Sequence[tuple[Array, Array]], closures: Sequence[LoopClosure]) -> Graph:
    """Make a graph of poses (N, 4, 4), N - 1 motions (4, 4) with covariances (6, 6), and loops."""
    ids = np.arange(len(poses), dtype=np.int64)
    ends = np.array([(c.match, c.query) for c in closures], dtype=np.int64).reshape(-1, 2)
    edges = [*odometry, *((c.T_match_query, c.covariance) for c in closures)]
    return Graph(
        ids=ids,
        poses=poses,
        first=np.concatenate([ids[:-1], ends[:, 0]]),
        second=np.concatenate([ids[1:], ends[:, 1]]),
        motions=np.array([T for T, _ in edges]).reshape(-1, 4, 4),
        information=np.linalg.inv(np.array([covariance for _, covariance in edges]).reshape(-1, 6, 6)),
    )


def write_g2o(path: Path, graph: Graph) -> None:
    """Write a graph, numbers as short as their exact value allows: the same graph gives the same bytes."""
    flat = graph.poses.shape[-1] == 3
    kind = Kind.of("SE2" if flat else "SE3:QUAT")
    rows = _reordered(graph.information)[:, *UPPER[kind.dof]]
    with atomic_writer(path) as file:
        for key, numbers in zip(graph.ids, _numbers(graph.poses), strict=True):
            file.write(f"{kind.vertex} {key} {_words(numbers)}\n")
        for i, j, numbers, row in zip(graph.first, graph.second, _numbers(graph.motions), rows, strict=True):
            file.write(f"{kind.edge} {i} {j} {_words(numbers)} {_words(row)}\n")
        if graph.fixed is not None:
            file.write(f"FIX {graph.fixed}\n")  # last: GTSAM reads no further


def read_g2o(path: Path) -> Graph:
    """Read a graph; lines of other kinds (parameters, comments) are passed over.

    Raises:
        GraphError: no such file, a damaged line, an edge to a pose that is not there, plane and space mixed, or
            neither pose nor edge.
    """
    lines = read_lines_of(path)
    ids = lines.vertex_ids if lines.placed else np.unique(lines.edge_ids)
    size = 3 if lines.kind.dof == 3 else 4
    unplaced = np.tile(np.eye(size), (len(ids), 1, 1))
    return Graph(
        ids=ids,
        poses=_poses(lines.vertices) if lines.placed else unplaced,
        first=lines.edge_ids[:, 0],
        second=lines.edge_ids[:, 1],
        motions=_poses(lines.edges),
        information=_reordered(lines.information),
        fixed=lines.fixed,
        placed=lines.placed,
        warnings=lines.warnings,
    )


def _reordered(information: Array) -> Array:
    """Information (M, dof, dof) from the file's order to GTSAM's, or back; in the plane they are one."""
    return information if information.shape[-1] == 3 else information[:, _SWAPPED][:, :, _SWAPPED]


def _poses(numbers: Array) -> Array:
    """Poses (N, n, n) of (N, 3): x y theta, or of (N, 7): x y z qx qy qz qw, normalised."""
    if numbers.shape[1] == 3:
        return planar_poses(numbers)
    out = np.tile(np.eye(4), (len(numbers), 1, 1))
    if len(numbers):
        out[:, :3, :3] = Rotation.from_quat(numbers[:, 3:]).as_matrix()
        out[:, :3, 3] = numbers[:, :3]
    return out


def _numbers(poses: Array) -> Array:
    """The file's numbers (N, 3) or (N, 7) of poses (N, n, n), qw not negative."""
    if poses.shape[-1] == 3:
        theta = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
        return np.column_stack([poses[:, 0, 2], poses[:, 1, 2], theta])
    if not len(poses):
        return np.zeros((0, 7))
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
    return np.concatenate([poses[:, :3, 3], quaternions], axis=1)


def _words(numbers: NDArray[Any]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
