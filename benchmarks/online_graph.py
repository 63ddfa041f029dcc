"""Speed and robustness of the online pose graph.

    python benchmarks/online_graph.py [FOLDER OF TEST DATA]
    python benchmarks/online_graph.py --laps 60

A drive of the shape of KITTI 00 (4,541 poses) with noisy, biased odometry and loops at its revisits. First its
times: adding a frame and its loop, and asking for its pose. Then the same drive with false loops that pass the
gate, alone and in runs that agree with one another: the error of the map at the end, and of the poses known at each
moment. Times are given by the processor and by the clock, which includes the wait for other processes.

With `--laps`, a circle of 360 m is driven so often (300 frames each time), with a loop at 95 of 100 frames to any
earlier lap. Printed are the times of each tenth of the drive and the size of the graph; the controls are three laps,
and ten with a node of each pass. Then the laps once more with loops to the first three alone, as a map has them that
thins later ones, and with errors of odometry that each lap repeats: no random walk explains what they add up to.
"""

import argparse
import os
import time
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path

import numpy as np
from command_line import existing, run_script
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from odometry import se3
from slam.loop_closing.loop_closer import LoopClosure
from slam.pose_graph.known_places import KnownPlaceConfig
from slam.pose_graph.odometry_chain import OdometryChain
from slam.pose_graph.online_loop_selection import LoopSelectionConfig
from slam.pose_graph.pose_graph import PoseGraph, PoseGraphConfig

Array = NDArray[np.float64]

STEP_SIGMAS = np.repeat([2e-4, 0.01], 3)  # rad and m for each frame
STEP_BIAS = np.array([0.0, 8e-5, 0.0, 0.0, 0.0, 0.002])  # as measured of odometry on KITTI
LOOP_SIGMAS = np.repeat([2e-3, 0.03], 3)
MIN_GAP_FRAMES, MAX_DISTANCE_M = 100, 4.0  # between the two frames of a revisit
FRAMES_OF_A_LAP, LAP_M, SHARE_WITH_LOOP = 300, 360.0, 0.95


@dataclass(frozen=True)
class SyntheticDrive:
    """True poses (N, 4, 4), measured motions, and loops of which some are true."""

    poses: Array
    motions: tuple[Array, ...]
    loops: tuple[LoopClosure, ...]
    true: NDArray[np.bool_]


@dataclass(frozen=True)
class OnlineRun:
    """The final graph, the pose known at each moment (N, 4, 4), and the milliseconds of each frame by both clocks."""

    graph: PoseGraph
    known: Array
    processor_ms: Array
    clock_ms: Array
    at_loop: NDArray[np.bool_]


def true_poses(folder: Path, sequence: str) -> Array:
    """KITTI's poses, with rotations that are orthogonal to all digits."""
    rows = np.loadtxt(folder / "kitti_poses" / f"{sequence}.txt").reshape(-1, 3, 4)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = rows
    poses[:, :3, :3] = Rotation.from_matrix(rows[:, :, :3]).as_matrix()
    return poses


def make_drive(poses: Array, every: int, seed: int = 0) -> SyntheticDrive:
    """Make a drive with noisy, biased odometry, and a loop at every `every`-th frame of each revisit."""
    rng = np.random.default_rng(seed)
    steps = se3.inverse(poses[:-1]) @ poses[1:]
    motions = tuple(T @ se3.exp(STEP_BIAS + rng.normal(0.0, STEP_SIGMAS)) for T in steps)
    tree, loops = cKDTree(poses[:, :3, 3]), []
    for query in range(0, len(poses), every):
        distances = np.linalg.norm(poses[:, :3, 3] - poses[query, :3, 3], axis=1)
        near = [m for m in tree.query_ball_point(poses[query, :3, 3], MAX_DISTANCE_M) if m < query - MIN_GAP_FRAMES]
        if near:
            match = min(near, key=lambda m, distances=distances: float(distances[m]))
            T = se3.inverse(poses[match]) @ poses[query] @ se3.exp(rng.normal(0.0, LOOP_SIGMAS))
            loops.append(LoopClosure(query, int(match), T, np.diag(LOOP_SIGMAS**2), 100))
    return SyntheticDrive(poses, motions, tuple(loops), np.ones(len(loops), bool))


