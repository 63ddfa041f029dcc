"""Speed and accuracy of the pose graph and its back ends.

    python benchmarks/pose_graph.py [FOLDER OF TEST DATA] [--parts real few standard online long] [--back-ends NAME...]

real: odometry of KITTI by LIBVISO2 with the loops that a bag of words proposed, most of them false (the RobustSLAM
graphs), under default settings. In the files every false loop measures (0, 0, 0); here they stay so, become random
small motions, or agree with one another within each run of false loops. All covariances are also multiplied by
1/16 and by 16. few: the same with no true loop, with one, and with three. standard: minima of public graphs from
odometry alone, and the time against plain Levenberg-Marquardt. online: simulated drives on real trajectories, one
pose at a time. long: a circle driven many times, with loops to all laps before, of which one in twenty is false.
"""

import argparse
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from command_line import existing, run_script
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from odometry import se3
from slam.evaluation.pose_graph_errors import absolute_error, find_truth
from slam.io.g2o import read_g2o
from slam.io.g2o_problem import classify_edges
from slam.loop_closing.loop_closer import LoopClosure
from slam.pipeline.provenance import peak_memory_mb
from slam.pose_graph.optimization.edges import Edges, from_measurements
from slam.pose_graph.optimization.gtsam_solver import chordal_initialization, optimize, refine
from slam.pose_graph.optimization.lie_groups import SE3, compose, inverse
from slam.pose_graph.pose_graph import PoseGraph, PoseGraphConfig
from slam.pose_graph.robust.backends import BACK_ENDS, DEFAULT, LoopProblem, solve
from slam.pose_graph.robust.problem import condensed_covariances

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FALSE_SIGMAS = (2.0, 0.5, 0.1)  # m, m, rad: standard deviations of the motions that false loops are given
MAX_RUN_GAP = 15  # poses between the loops of one run
FACTORS = (1.0, 1 / 16, 16.0)
STANDARD = ("smallGrid3D", "CSAIL", "intel", "manhattan", "parking-garage", "sphere2500", "torus3D", "city10000")
LONG_DRIVES = ((18_000, 17_260), (100_000, 100_000))  # frames, loops
LAP_FRAMES, LAP_STEP_M = 300, 1.2  # of a lap of the circle
FALSE_SHARE, FALSE_RUN = 0.05, 10  # of all loops, half of them in runs of ten
ODOMETRY_SIGMAS = np.repeat([2e-4, 0.01], 3)  # rad and m for each frame
ODOMETRY_BIAS = np.array([0.0, 8e-5, 0.0, 0.0, 0.0, 0.002])
LOOP_SIGMAS = np.repeat([2e-3, 0.03], 3)


@dataclass(frozen=True)
class RealGraph:
    """A real graph in the plane, with the true positions and which loops are true."""

    name: str
    problem: LoopProblem
    true: Mask
    positions: Array


def real_graphs(folder: Path) -> Iterator[RealGraph]:
    """Read the nine graphs."""
    for path in sorted((folder / "pose_graphs" / "kitti_real_loops").glob("*.g2o")):
        graph = read_g2o(path)
        classified = classify_edges(graph, path.name)
        truth = find_truth(path, graph, classified.trusted, folder / "kitti_poses")
        if truth.loops is not None and truth.positions is not None:
            yield RealGraph(path.stem.removeprefix("kitti_"), classified.problem, truth.loops, truth.positions)


def zero(real: RealGraph) -> Edges:
    """Loops as in the file."""
    return real.problem.loops


def random(real: RealGraph) -> Edges:
    """Loops whose false ones measure small random motions."""
    return _with_false(real, agreeing=False)


def agreeing(real: RealGraph) -> Edges:
    """Loops whose false ones agree along odometry with the first of their run."""
    return _with_false(real, agreeing=True)


