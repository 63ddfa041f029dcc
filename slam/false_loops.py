"""False loops to test back ends with: as wrong as real ones, and as hard to tell from true ones.

Their transforms are those of true loops of the same graph, and so is their information; only the places are
wrong. `random` ones are single; `grouped` ones come in runs of successive pairs, as when a recogniser takes one
street for another; `coherent` runs agree among themselves as well, as when the streets look alike metre by metre.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.errors import ConfigError
from slam.pose_graph_edges import Edges, joined
from slam.pose_graph_lie import inverse
from slam.robust_problem import LoopProblem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

KINDS = ("random", "grouped", "coherent")


@dataclass(frozen=True)
class Injection:
    """Which false loops to add, and how many."""

    kind: str = "random"  # one of KINDS
    share: float = 0.5  # of all loops that are false afterwards, 0 to below 1
    seed: int = 0
    run: int = 10  # loops in a run
    least_gap: int = 20  # poses between the two ends of a loop


@dataclass(frozen=True)
class Contaminated:
    """A graph with false loops among the true ones, shuffled.

    Attributes:
        problem: trusted edges, loops and start.
        true: (L,) bool.
    """

    problem: LoopProblem
    true: Mask


def contaminated(problem: LoopProblem, poses: Array, injection: Injection) -> Contaminated:
    """Add false loops to a graph.

    Args:
        problem: with true loops only, at least one.
        poses: (N, n, n) its solution, after which coherent runs bend.
        injection: which.

    Raises:
        ConfigError: an unknown kind, or a share that cannot be.
    """
    if injection.kind not in KINDS or not 0 <= injection.share < 1:
        raise ConfigError(
            f"expected one of {', '.join(KINDS)} and a share in [0, 1), got '{injection.kind}' and {injection.share}"
        )
    rng = np.random.default_rng(injection.seed)
    count = round(len(problem.loops) * injection.share / (1.0 - injection.share))
    loops = joined(problem.loops, _false(rng, problem.loops, poses, injection, count))
    order = rng.permutation(len(loops))
    true = np.arange(len(loops)) < len(problem.loops)
    return Contaminated(LoopProblem(problem.trusted, loops[order], problem.start), true[order])


def _false(rng: np.random.Generator, true: Edges, poses: Array, injection: Injection, count: int) -> Edges:
    """So many false loops."""
    length = 1 if injection.kind == "random" else injection.run
    runs = -(-count // length)
    starts = _ends(rng, len(poses) - length, runs, injection.least_gap)
    within = np.tile(np.arange(length), runs)[:count]
    first, second = (np.repeat(starts, length, axis=0)[:count] + within[:, None]).T
    copied = rng.integers(len(true), size=count)
    motions = true.motions[copied]
    if injection.kind == "coherent":
        begin = np.repeat(np.arange(runs) * length, length)[:count]
        motions = (
            inverse(poses[first]) @ poses[first[begin]] @ motions[begin] @ inverse(poses[second[begin]]) @ poses[second]
        )
        motions = motions @ true.group.exp(_noise(rng, true[copied]))
    return Edges(first, second, motions, true.information[copied])


def _ends(rng: np.random.Generator, rows: int, count: int, least_gap: int) -> NDArray[np.int64]:
    """(count, 2) rows of two poses each, the earlier first, that lie far enough apart."""
    gap = min(least_gap, rows // 2)
    apart = rng.integers(gap, rows, size=count)
    first = rng.integers(0, rows - apart)
    return np.stack([first, first + apart], axis=1).astype(np.int64)


def _noise(rng: np.random.Generator, edges: Edges) -> Array:
    """(M, dof) errors as the edges' information has them."""
    normal = rng.normal(size=(len(edges), edges.group.dof, 1))
    return np.asarray(np.linalg.solve(edges.root, normal)[..., 0])
