"""Injection of false loops into a pose graph, to test back ends.

Relative pose and information of a false loop are copied from a true loop of the same graph; only its two poses are
wrong. `random` loops are single; `grouped` loops come in runs of successive pairs, as when a recogniser takes one
street for another; loops of `coherent` runs also agree with one another, as when two streets look alike throughout.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam.errors import ConfigError
from slam.pose_graph.optimization.edges import Edges, concatenate
from slam.pose_graph.optimization.lie_groups import inverse
from slam.pose_graph.robust.problem import LoopProblem

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

KINDS = ("random", "grouped", "coherent")


@dataclass(frozen=True)
class OutlierConfig:
    """Kind and number of the false loops to add.

    Attributes:
        kind: one of KINDS.
        share: share of false loops among all loops, from 0 to below 1.
        seed: seed of the random choice.
        run_length: number of loops in a run.
        min_gap: minimum number of poses between the two ends of a loop.
    """

    kind: str = "random"
    share: float = 0.5
    seed: int = 0
    run_length: int = 10
    min_gap: int = 20


@dataclass(frozen=True)
class ContaminatedProblem:
    """A graph with false loops among the true ones, shuffled.

    Attributes:
        problem: trusted edges, loops and start.
        true: (L,) bool, which loops are true.
    """

    problem: LoopProblem
    true: Mask


def inject_outliers(problem: LoopProblem, poses: Array, config: OutlierConfig) -> ContaminatedProblem:
    """Add false loops to a graph.

    Args:
        problem: problem with true loops only, at least one.
        poses: (N, n, n) solution of the problem, along which coherent runs agree, metres.
        config: kind and number of the false loops.

    Raises:
        ConfigError: the kind is unknown, or the share is not in [0, 1).
    """
    if config.kind not in KINDS or not 0 <= config.share < 1:
        raise ConfigError(
            f"expected one of {', '.join(KINDS)} and a share in [0, 1), got '{config.kind}' and {config.share}"
        )
    rng = np.random.default_rng(config.seed)
    count = round(len(problem.loops) * config.share / (1.0 - config.share))
    loops = concatenate(problem.loops, _false_loops(rng, problem.loops, poses, config, count))
    order = rng.permutation(len(loops))
    true = np.arange(len(loops)) < len(problem.loops)
    return ContaminatedProblem(LoopProblem(problem.trusted, loops[order], problem.start), true[order])


def _false_loops(rng: np.random.Generator, true: Edges, poses: Array, config: OutlierConfig, count: int) -> Edges:
    """Make `count` false loops."""
    length = 1 if config.kind == "random" else config.run_length
    runs = -(-count // length)
    starts = _ends(rng, len(poses) - length, runs, config.min_gap)
    within = np.tile(np.arange(length), runs)[:count]
    first, second = (np.repeat(starts, length, axis=0)[:count] + within[:, None]).T
    copied = rng.integers(len(true), size=count)
    motions = true.motions[copied]
    if config.kind == "coherent":
        begin = np.repeat(np.arange(runs) * length, length)[:count]
        motions = (
            inverse(poses[first]) @ poses[first[begin]] @ motions[begin] @ inverse(poses[second[begin]]) @ poses[second]
        )
        motions = motions @ true.group.exp(_noise(rng, true[copied]))
    return Edges(first, second, motions, true.information[copied])


def _ends(rng: np.random.Generator, rows: int, count: int, min_gap: int) -> NDArray[np.int64]:
    """Choose pairs of poses, (count, 2) rows, the earlier first, that lie far enough apart."""
    gap = min(min_gap, rows // 2)
    apart = rng.integers(gap, rows, size=count)
    first = rng.integers(0, rows - apart)
    return np.stack([first, first + apart], axis=1).astype(np.int64)


def _noise(rng: np.random.Generator, edges: Edges) -> Array:
    """Draw errors (M, dof) from the covariances of the edges."""
    normal = rng.normal(size=(len(edges), edges.group.dof, 1))
    return np.asarray(np.linalg.solve(edges.sqrt_information, normal)[..., 0])