def make_laps(laps: int, seed: int = 0, repeats_errors: bool = False) -> SyntheticDrive:
    """Make a circle that is driven so often, with noisy, biased odometry and loops to any earlier lap.

    With errors that each lap repeats, which are five times as large in rotation, loops join it to the first three laps.
    """
    rng = np.random.default_rng(seed)
    angle, radius = 2 * np.pi / FRAMES_OF_A_LAP, LAP_M / (2 * np.pi)
    frames = np.arange(laps * FRAMES_OF_A_LAP)
    poses = np.tile(np.eye(4), (len(frames), 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(np.outer(angle * frames, [0.0, 1.0, 0.0])).as_matrix()
    poses[:, 0, 3] = radius * (1.0 - np.cos(angle * frames))
    poses[:, 2, 3] = radius * np.sin(angle * frames)
    errors = STEP_BIAS + rng.normal(0.0, STEP_SIGMAS, (len(frames), 6))
    if repeats_errors:
        errors = np.tile(errors[:FRAMES_OF_A_LAP] * np.repeat([5.0, 1.0], 3), (laps, 1))
    motions = tuple(se3.inverse(poses[k]) @ poses[k + 1] @ se3.exp(errors[k]) for k in frames[:-1])
    loops, last_lap = [], 3 if repeats_errors else laps
    for query in range(FRAMES_OF_A_LAP, len(poses)):
        if rng.random() < SHARE_WITH_LOOP:
            lap = int(rng.integers(min(query // FRAMES_OF_A_LAP, last_lap)))
            match = query % FRAMES_OF_A_LAP + FRAMES_OF_A_LAP * lap
            T = se3.inverse(poses[match]) @ poses[query] @ se3.exp(rng.normal(0.0, LOOP_SIGMAS))
            loops.append(LoopClosure(query, match, T, np.diag(LOOP_SIGMAS**2), 100))
    return SyntheticDrive(poses, motions, tuple(loops), np.ones(len(loops), bool))


def with_false_runs(drive: SyntheticDrive, runs: int, length: int, sigmas: float, seed: int) -> SyntheticDrive:
    """Add runs of false loops that agree with one another, `sigmas` from odometry."""
    rng, chain = np.random.default_rng(seed), OdometryChain(PoseGraphConfig().drift)
    for T in drive.motions:
        chain.append(T, np.diag(STEP_SIGMAS**2))
    poses, false = chain.poses, []
    for _ in range(runs):
        query = int(rng.integers(300, len(poses) - 3 * length))
        match = int(rng.integers(0, query - MIN_GAP_FRAMES - 3 * length))
        between = chain.between(match, query)
        xi = np.linalg.cholesky(between.covariance) @ rng.normal(size=6)
        xi *= sigmas / np.sqrt(xi @ np.linalg.solve(between.covariance, xi))
        T_match_query = between.T_first_second @ se3.exp(xi)
        for k in range(0, 3 * length, 3):
            back, on = se3.inverse(poses[match + k]) @ poses[match], se3.inverse(poses[query]) @ poses[query + k]
            T = back @ T_match_query @ on @ se3.exp(rng.normal(0.0, LOOP_SIGMAS))
            false.append(LoopClosure(query + k, match + k, T, np.diag(LOOP_SIGMAS**2), 50))
    true = np.concatenate([drive.true, np.zeros(len(false), bool)])
    return replace(drive, loops=(*drive.loops, *false), true=true)


def run_online(drive: SyntheticDrive, config: PoseGraphConfig | None = None) -> OnlineRun:
    """Add all frames and loops, asking for the pose of each frame."""
    graph, loops = PoseGraph(config), {}
    for loop in drive.loops:
        loops.setdefault(loop.query, []).append(loop)
    known, processor, clock = [np.eye(4)], [], []
    for frame, T in enumerate(drive.motions, start=1):
        start = time.process_time(), time.perf_counter()
        graph.add_odometry(T, np.diag(STEP_SIGMAS**2))
        for loop in loops.get(frame, ()):
            graph.add_loop(loop)
        known.append(graph.current_pose())
        processor.append(1e3 * (time.process_time() - start[0]))
        clock.append(1e3 * (time.perf_counter() - start[1]))
    at_loop = np.array([frame in loops for frame in range(1, len(known))])
    return OnlineRun(graph, np.array(known), np.array(processor), np.array(clock), at_loop)


def ate(poses: Array, truth: Array) -> float:
    """Root mean square position error after rigid alignment, metres."""
    a, b = (T[:, :3, 3] - T[:, :3, 3].mean(axis=0) for T in (poses, truth))
    rotation, _ = Rotation.align_vectors(b, a)
    return float(np.sqrt(np.mean(np.sum((rotation.apply(a) - b) ** 2, axis=1))))


def summarize(times: Array) -> str:
    """Sum up times in three numbers."""
    return f"{np.median(times):6.1f} {np.percentile(times, 99):6.1f} {times.max():6.1f}"


def print_times(poses: Array) -> None:
    """Print the milliseconds for each pose with few and with many loops."""
    print("times in ms: median, 99th percentile, worst\n")
    print("loops  poses   all poses, processor   all poses, clock       at a loop, processor   map ATE (odometry) m")
    for every in (5, 3, 1):
        drive = make_drive(poses, every)
        result = run_online(drive)
        odometry = np.array(list(accumulate(drive.motions, np.matmul, initial=np.eye(4))))
        print(
            f"{len(drive.loops):5d}  {len(poses):5d}   {summarize(result.processor_ms)}   "
            f"{summarize(result.clock_ms)}   "
            f"{summarize(result.processor_ms[result.at_loop])}   {ate(result.graph.poses(), poses):.2f} "
            f"({ate(odometry, poses):.2f})",
            flush=True,
        )


def print_safety(poses: Array) -> None:
    """Print the errors of maps with false loops that pass the gate."""
    print("\nfalse loops that pass the gate, 3.5 sigma of drift from odometry, among 264 true ones\n")
    print("runs  of  seed   used at the end: true  false   map ATE m   known at each moment: ATE m   worst ms")
    drive = make_drive(poses, 3)
    for runs, length in ((0, 0), (10, 1), (40, 1), (1, 5), (3, 5), (1, 15), (5, 5), (5, 10)):
        for seed in (0, 1) if runs else (0,):
            mixed = with_false_runs(drive, runs, length, 3.5, seed)
            result = run_online(mixed)
            last = {event.loop: event.used for event in result.graph.loop_events}
            truth = {id(loop): good for loop, good in zip(mixed.loops, mixed.true, strict=True)}
            used = [truth[id(loop)] for k, loop in enumerate(result.graph.loops) if last[k]]
            print(
                f"{runs:4d}  {length:2d}  {seed:4d}   {sum(used):22d} {len(used) - sum(used):6d}"
                f"   {ate(result.graph.poses(), poses):9.2f}   {ate(result.known, poses):27.2f}"
                f"   {result.processor_ms.max():8.1f}",
                flush=True,
            )


def print_long_drive(laps: int) -> None:
    """Print the cost of a drive of laps by its tenths, and that of the controls."""
    every_pass = PoseGraphConfig(loop_selection=LoopSelectionConfig(known_places=KnownPlaceConfig(max_passes=10**9)))
    for title, count, repeats_errors, config in (
        (f"{laps} laps", laps, False, None),
        ("control: 3 laps", 3, False, None),
        ("control: 10 laps, a node of each pass", 10, False, every_pass),
        (f"{laps} laps with the same errors", laps, True, None),
    ):
        drive = with_false_runs(make_laps(count, 0, repeats_errors), count, 1, 3.5, seed=0)
        result = run_online(drive, config)
        tenths = np.array_split(result.processor_ms, 10)
        last = {event.loop: event.used for event in result.graph.loop_events}
        is_true = {id(loop): good for loop, good in zip(drive.loops, drive.true, strict=True)}
        true = sum(last[k] and is_true[id(loop)] for k, loop in enumerate(result.graph.loops))
        false = sum(last.values()) - true
        print(f"{title}: {len(drive.poses)} poses, {len(drive.loops)} loops, of which {count} are false")
        print("processor ms by tenths: median " + " ".join(f"{np.median(part):5.1f}" for part in tenths))
        print("               99th percentile " + " ".join(f"{np.percentile(part, 99):5.1f}" for part in tenths))
        print(
            f"nodes {result.graph.num_online_nodes}, loops that are edges {result.graph.num_online_loops}, "
            f"loops used: {true} true, {false} false"
        )
        odometry = np.array(list(accumulate(drive.motions, np.matmul, initial=np.eye(4))))
        map_ate = ate(result.graph.poses(), drive.poses)
        print(f"ATE m: map {map_ate:.3f}, odometry {ate(odometry, drive.poses):.2f}\n", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=existing, default=os.environ.get("REVISIT_TEST_DATA"))
    parser.add_argument("--laps", type=int, default=0, help="of a long drive, in place of KITTI 00's shape")
    arguments = parser.parse_args()
    if arguments.laps:
        print_long_drive(arguments.laps)
        return
    folder = Path(arguments.folder)
    poses = true_poses(folder, "00")
    print_times(poses)
    print_safety(poses)


if __name__ == "__main__":
    run_script(main)
