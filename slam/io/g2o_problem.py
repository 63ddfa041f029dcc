"""Classification of the edges of a stored graph as odometry or loops, which makes a problem for the back ends.

Whether an edge is odometry depends on the ids of its poses: one robot's poses that follow each other by id. Two robots
have ids with different symbols (GTSAM keeps the letter in the highest byte) or with a gap between them, and an edge
from the last pose of one to the first of the next is a loop, although the two are neighbours in the sorted list.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse.csgraph import breadth_first_order

from slam.errors import GraphError
from slam.io.g2o import Graph
from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.lie_groups import inverse
from slam.pose_graph.robust.problem import LoopProblem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Ids = NDArray[np.int64]

# GTSAM's symbols have the letter in the highest byte; its labelled symbols have the label in the next one.
_ROBOT_BITS = 48
# Key frames leave gaps between ids: up to this many usual ones (the median) two poses still follow each other.
_MAX_GAP_FACTOR = 10.0
_MAX_VOTERS = 300  # edges between two pieces that the others are compared with: bounds the time


@dataclass(frozen=True)
class ClassifiedEdges:
    """Edges of a stored graph, classified for the back ends.

    Attributes:
        order: (N,) rows of the graph's poses, sorted by id: the order of `problem.start`.
        trusted: (M,) bool, which edges count as odometry.
        problem: trusted edges and loops, each in the file's order.
        connecting: (M,) bool, which of the trusted edges are no odometry and connect what odometry does not.
        warnings: assumptions that had to be made, a sentence each.
    """

    order: NDArray[np.int64]
    trusted: Mask
    problem: LoopProblem
    connecting: Mask
    warnings: tuple[str, ...]


def classify_edges(graph: Graph, name: str) -> ClassifiedEdges:
    """Take the first edge between poses of successive ids for odometry, and others only to connect the graph.

    Args:
        graph: the graph as read.
        name: name of its file, for messages.

    Raises:
        GraphError: the edges do not connect all poses.
    """
    order = np.argsort(graph.ids, kind="stable")
    ids = graph.ids[order]
    edges = Edges(
        np.searchsorted(ids, graph.first), np.searchsorted(ids, graph.second), graph.motions, graph.information
    )
    successive = _are_successive(edges, ids)
    successive[graph.declared_loops] = False
    trusted, connecting = _spanning_tree(edges, successive, len(ids))
    _check_connected(edges[trusted], ids, name)
    start = _compose_along(edges[trusted], graph.poses[order][0], len(ids))
    warnings = _describe_connecting(graph, np.flatnonzero(connecting), name)
    if trusted.all():
        warnings += (f"{name}: there is no loop, so the poses stay where odometry puts them",)
    problem = LoopProblem(edges[trusted], edges[~trusted], start)
    return ClassifiedEdges(order, trusted, problem, connecting, warnings)


def _are_successive(edges: Edges, ids: Ids) -> Mask:
    """Return which edges (M,) join two poses of one robot that follow each other by id; ids (N,) are sorted."""
    gaps = np.diff(ids.astype(np.float64))  # a difference of two symbols can be too large for an integer
    robots = np.maximum(ids, 0) >> _ROBOT_BITS  # a negative id has no letter, so it is of the robot of 0
    is_one_robot = np.diff(robots) == 0
    usual = float(np.median(gaps[is_one_robot])) if is_one_robot.any() else 1.0
    follows = np.append(is_one_robot & (gaps <= _MAX_GAP_FACTOR * usual), False)
    successive: Mask = (np.abs(edges.first - edges.second) == 1) & follows[np.minimum(edges.first, edges.second)]
    return successive


def _describe_connecting(graph: Graph, rows: Ids, name: str) -> tuple[str, ...]:
    if not len(rows):
        return ()
    return (
        f"{name}: no odometry leads to some poses; {len(rows)} other edges are trusted instead, "
        f"the first from {graph.first[rows[0]]} to {graph.second[rows[0]]}",
    )


def _spanning_tree(edges: Edges, successive: Mask, count: int) -> tuple[Mask, Mask]:
    """Return which edges (M,) form a spanning tree, successive poses first, and which of them join other poses."""
    # A tree, so that the trusted edges have one solution without residuals: every other edge is a loop.
    pieces = DisjointSet(range(count))
    trusted, connecting = np.zeros(len(edges), dtype=bool), np.zeros(len(edges), dtype=bool)
    for k in np.flatnonzero(successive):
        trusted[k] = pieces.merge(int(edges.first[k]), int(edges.second[k]))
    for k in _rank_connecting(edges, trusted, count):
        trusted[k] = connecting[k] = pieces.merge(int(edges.first[k]), int(edges.second[k]))
    return trusted, connecting


def _rank_connecting(edges: Edges, odometry: Mask, count: int) -> Ids:
    """Order the edges between pieces of odometry: those with the most others between the same two pieces come first.

    Of the edges between two pieces the one comes first that most others agree with: it may not be dropped later, and
    a false one would take all true ones with it.
    """
    piece, poses = _chain_odometry(edges[odometry], count)
    ends = np.sort(np.column_stack([piece[edges.first], piece[edges.second]]), axis=1)
    between = np.flatnonzero(ends[:, 0] != ends[:, 1])
    _, group, sizes = np.unique(ends[between], axis=0, return_inverse=True, return_counts=True)
    rank = np.zeros(len(between))
    for g in np.flatnonzero(sizes > 2):  # of two that disagree, nothing tells which is false
        members = np.flatnonzero(group.ravel() == g)
        rank[members] = _disagreement(edges[between[members]], piece, poses)
    order = np.lexsort((between, rank, -sizes[group.ravel()]))
    return np.asarray(between[order], np.int64)


def _chain_odometry(odometry: Edges, count: int) -> tuple[Ids, Array]:
    """Return the piece (N,) of each pose, named by its first row, and its pose (N, n, n) in the frame of that row."""
    poses = np.tile(np.eye(odometry.motions.shape[-1]), (count, 1, 1))
    piece, backwards = np.arange(count), inverse(odometry.motions)
    lower = np.minimum(odometry.first, odometry.second)
    for k in np.argsort(lower):
        row = lower[k]
        piece[row + 1] = piece[row]
        poses[row + 1] = poses[row] @ (odometry.motions[k] if odometry.first[k] == row else backwards[k])
    return piece, poses


def _disagreement(edges: Edges, piece: Ids, poses: Array) -> Array:
    """Return how far (M,) edges between two pieces are from what the better agreeing quarter of the others says."""
    turned = (piece[edges.first] > piece[edges.second])[:, None, None]
    T = poses[edges.first] @ edges.motions @ inverse(poses[edges.second])
    T_piece_piece = np.where(turned, inverse(T), T)
    voters = np.unique(np.linspace(0, len(edges) - 1, min(len(edges), _MAX_VOTERS)).astype(np.int64))
    distances = np.empty((len(edges), len(voters)))
    for column, voter in enumerate(voters):
        said = np.where(turned, inverse(T_piece_piece[voter]), T_piece_piece[voter])
        expected = inverse(poses[edges.first]) @ said @ poses[edges.second]
        errors = edges.group.log(inverse(edges.motions) @ expected)
        distances[:, column] = np.sqrt(np.einsum("mi,mij,mj->m", errors, edges.information, errors))
    nearest = 1 + max(1, (len(voters) - 1) // 4)  # itself is at distance 0
    return np.asarray(np.sort(distances, axis=1)[:, min(nearest, len(voters) - 1)])


def _check_connected(tree: Edges, ids: NDArray[np.int64], name: str) -> None:
    if len(tree) == len(ids) - 1:
        return
    reached = {0, *(row for row, _, _ in _visits(tree, len(ids)))}
    lost = next(row for row in range(len(ids)) if row not in reached)
    raise GraphError(
        f"{name}: expected edges that join all {len(ids)} poses, found none between pose {ids[0]} and "
        f"pose {ids[lost]} ({len(ids) - len(reached)} poses are cut off); add the missing edge or split the file"
    )


def _compose_along(tree: Edges, first: Array, count: int) -> Array:
    """Compose poses (N, n, n) along a spanning tree."""
    poses = np.tile(first, (count, 1, 1))
    backwards = inverse(tree.motions)
    for row, before, edge in _visits(tree, count):
        forward = tree.first[edge] == before
        poses[row] = poses[before] @ (tree.motions[edge] if forward else backwards[edge])
    return poses


def _visits(tree: Edges, count: int) -> list[tuple[int, int, int]]:
    """Return the steps through a tree from row 0 outwards: a row, the row before it, and the edge between them."""
    # By the set of its ends: an edge may run against the order in which the tree is walked.
    between = {frozenset(ends): k for k, ends in enumerate(zip(tree.first.tolist(), tree.second.tolist(), strict=True))}
    joined = sparse.csr_array((np.ones(len(tree)), (tree.first, tree.second)), shape=(count, count))
    rows, before = breadth_first_order(joined, 0, directed=False)
    steps = zip(rows[1:].tolist(), before[rows[1:]].tolist(), strict=True)
    return [(row, previous, between[frozenset((row, previous))]) for row, previous in steps]