def _with_false(real: RealGraph, agreeing: bool) -> Edges:
    rng, loops, chain = np.random.default_rng(0), real.problem.loops, real.problem.start
    motions, previous, begin = loops.motions.copy(), (-100, -100), -1
    late, early = np.maximum(loops.first, loops.second), np.minimum(loops.first, loops.second)
    for k in np.lexsort((early, late)):
        if real.true[k]:
            continue
        ends = (int(loops.first[k]), int(loops.second[k]))
        if agreeing and max(abs(ends[0] - previous[0]), abs(ends[1] - previous[1])) <= MAX_RUN_GAP:
            i, j = loops.first[begin], loops.second[begin]
            motions[k] = inverse(chain[ends[0]]) @ chain[i] @ motions[begin] @ inverse(chain[j]) @ chain[ends[1]]
        else:
            motions[k] = loops.group.exp(rng.normal(0.0, FALSE_SIGMAS)[None])[0]
            begin = k
        previous = ends
    return replace(loops, motions=motions)


VARIANTS = {"as in the file": zero, "random": random, "agreeing runs": agreeing}


def scale_covariances(edges: Edges, factor: float) -> Edges:
    """Multiply all covariances by a factor."""
    return replace(edges, information=edges.information / factor)


def print_case(real: RealGraph, label: str, problem: LoopProblem, back_end: str) -> None:
    """Print one line: ATE against that of the true loops alone, kept loops, time."""
    start, clock = time.perf_counter(), time.process_time()
    outcome = solve(problem, back_end)
    seconds, busy = time.perf_counter() - start, time.process_time() - clock
    poses = optimize(problem.edges_with(real.true), problem.start) if real.true.any() else problem.start
    best, ate = absolute_error(poses, real.positions), absolute_error(outcome.poses, real.positions)
    kept = outcome.kept
    ok = ate is not None and best is not None and ate <= 1.02 * best and not kept[~real.true].any()
    print(
        f"{real.name:14} {label:24} {back_end:10} ATE {ate:7.2f} m, of true loops {best:6.2f} m   kept "
        f"{kept[real.true].sum():4d} of {real.true.sum():4d} true, {kept[~real.true].sum():3d} of "
        f"{(~real.true).sum():3d} false   {seconds:5.2f} s ({busy:5.2f} busy)  {'' if ok else 'MISSED'}",
        flush=True,
    )


def print_real(folder: Path, back_ends: list[str]) -> None:
    """Print the table of the real graphs, their variants and their scales."""
    for real in real_graphs(folder):
        for variant, changed in VARIANTS.items():
            loops = changed(real)
            for factor in FACTORS:
                trusted = scale_covariances(real.problem.trusted, factor)
                problem = LoopProblem(trusted, scale_covariances(loops, factor), real.problem.start)
                for back_end in back_ends:
                    print_case(real, f"{variant}, x {factor:g}", problem, back_end)


