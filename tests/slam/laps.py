"""Drives round a square block, with noisy odometry and loops true and false."""

from dataclasses import dataclass

import numpy as np

from odometry import se3
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.pose_graph import PoseGraph, PoseGraphConfig

STEP_COVARIANCE = np.diag(np.repeat(np.square([5e-4, 0.01]), 3))
LOOP_COVARIANCE = np.diag(np.repeat(np.square([2e-3, 0.03]), 3))


@dataclass(frozen=True)
class Drive:
    """True poses (N, 4, 4) with noisy motions, and true loops."""

    poses: np.ndarray
    motions: list[np.ndarray]
    loops: list[LoopClosure]

    def graph(self, loops: list[LoopClosure] | None = None, config: PoseGraphConfig | None = None) -> PoseGraph:
        """Fill a pose graph with the motions and then with loops (the drive's own, unless given)."""
        graph = PoseGraph(config)
        for T in self.motions:
            graph.add_odometry(T, STEP_COVARIANCE)
        for loop in self.loops if loops is None else loops:
            graph.add_loop(loop)
        return graph

    def ate(self, poses: np.ndarray) -> float:
        """Root mean square position error, first poses aligned, metres."""
        return float(np.sqrt(np.mean(np.sum((poses - self.poses)[:, :3, 3] ** 2, axis=1))))


def laps(side: int = 25, laps: float = 2.0, seed: int = 0, bias: tuple[float, float] = (5e-4, 0.0)) -> Drive:
    """Drive round a square block of `side` metres, a metre a frame; odometry is noisy and biased.

    The bias is (radians, metres) a frame. Every second frame of later laps closes a loop to a lap before.
    """
    rng, lap = np.random.default_rng(seed), 4 * side
    count = int(laps * lap) + 1
    turn = se3.exp(np.array([0, np.pi / 8, 0, 0, 0, 1.0]))
    straight = se3.exp(np.array([0, 0, 0, 0, 0, 1.0]))
    true = [turn if k % side >= side - 4 else straight for k in range(count - 1)]
    poses = [np.eye(4)]
    for T in true:
        poses.append(poses[-1] @ T)
    bias_covariance = np.array([0, bias[0], 0, 0, 0, bias[1]])
    motions = [T @ se3.exp(bias_covariance + noise(rng, STEP_COVARIANCE)) for T in true]
    loops = [loop_between(rng, np.array(poses), q, q - lap) for q in range(lap + 4, count, 2)]
    return Drive(np.array(poses), motions, loops)


def loop_between(rng: np.random.Generator, poses: np.ndarray, query: int, match: int) -> LoopClosure:
    """Measure a true loop with noise."""
    T = se3.inverse(poses[match]) @ poses[query] @ se3.exp(noise(rng, LOOP_COVARIANCE))
    return LoopClosure(query, match, T, LOOP_COVARIANCE, 50)


def settled(graph: PoseGraph) -> PoseGraph:
    """Stand still until what the last loop has set in motion has settled."""
    for _ in range(12):
        graph.add_odometry(np.eye(4), STEP_COVARIANCE)
    return graph


def false_loops(rng: np.random.Generator, frames: int, count: int) -> list[LoopClosure]:
    """Claim that frames far apart show one place."""
    out = []
    while len(out) < count:
        match, query = np.sort(rng.integers(0, frames, 2))
        if query - match > 20:
            T = se3.exp(rng.normal(size=6) * [0.02, 0.1, 0.02, 0.3, 0.1, 1.0])
            out.append(LoopClosure(int(query), int(match), T, LOOP_COVARIANCE, 25))
    return out


def noise(rng: np.random.Generator, covariance: np.ndarray) -> np.ndarray:
    """Draw a tangent vector (6,)."""
    return rng.normal(size=6) * np.sqrt(np.diag(covariance))
