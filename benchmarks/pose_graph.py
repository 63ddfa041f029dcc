"""How fast and how right the pose graph is: `python benchmarks/pose_graph.py [FOLDER OF TEST DATA]`.

Real part: LIBVISO2 odometry of KITTI with the loops that a bag of words proposed, most of them false, judged
against ground truth (RobustSLAM graphs, lifted from the plane into space). The measured transform of every
false loop in the files is zero; here it is drawn anew, so that it gives nothing away. Synthetic part:
drives of true shape with drifting odometry and every revisit, for the online times.
"""

import os
import sys
import time
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from odometry import se3
from slam.loop_closing import LoopClosure
from slam.pose_graph import PoseGraph, PoseGraphConfig
from slam.robust import BACK_ENDS

Array = NDArray[np.float64]

FLAT_SIGMAS = (1e-3, 1e-3, 0.02)  # pitch and roll, rad; height, m: what a planar graph says nothing about


@dataclass(frozen=True)
class Drive:
    """A graph's odometry and loops, with the truth about both."""

    name: str
    motions: list[tuple[Array, Array]]
    loops: list[LoopClosure]
    true: NDArray[np.bool_]
    positions: Array


def lifted(x: float, y: float, theta: float) -> Array:
    """Pose (4, 4) in camera axes of one in the plane: forward x is z, leftward y is -x."""
    return se3.pose(Rotation.from_rotvec([0.0, -theta, 0.0]).as_matrix(), np.array([-y, 0.0, x]))


def lifted_covariance(information: Array) -> Array:
    """Covariance (6, 6), rotation first, of a planar edge's six numbers (upper triangle; x, y, theta)."""
    flat = np.zeros((3, 3))
    flat[np.triu_indices(3)] = information
    flat = np.linalg.inv(flat + np.triu(flat, 1).T)
    J = np.zeros((6, 3))
    J[5, 0], J[3, 1], J[1, 2] = 1.0, -1.0, -1.0
    pitch, roll, height = FLAT_SIGMAS
    return J @ flat @ J.T + np.diag(np.square([pitch, 0.0, roll, 0.0, height, 0.0]))


def true_pairs(path: Path) -> set[tuple[int, int]]:
    """(match, query) of the loops that a GT_LC file lists as true."""
    pairs = np.loadtxt(path, dtype=int, ndmin=2)
    return {(int(pair.min()), int(pair.max())) for pair in pairs}


def planar_edges(path: Path) -> list[tuple[int, int, Array, Array]]:
    """Edges of a planar graph, first id below the second: ids, motion (4, 4), covariance (6, 6)."""
    edges = []
    for line in path.read_text().splitlines():
        words = line.split()
        if words and words[0] == "EDGE_SE2":
            i, j = int(words[1]), int(words[2])
            numbers = np.array(words[3:], dtype=np.float64)
            T = lifted(*numbers[:3])
            T = T if i < j else se3.inverse(T)
            edges.append((min(i, j), max(i, j), T, lifted_covariance(numbers[3:])))
    return edges


def real_drive(folder: Path, sequence: str, alpha: str, agreeing: bool) -> Drive:
    """Read a RobustSLAM graph and draw its false transforms anew, agreeing within a run of loops or not."""
    rng = np.random.default_rng(0)
    stem = folder / "pose_graphs" / "kitti_real_loops" / f"kitti_{sequence}_alpha_{alpha}"
    truth = true_pairs(Path(f"{stem}_GT_LC.txt"))
    edges = planar_edges(Path(f"{stem}.g2o"))
    motions = {i: (T, covariance) for i, j, T, covariance in edges if j == i + 1}
    odometry = [motions[i] for i in range(len(motions))]
    chain = np.array(list(accumulate((T for T, _ in odometry), np.matmul, initial=np.eye(4))))
    loops, true, previous = [], [], (-100, -100)
    shift = np.eye(4)
    for i, j, T, covariance in sorted((e for e in edges if e[1] != e[0] + 1), key=lambda e: (e[1], e[0])):
        true.append((i, j) in truth)
        if not true[-1]:
            if not agreeing or max(abs(i - previous[0]), abs(j - previous[1])) > 15:
                shift, first = lifted(*rng.normal(0.0, [2.0, 0.5, 0.1])), (i, j)
            # loops of a run agree: each follows from the run's first one along odometry
            step_i, step_j = se3.inverse(chain[i]) @ chain[first[0]], se3.inverse(chain[first[1]]) @ chain[j]
            T, previous = step_i @ shift @ step_j, (i, j)
        loops.append(LoopClosure(j, i, T, covariance, 30))
    poses = np.loadtxt(folder / "kitti_poses" / f"{sequence}.txt").reshape(-1, 3, 4)
    positions = poses[: len(odometry) + 1, :, 3] * [1.0, 0.0, 1.0]  # judged in the plane, as the graph is
    name = f"{sequence} alpha {alpha}, false loops {'agree in runs' if agreeing else 'random'}"
    return Drive(name, odometry, loops, np.array(true), positions)


