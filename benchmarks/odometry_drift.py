"""Drift and time of the stereo odometry on drives in KITTI's layout.

    python benchmarks/odometry_drift.py ROOT 05 06 01 [--threads 2]

ROOT holds `sequences/NN/{image_0,image_1,calib.txt}` and, for the drift, `poses/NN.txt`. Images are decoded
before the clock starts. Drift is the error of the last position over the way driven, unaligned; "nees"
is the squared error of the end pose over what the composed covariances allow (6 is honest). "cpu" is the
processor time of all threads, which a busy machine disturbs less than the clock.
"""

import argparse
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from odometry import StereoCamera, StereoOdometry, se3, stereo

STAGES = ("detect", "follow", "match_right", "refine_right", "estimate_motion", "ransac_motion")
times: dict[str, list[float]] = defaultdict(list)  # stage: milliseconds of every frame


def timed(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a stage so that its time is added to the frame's."""

    def wrapper(*args: Any) -> Any:
        start = time.perf_counter()
        try:
            return function(*args)
        finally:
            times[name][-1] += 1e3 * (time.perf_counter() - start)

    return wrapper


def read_camera(folder: Path, shape: tuple[int, ...]) -> StereoCamera:
    """Rectified intrinsics of the grey cameras P0 and P1."""
    lines = dict(line.split(":") for line in (folder / "calib.txt").read_text().splitlines() if ":" in line)
    P0, P1 = (np.array(lines[key].split(), dtype=np.float64).reshape(3, 4) for key in ("P0", "P1"))
    return StereoCamera(P0[0, 0], P0[1, 1], P0[0, 2], P0[1, 2], -P1[0, 3] / P1[0, 0], shape[1], shape[0])


def drive(folder: Path) -> tuple[np.ndarray, np.ndarray, list[Any]]:
    """Run the odometry over a folder: poses (N, 4, 4), covariance of the last (6, 6), all motions."""
    files = sorted((folder / "image_0").glob("*.png"))
    odometry, poses, covariance, motions = None, [np.eye(4)], np.zeros((6, 6)), []
    for file in files:
        left, right = (
            cv2.imread(str(folder / side / file.name), cv2.IMREAD_GRAYSCALE) for side in ("image_0", "image_1")
        )
        odometry = odometry or StereoOdometry(read_camera(folder, left.shape))
        for stage in (*STAGES, "frame", "cpu"):
            times[stage].append(0.0)
        cpu = time.process_time()
        motion = timed("frame", odometry.track)(left, right)
        times["cpu"][-1] = 1e3 * (time.process_time() - cpu)
        poses.append(poses[-1] @ motion.T_previous_current)
        covariance = se3.compose_covariance(covariance, motion.T_previous_current, motion.covariance)
        motions.append(motion)
    return np.array(poses[1:]), covariance, motions


def describe_drift(poses: np.ndarray, covariance: np.ndarray, file: Path) -> str:
    """Drift, rotation error and nees of the end pose, where there is truth."""
    if not file.exists():
        return "no truth"
    truth = np.tile(np.eye(4), (len(poses), 1, 1))
    truth[:, :3] = np.loadtxt(file).reshape(-1, 3, 4)[: len(poses)]
    way = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1).sum()
    end = se3.inverse(truth[0]) @ truth[-1]
    error = se3.log(se3.inverse(poses[-1]) @ end)
    drift = 100 * np.linalg.norm(poses[-1][:3, 3] - end[:3, 3]) / way
    angle, nees = np.degrees(np.linalg.norm(error[:3])), error @ np.linalg.solve(covariance, error)
    return f"drift {drift:.2f} %  rotation {angle:.2f} deg  way {way:.0f} m  nees {nees:.0f}"


def report(root: Path, name: str) -> None:
    """Measure one sequence and print its rows."""
    times.clear()
    poses, covariance, motions = drive(root / "sequences" / name)
    measured = [m for m in motions[1:] if not m.predicted]
    truth = root / "poses" / f"{name}.txt"
    print(f"\n{name}: {len(poses)} frames  {describe_drift(poses, covariance, truth)}")
    tracks = np.mean([len(m.inliers) for m in measured])
    print(
        f"    predicted {len(motions) - 1 - len(measured)}  tracks {tracks:.0f}"
        f"  inliers {100 * np.mean([m.inliers.mean() for m in measured]):.0f} %"
        f"  residual {np.median([m.residual_px for m in measured]):.3f} px"
    )
    for stage in ("frame", "cpu", *STAGES):
        values = np.array(times[stage][1:])
        print(f"    {stage:<16} median {np.median(values):6.2f} ms   p99 {np.percentile(values, 99):6.2f} ms")


def main() -> None:
    """Parse the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", type=Path)
    parser.add_argument("sequences", nargs="+")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    cv2.setNumThreads(arguments.threads)
    for stage in STAGES:
        setattr(stereo, stage, timed(stage, getattr(stereo, stage)))
    times.clear()
    drive(arguments.root / "sequences" / arguments.sequences[0])  # compiles and warms up
    for name in arguments.sequences:
        report(arguments.root, name)


if __name__ == "__main__":
    main()
