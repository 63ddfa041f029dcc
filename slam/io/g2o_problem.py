"""Classification of the edges of a stored graph as odometry or loops, which makes a problem for the back ends."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.cluster.hierarchy import DisjointSet
from scipy.sparse.csgraph import breadth_first_order

from slam.errors import GraphError
from slam.io.g2o import Graph
from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.optimization.planar_or_spatial import inverse
from slam.pose_graph.robust.problem import LoopProblem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class ClassifiedEdges:
    """Edges of a stored graph, classified for the back ends.

    Attributes:
        order: (N,) rows of the graph's poses, sorted by id: the order of `problem.start`.
        trusted: (M,) bool, which edges count as odometry.
        problem: trusted edges and loops, each in the file's order.
        warnings: assumptions that had to be made, a sentence each.
    """

    order: NDArray[np.int64]
    trusted: Mask
    problem: LoopProblem
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
    trusted, not_successive = _spanning_tree(edges, len(ids))
    _check_connected(edges[trusted], ids, name)
    start = _compose_along(edges[trusted], graph.poses[order][0], len(ids))
    warnings: tuple[str, ...] = ()
    if not_successive.any():
        one = int(np.flatnonzero(not_successive)[0])
        warnings = (
            f"{name}: no odometry leads to some poses; {not_successive.sum()} other edges are trusted instead, "
            f"the first from {graph.first[one]} to {graph.second[one]}",
        )
    return ClassifiedEdges(order, trusted, LoopProblem(edges[trusted], edges[~trusted], start), warnings)


def _spanning_tree(edges: Edges, count: int) -> tuple[Mask, Mask]:
    """Return which edges (M,) form a spanning tree, successive poses first, and which of them join other poses."""
    # A tree, so that the trusted edges have one solution without residuals: every other edge is a loop.
    successive = np.abs(edges.first - edges.second) == 1
    pieces = DisjointSet(range(count))
    trusted, other = np.zeros(len(edges), dtype=bool), np.zeros(len(edges), dtype=bool)
    for k in np.concatenate([np.flatnonzero(successive), np.flatnonzero(~successive)]):
        if pieces.merge(int(edges.first[k]), int(edges.second[k])):
            trusted[k], other[k] = True, not successive[k]
    return trusted, other


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