def synthetic_drive(folder: Path, sequence: str = "00", every: int = 1) -> Drive:
    """Make a drive of true shape with biased, noisy odometry and all revisits within 4 m, measured well."""
    rng = np.random.default_rng(0)
    rows = np.loadtxt(folder / "kitti_poses" / f"{sequence}.txt").reshape(-1, 3, 4)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = rows
    sigmas, bias = np.repeat([2e-4, 0.01], 3), np.array([0.0, 8e-5, 0.0, 0.0, 0.0, 0.002])
    steps = se3.inverse(poses[:-1]) @ poses[1:]
    motions = [(T @ se3.exp(bias + rng.normal(0.0, sigmas)), np.diag(sigmas**2)) for T in steps]
    sigmas = np.repeat([2e-3, 0.03], 3)
    tree, loops = cKDTree(poses[:, :3, 3]), []
    for query in range(0, len(poses), every):
        near = [m for m in tree.query_ball_point(poses[query, :3, 3], 4.0) if m < query - 100]
        if near:
            match = min(near, key=lambda m: float(np.linalg.norm(poses[m, :3, 3] - poses[query, :3, 3])))
            T = se3.inverse(poses[match]) @ poses[query] @ se3.exp(rng.normal(0.0, sigmas))
            loops.append(LoopClosure(query, match, T, np.diag(sigmas**2), 100))
    return Drive(f"{sequence} synthetic", motions, loops, np.ones(len(loops), bool), poses[:, :3, 3])


def ate(poses: Array, positions: Array) -> float:
    """Root mean square position error after rigid alignment, metres."""
    a, b = poses[:, :3, 3], positions
    a, b = a - a.mean(0), b - b.mean(0)
    rotation, _ = Rotation.align_vectors(b, a)
    return float(np.sqrt(np.mean(np.sum((rotation.apply(a) - b) ** 2, axis=1))))


def filled(drive: Drive, config: PoseGraphConfig, only_true: bool = False) -> PoseGraph:
    """Fill the drive's graph, without asking for online estimates."""
    graph = PoseGraph(config)
    for T, covariance in drive.motions:
        graph.add_odometry(T, covariance)
    for loop, good in zip(drive.loops, drive.true, strict=True):
        if good or not only_true:
            graph.add_loop(loop)
    return graph


def judge(drive: Drive, config: PoseGraphConfig) -> None:
    """Print what each back end makes of a drive."""
    graph = filled(drive, config)
    best = filled(drive, config, only_true=True).optimize("none")
    residual = np.array([gate.residual for gate in graph.gates])
    true, false = residual[drive.true] ** 2, residual[~drive.true] ** 2
    passed = np.array([gate.passed for gate in graph.gates])
    print(
        f"{drive.name}: {drive.true.sum()} true, {(~drive.true).sum()} false; ATE of odometry "
        f"{ate(graph.odometry_poses(), drive.positions):.2f} m, of true loops only "
        f"{ate(best.poses, drive.positions):.2f} m; gate: chi2 of true <= {true.max(initial=0):.1f}, "
        f"false >= {np.sort(false)[:3].round(1)}, passed {passed[drive.true].sum()} true, "
        f"{passed[~drive.true].sum()} false"
    )
    for name in BACK_ENDS:
        result = graph.optimize(name)
        true_kept, false_kept = result.kept[drive.true].sum(), result.kept[~drive.true].sum()
        print(
            f"  {name:10} ATE {ate(result.poses, drive.positions):7.2f} m   kept {true_kept:4d} true "
            f"{false_kept:4d} false   {result.seconds:6.2f} s",
            flush=True,
        )


def clock_online(drive: Drive, config: PoseGraphConfig) -> None:
    """Print the time of adding a frame and asking for its pose, with and without a loop."""
    graph, loops = PoseGraph(config), {loop.query: loop for loop in drive.loops}
    frame_ms, loop_ms = [], []
    for query, (T, covariance) in enumerate(drive.motions, start=1):
        start = time.perf_counter()
        graph.add_odometry(T, covariance)
        if query in loops:
            graph.add_loop(loops[query])
        graph.latest()
        (loop_ms if query in loops else frame_ms).append(1e3 * (time.perf_counter() - start))
    online, batch = ate(graph.poses(), drive.positions), ate(graph.optimize().poses, drive.positions)
    print(
        f"{drive.name}: {len(graph)} poses, {len(loop_ms)} loops; ms a pose {spread(frame_ms)}; "
        f"at a loop {spread(loop_ms)}; ATE of the last online map {online:.2f} m, of the batch {batch:.2f} m",
        flush=True,
    )


def spread(times: list[float]) -> str:
    """Sum up times in three numbers."""
    return f"median {np.median(times):.2f}, p99 {np.percentile(times, 99):.1f}, worst {max(times):.0f}"


def main(folder: Path) -> None:
    """Print both tables."""
    config = PoseGraphConfig()
    for sequence in ("00", "02", "05"):
        for alpha in ("0.00", "0.15", "0.30"):
            for agreeing in (False, True):
                judge(real_drive(folder, sequence, alpha, agreeing), config)
    for sequence in ("07", "00"):
        for every in (5, 1):
            clock_online(synthetic_drive(folder, sequence, every), config)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else os.environ["REVISIT_TEST_DATA"]))
