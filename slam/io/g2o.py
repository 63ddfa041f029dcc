"""Pose graphs as g2o text, in the plane (`VERTEX_SE2`, `EDGE_SE2`) and in space (`VERTEX_SE3:QUAT`, `EDGE_SE3:QUAT`).

The file stores the information matrix of the right perturbation of each edge, upper triangle by rows: x, y, theta in
the plane; in space translation first, while `Graph` has rotation first. As in GTSAM, the three rotation numbers are a
rotation vector in radians.

Several robots have ids far from one another, such as GTSAM's symbols. `FIX` may name several poses, of which the first
is held. Edges of Vertigo are read as loops and written as plain edges. Lines of other tags are left out with a warning
that counts them.

Repaired with a warning: edges from a pose to itself and edges of zero information are left out; information that is
zero in some direction gets a billionth of its largest eigenvalue there. Quaternions are normalised if rounding explains
their length. Several edges between two poses are several measurements. Everything else is an error with its line.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.io.files import atomic_writer
from slam.io.g2o_parser import UPPER, Kind, parse_g2o
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.optimization.lie_groups import planar_poses

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

_SWAP = np.array([3, 4, 5, 0, 1, 2])  # rotation first <-> translation first


@dataclass(frozen=True)
class Graph:
    """A pose graph as in a g2o file, in the plane (n = 3, dof 3) or in space (n = 4, dof 6).

    Attributes:
        ids: ids of the poses, (N,), in the file's order; for a file without poses those of its edges, sorted.
        poses: T_world_camera, (N, n, n), metres; identities for a file without poses.
        first, second: ids that each edge joins, (M,).
        motions: relative poses T_first_second, (M, n, n), metres.
        information: inverse covariances of right perturbations, (M, dof, dof), rotation first (1/rad^2, 1/m^2).
        fixed: id of the pose that is held fixed (`FIX`), or None.
        has_poses: whether the file has poses.
        warnings: repairs and ignored lines, a sentence each.
        also_fixed: ids of further poses after `FIX`, which are kept for the output and not held.
        declared_loops: rows of the edges that the file declares to be loops, (K,), whatever their ids.
    """

    ids: Ids
    poses: Array
    first: Ids
    second: Ids
    motions: Array
    information: Array
    fixed: int | None = None
    has_poses: bool = True
    warnings: tuple[str, ...] = ()
    also_fixed: tuple[int, ...] = ()
    declared_loops: Ids = field(default_factory=lambda: np.zeros(0, np.int64))


def chain_graph(poses: Array, odometry: Sequence[tuple[Array, Array]], closures: Sequence[LoopClosure]) -> Graph:
    """Make a graph of poses (N, 4, 4), N - 1 odometry motions (4, 4) with covariances (6, 6), and loops."""
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
    """Write a graph; each number is the shortest text of its exact value, so the same graph gives the same bytes."""
    kind = Kind.of("SE2" if graph.poses.shape[-1] == 3 else "SE3:QUAT")
    rows = _reordered(graph.information)[:, *UPPER[kind.dof]]
    with atomic_writer(path) as file:
        for key, numbers in zip(graph.ids, _numbers(graph.poses), strict=True):
            file.write(f"{kind.vertex} {key} {_join(numbers)}\n")
        for i, j, numbers, row in zip(graph.first, graph.second, _numbers(graph.motions), rows, strict=True):
            file.write(f"{kind.edge} {i} {j} {_join(numbers)} {_join(row)}\n")
        held = () if graph.fixed is None else (graph.fixed,)
        for key in (*held, *graph.also_fixed):
            file.write(f"FIX {key}\n")  # last: GTSAM reads no further


def read_g2o(path: Path) -> Graph:
    """Read a graph; lines of other kinds (landmarks, parameters) are counted in its warnings.

    Raises:
        GraphError: the file is missing, a line is damaged, an edge leads to a missing pose, planar and spatial lines
            are mixed, or there is neither pose nor edge.
    """
    parsed = parse_g2o(path)
    ids = parsed.vertex_ids if parsed.has_poses else np.unique(parsed.edge_ids)
    size = 3 if parsed.kind.dof == 3 else 4
    unplaced = np.tile(np.eye(size), (len(ids), 1, 1))
    return Graph(
        ids=ids,
        poses=_poses(parsed.vertices) if parsed.has_poses else unplaced,
        first=parsed.edge_ids[:, 0],
        second=parsed.edge_ids[:, 1],
        motions=_poses(parsed.edges),
        information=_reordered(parsed.information),
        fixed=parsed.fixed[0] if parsed.fixed else None,
        has_poses=parsed.has_poses,
        warnings=parsed.warnings,
        also_fixed=parsed.fixed[1:],
        declared_loops=np.flatnonzero(parsed.is_declared_loop),
    )


def _reordered(information: Array) -> Array:
    """Swap the order of information (M, 6, 6) between the file's and ours; in the plane (M, 3, 3) they are the same."""
    return information if information.shape[-1] == 3 else information[:, _SWAP][:, :, _SWAP]


def _poses(numbers: Array) -> Array:
    """Return the poses (N, n, n) of numbers (N, 3): x y theta, or (N, 7): x y z qx qy qz qw, normalised."""
    if numbers.shape[1] == 3:
        return planar_poses(numbers)
    out = np.tile(np.eye(4), (len(numbers), 1, 1))
    if len(numbers):
        out[:, :3, :3] = Rotation.from_quat(numbers[:, 3:]).as_matrix()
        out[:, :3, 3] = numbers[:, :3]
    return out


def _numbers(poses: Array) -> Array:
    """Return the file's numbers (N, 3) or (N, 7) of poses (N, n, n); qw is not negative."""
    if poses.shape[-1] == 3:
        theta = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
        return np.column_stack([poses[:, 0, 2], poses[:, 1, 2], theta])
    if not len(poses):
        return np.zeros((0, 7))
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
    return np.concatenate([poses[:, :3, 3], quaternions], axis=1)


def _join(numbers: NDArray[Any]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