def print_few(folder: Path, back_ends: list[str], trials: int = 6) -> None:
    """Print the table of the real graphs with hardly any true loop left."""
    for real in real_graphs(folder):
        if not real.name.endswith("0.15"):
            continue
        order = np.random.default_rng(5).permutation(np.flatnonzero(real.true))
        picks = {"no true loop": order[:0]}
        picks |= {f"one true loop ({k})": order[k : k + 1] for k in range(trials)}
        picks |= {f"three true loops ({k})": order[3 * k : 3 * k + 3] for k in range(trials // 2)}
        for label, picked in picks.items():
            left = ~real.true
            left[picked] = True
            problem = replace(real.problem, loops=zero(real)[left])
            for back_end in back_ends:
                print_case(RealGraph(real.name, problem, real.true[left], real.positions), label, problem, back_end)


def print_standard(folder: Path, back_ends: list[str]) -> None:
    """Print minima and times of public graphs from odometry alone, and the loops that the back ends keep."""
    for name in STANDARD:
        problem = classify_edges(read_g2o(folder / "pose_graphs" / f"{name}.g2o"), name).problem
        edges = problem.edges_with(np.ones(len(problem.loops), dtype=bool))
        poses, seconds = time_work(lambda edges=edges, problem=problem: optimize(edges, problem.start))
        start, first = time_work(lambda edges=edges, problem=problem: chordal_initialization(edges, problem.start))
        _, plain = time_work(lambda edges=edges, start=start: refine(edges, start))
        print(
            f"{name:14} minimum {0.5 * edges.chi2(poses).sum():12.6g} in {seconds:5.2f} s from odometry; chordal start "
            f"{first:5.2f} s, plain Levenberg-Marquardt from it {plain:5.2f} s: {seconds / (first + plain):.2f} times "
            f"both, {seconds / plain:.2f} times the latter",
            flush=True,
        )
        for back_end in back_ends:
            outcome, seconds = time_work(lambda problem=problem, back_end=back_end: solve(problem, back_end))
            print(f"  {back_end:10} kept {outcome.kept.sum()} of {len(problem.loops)} in {seconds:.2f} s", flush=True)


def time_work(work: Callable[[], Any]) -> tuple[Any, float]:
    """Do some work and return its result and its seconds."""
    start = time.perf_counter()
    result = work()
    return result, time.perf_counter() - start


@dataclass(frozen=True)
class SyntheticDrive:
    """A synthetic drive: motions with covariances, loops, true positions (N, 3)."""

    name: str
    motions: list[tuple[Array, Array]]
    loops: list[LoopClosure]
    positions: Array


def synthetic_drive(folder: Path, sequence: str, every: int) -> SyntheticDrive:
    """Make a drive on a real trajectory with biased, noisy odometry and all revisits within 4 m, measured well."""
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
    return SyntheticDrive(f"{sequence} synthetic", motions, loops, poses[:, :3, 3])


def time_online(drive: SyntheticDrive) -> None:
    """Print the time of adding a frame and asking for its pose, with and without a loop."""
    graph, loops = PoseGraph(), {loop.query: loop for loop in drive.loops}
    frame_ms, loop_ms = [], []
    for query, (T, covariance) in enumerate(drive.motions, start=1):
        start = time.perf_counter()
        graph.add_odometry(T, covariance)
        if query in loops:
            graph.add_loop(loops[query])
        graph.current_pose()
        (loop_ms if query in loops else frame_ms).append(1e3 * (time.perf_counter() - start))
    online, batch = (absolute_error(poses, drive.positions) for poses in (graph.poses(), graph.optimize().poses))
    print(
        f"{drive.name}: {len(graph)} poses, {len(loop_ms)} loops; ms a pose {summarize(frame_ms)}; "
        f"at a loop {summarize(loop_ms)}; ATE of the last online map {online:.2f} m, of the batch {batch:.2f} m",
        flush=True,
    )


@dataclass(frozen=True)
class LongDrive:
    """A circle driven many times.

    Attributes:
        problem: odometry and loops, with covariances as a run states them.
        true: (L,) which loops are true.
        truth: (N, 4, 4) true poses, metres.
    """

    problem: LoopProblem
    true: Mask
    truth: Array


def make_long_drive(frames: int, loops: int) -> LongDrive:
    """Make a drive with true loops to all earlier laps, and false ones: lone ones, and runs that agree.

    False loops measure small motions, as images of two places that look alike do.
    """
    rng, group, config = np.random.default_rng(0), SE3(), PoseGraphConfig()
    step = np.array([0.0, 2 * np.pi / LAP_FRAMES, 0.0, 0.0, 0.0, LAP_STEP_M])
    truth = compose(np.eye(4), np.tile(group.exp(step[None]), (frames - 1, 1, 1)))
    before, noise = np.arange(frames - 1), group.exp(ODOMETRY_BIAS + rng.normal(size=(frames - 1, 6)) * ODOMETRY_SIGMAS)
    motions = inverse(truth[:-1]) @ truth[1:] @ noise
    trusted = from_measurements(
        np.column_stack([before, before + 1]),
        [(T, config.drift.of_motion(T, np.diag(ODOMETRY_SIGMAS**2))) for T in motions],
    )
    start = compose(np.eye(4), motions)
    query = np.sort(rng.choice(np.arange(LAP_FRAMES, frames), loops, replace=loops > frames - LAP_FRAMES))
    match = query - LAP_FRAMES * rng.integers(1, query // LAP_FRAMES + 1)
    measured = inverse(truth[match]) @ truth[query] @ group.exp(rng.normal(size=(loops, 6)) * LOOP_SIGMAS)
    true = np.ones(loops, dtype=bool)
    true[rng.choice(loops, round(0.5 * FALSE_SHARE * loops), replace=False)] = False
    runs = rng.choice(loops - FALSE_RUN, round(0.5 * FALSE_SHARE * loops / FALSE_RUN), replace=False)
    true[(runs[:, None] + np.arange(FALSE_RUN)).ravel()] = False
    false = np.flatnonzero(~true)
    match[false] = (rng.random(len(false)) * (query[false] - LAP_FRAMES // 4)).astype(np.int64)
    measured[false] = group.exp(rng.normal(size=(len(false), 6)) * np.repeat([0.1, 1.0], 3))
    for begin in runs:
        row = np.arange(begin, begin + FALSE_RUN)
        match[row] = np.minimum(match[begin] + query[row] - query[begin], query[row] - 1)
        back = inverse(start[match[row]]) @ start[match[begin]]
        measured[row] = back @ measured[begin] @ inverse(start[query[begin]]) @ start[query[row]]
    covariance = np.diag(LOOP_SIGMAS**2 + np.repeat(np.square([config.loop_sigma_rad, config.loop_sigma_m]), 3))
    edges = from_measurements(np.column_stack([match, query]), [(T, covariance) for T in measured])
    return LongDrive(LoopProblem(trusted, edges, start), true, truth)


def print_long_case(drive: LongDrive, label: str, work: Callable[[], tuple[Array, Mask]]) -> None:
    """Print one line: cost, ATE and loops of some work in a process of its own, whose memory is its own."""

    def measure() -> None:
        start, clock = time.perf_counter(), time.process_time()
        poses, kept = work()
        seconds, busy = time.perf_counter() - start, time.process_time() - clock
        ate = absolute_error(poses, drive.truth[:, :3, 3])
        print(
            f"{label:12} {seconds:7.1f} s ({busy:7.1f} busy) {peak_memory_mb():7.0f} MB   ATE {ate:8.3f} m   "
            f"{kept[~drive.true].sum():5d} false kept, {(~kept[drive.true]).sum():6d} true left out",
            flush=True,
        )

    process = multiprocessing.get_context("fork").Process(target=measure)
    process.start()
    process.join()


def print_long(folder: Path, back_ends: list[str]) -> None:
    """Print cost and accuracy of the back ends on long drives, beside all loops alike, odometry, and covariances."""
    for frames, loops in LONG_DRIVES:
        drive = make_long_drive(frames, loops)
        print(f"{frames} frames, {loops} loops, {(~drive.true).sum()} of them false")
        print_long_case(drive, "odometry", lambda drive=drive: (drive.problem.start, np.zeros_like(drive.true)))
        for back_end in dict.fromkeys(["none", *back_ends]):
            print_long_case(drive, back_end, lambda drive=drive, back_end=back_end: solve_long(drive, back_end))
        print_long_case(drive, "covariances", lambda drive=drive: estimate_covariances(drive))


def solve_long(drive: LongDrive, back_end: str) -> tuple[Array, Mask]:
    """Poses and kept loops of a back end."""
    outcome = solve(drive.problem, back_end)
    return outcome.poses, outcome.kept


def estimate_covariances(drive: LongDrive) -> tuple[Array, Mask]:
    """Estimate the covariances of the true poses by the true loops, and return both."""
    loops, step = drive.problem.loops[drive.true], np.diag(np.abs(ODOMETRY_BIAS))
    whole = LoopProblem(drive.problem.trusted, loops, drive.truth)
    condensed_covariances(whole, np.tile(step, (len(drive.truth) - 1, 1, 1)))
    return drive.truth, drive.true


def summarize(times: list[float]) -> str:
    """Sum up times in three numbers."""
    return f"median {np.median(times):.2f}, p99 {np.percentile(times, 99):.1f}, worst {max(times):.0f}"


def print_online(folder: Path, back_ends: list[str]) -> None:
    """Print online times of synthetic drives."""
    for sequence in ("07", "00"):
        for every in (5, 1):
            time_online(synthetic_drive(folder, sequence, every))


PARTS = {"real": print_real, "few": print_few, "standard": print_standard, "online": print_online, "long": print_long}


def main() -> None:
    """Print the tables that were asked for."""
    parser = argparse.ArgumentParser(description="Measure the pose graph and its back ends.")
    parser.add_argument("folder", nargs="?", type=existing, default=os.environ.get("REVISIT_TEST_DATA"))
    parser.add_argument("--parts", nargs="+", default=list(PARTS), choices=list(PARTS))
    parser.add_argument("--back-ends", nargs="+", default=[DEFAULT], choices=list(BACK_ENDS))
    arguments = parser.parse_args()
    for part in arguments.parts:
        PARTS[part](Path(arguments.folder), arguments.back_ends)


if __name__ == "__main__":
    run_script(main)
