"""Pose graphs as g2o text: `VERTEX_SE3:QUAT` and `EDGE_SE3:QUAT`.

In the file an edge's information has translation first, upper triangle by rows, and belongs to the right
perturbation of its transform; `Graph3D` has our order, rotation first. As GTSAM does, the three rotation
numbers are taken as a rotation vector in radians.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from slam.errors import GraphError
from slam.loop_closing import LoopClosure
from slam.storage.atomic import atomic_writer

Array = NDArray[np.float64]
Ids = NDArray[np.int64]

_SWAPPED = np.array([3, 4, 5, 0, 1, 2])  # rotation first <-> translation first
_UPPER = np.triu_indices(6)
_IDS = {"VERTEX_SE3:QUAT": 1, "EDGE_SE3:QUAT": 2}
_SIZES = {"VERTEX_SE3:QUAT": 1 + 7, "EDGE_SE3:QUAT": 2 + 7 + 21}
_ROUNDING = 1e-9  # of an eigenvalue, relative to the largest
_UNIT_TOLERANCE = 0.01  # files round quaternions; more than this is damage


@dataclass(frozen=True)
class Graph3D:
    """A pose graph as it stands in a file.

    Attributes:
        ids: (N,) of the poses, in the file's order.
        poses: (N, 4, 4) T_world_camera, metres.
        first, second: (M,) ids that each edge joins.
        motions: (M, 4, 4) T_first_second, metres.
        information: (M, 6, 6) inverse covariances of right perturbations, rotation first (1/rad^2, 1/m^2).
    """

    ids: Ids
    poses: Array
    first: Ids
    second: Ids
    motions: Array
    information: Array


def chain_graph(poses: Array, odometry: Sequence[tuple[Array, Array]], closures: Sequence[LoopClosure]) -> Graph3D:
    """Make a graph of poses (N, 4, 4), N - 1 motions (4, 4) with covariances (6, 6), and loops."""
    ids = np.arange(len(poses), dtype=np.int64)
    ends = np.array([(c.match, c.query) for c in closures], dtype=np.int64).reshape(-1, 2)
    edges = [*odometry, *((c.T_match_query, c.covariance) for c in closures)]
    return Graph3D(
        ids=ids,
        poses=poses,
        first=np.concatenate([ids[:-1], ends[:, 0]]),
        second=np.concatenate([ids[1:], ends[:, 1]]),
        motions=np.array([T for T, _ in edges]).reshape(-1, 4, 4),
        information=np.linalg.inv(np.array([covariance for _, covariance in edges]).reshape(-1, 6, 6)),
    )


def write_g2o(path: Path, graph: Graph3D) -> None:
    """Write a graph, numbers as short as their exact value allows: the same graph gives the same bytes."""
    rows = graph.information[:, _SWAPPED][:, :, _SWAPPED][:, _UPPER[0], _UPPER[1]]
    with atomic_writer(path) as file:
        for key, numbers in zip(graph.ids, _numbers(graph.poses), strict=True):
            file.write(f"VERTEX_SE3:QUAT {key} {_words(numbers)}\n")
        edges = zip(graph.first, graph.second, _numbers(graph.motions), rows, strict=True)
        for i, j, numbers, information in edges:
            file.write(f"EDGE_SE3:QUAT {i} {j} {_words(numbers)} {_words(information)}\n")


def read_g2o(path: Path) -> Graph3D:
    """Read a 3D graph; lines of other kinds (parameters, comments, fixed poses) are passed over.

    Raises:
        GraphError: no such file, a damaged line, an edge to a pose that is not there, or no pose at all.
    """
    vertices: list[Array] = []
    edges: list[Array] = []
    for number, kind, values in _lines(path):
        numbers = _parsed(path, number, kind, values)
        (vertices if kind == "VERTEX_SE3:QUAT" else edges).append(numbers)
    if not vertices:
        raise GraphError(f"{path}: expected VERTEX_SE3:QUAT lines, found none; is this a 3D graph in g2o format?")
    nodes, links = np.array(vertices), np.array(edges).reshape(-1, 30)
    graph = Graph3D(
        ids=nodes[:, 0].astype(np.int64),
        poses=_poses(nodes[:, 1:]),
        first=links[:, 0].astype(np.int64),
        second=links[:, 1].astype(np.int64),
        motions=_poses(links[:, 2:9]),
        information=_full(links[:, 9:]),
    )
    _check(path, graph)
    return graph


def _lines(path: Path) -> Iterator[tuple[int, str, list[str]]]:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise GraphError(f"{path}: expected a pose graph in g2o format, could not read it: {error}") from error
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if words and words[0] in _SIZES:
            yield number, words[0], words[1:]


def _parsed(path: Path, number: int, kind: str, words: list[str]) -> Array:
    """Check the numbers of one line."""
    where = f"{path}, line {number}: {kind}"
    if len(words) != _SIZES[kind]:
        raise GraphError(f"{where} has {len(words)} numbers, expected {_SIZES[kind]}; was the file cut short?")
    ids = _IDS[kind]
    try:
        numbers = np.array([*map(int, words[:ids]), *map(float, words[ids:])], dtype=np.float64)
    except ValueError as error:
        raise GraphError(f"{where} holds something that is not a number: {error}") from error
    length = float(np.linalg.norm(numbers[ids + 3 : ids + 7]))
    if not np.isfinite(numbers).all() or abs(length - 1.0) > _UNIT_TOLERANCE:
        raise GraphError(f"{where} expected finite numbers and a unit quaternion, its length is {length:.6g}")
    return numbers


def _check(path: Path, graph: Graph3D) -> None:
    known, counts = np.unique(graph.ids, return_counts=True)
    if counts.max() > 1:
        raise GraphError(f"{path}: pose {known[counts.argmax()]} is there {counts.max()} times, expected once")
    spectrum = np.linalg.eigvalsh(graph.information)
    bad = np.flatnonzero((spectrum < -_ROUNDING * np.abs(spectrum).max(axis=1, keepdims=True)).any(axis=1))
    if bad.size:
        i, j = graph.first[bad[0]], graph.second[bad[0]]
        raise GraphError(f"{path}: the information of edge {i} {j} has a negative eigenvalue, expected none")
    missing = np.setdiff1d(np.concatenate([graph.first, graph.second]), known)
    if missing.size:
        raise GraphError(f"{path}: an edge names pose {missing[0]}, which has no VERTEX_SE3:QUAT line")


def _full(upper: Array) -> Array:
    """Information (M, 6, 6), rotation first, of the file's 21 numbers (M, 21)."""
    out = np.zeros((len(upper), 6, 6))
    out[:, _UPPER[0], _UPPER[1]] = upper
    out[:, _UPPER[1], _UPPER[0]] = upper
    return out[:, _SWAPPED][:, :, _SWAPPED]


def _poses(numbers: Array) -> Array:
    """Poses (N, 4, 4) of (N, 7): x y z qx qy qz qw, normalised."""
    out = np.tile(np.eye(4), (len(numbers), 1, 1))
    if len(numbers):
        out[:, :3, :3] = Rotation.from_quat(numbers[:, 3:]).as_matrix()
        out[:, :3, 3] = numbers[:, :3]
    return out


def _numbers(poses: Array) -> Array:
    """(N, 7): x y z qx qy qz qw of poses (N, 4, 4), qw not negative."""
    if not len(poses):
        return np.zeros((0, 7))
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
    return np.concatenate([poses[:, :3, 3], quaternions], axis=1)


def _words(numbers: NDArray[Any]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
