"""Drives in KITTI's layout for the benchmarks of the odometry, and runs of the odometry on them."""

import argparse
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from command_line import existing

from odometry import Motion, StereoCamera, StereoOdometry, StereoOdometryConfig, se3

Array = np.ndarray
Pair = tuple[Array, Array]


@dataclass(frozen=True)
class Drive:
    """One sequence below a root: `sequences/NN/{image_0,image_1,calib.txt,times.txt}` and `poses/NN.txt`."""

    root: Path
    name: str
    count: int = 1_000_000

    @property
    def _folder(self) -> Path:
        return self.root / "sequences" / self.name

    def __len__(self) -> int:
        return len(self._files())

    def _files(self) -> list[Path]:
        return sorted((self._folder / "image_0").glob("*.png"))[: self.count]

    def camera(self) -> StereoCamera:
        """Rectified intrinsics of the grey cameras P0 and P1."""
        lines = dict(line.split(":") for line in (self._folder / "calib.txt").read_text().splitlines() if ":" in line)
        P0, P1 = (np.array(lines[key].split(), dtype=np.float64).reshape(3, 4) for key in ("P0", "P1"))
        height, width = cv2.imread(str(self._files()[0]), cv2.IMREAD_GRAYSCALE).shape
        return StereoCamera(P0[0, 0], P0[1, 1], P0[0, 2], P0[1, 2], -P1[0, 3] / P1[0, 0], width, height)

    def pairs(self) -> Iterator[Pair]:
        """Decode the images, pair by pair."""
        for file in self._files():
            left, right = (
                cv2.imread(str(self._folder / side / file.name), cv2.IMREAD_GRAYSCALE)
                for side in ("image_0", "image_1")
            )
            yield left, right

    def lefts(self) -> Iterator[Array]:
        """Decode the left images."""
        for file in self._files():
            yield cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)

    def truth(self) -> Array:
        """True T_first_camera (N, 4, 4), metres."""
        poses = np.tile(np.eye(4), (len(self), 1, 1))
        poses[:, :3] = np.loadtxt(self.root / "poses" / f"{self.name}.txt").reshape(-1, 3, 4)[: len(self)]
        return np.asarray(se3.inverse(poses[0]) @ poses)


class StageTimes:
    """Milliseconds of each frame: wall-clock time, processor time, and the time of each stage.

    Args of the constructor:
        stages: functions that are timed from now on: owner, name of its attribute, and name of the stage.
    """

    def __init__(self, stages: tuple[tuple[Any, str, str], ...]) -> None:
        self._labels = ("frame", "cpu", *(label for _, _, label in stages))
        self._spent: dict[str, list[float]] = defaultdict(list)
        for owner, name, label in stages:
            setattr(owner, name, self._timed(label, getattr(owner, name)))

    def clear(self) -> None:
        """Forget all frames."""
        self._spent.clear()

    def frame(self, track: Callable[..., Motion], *images: Array) -> Motion:
        """Track a frame and record its times."""
        for label in self._labels:
            self._spent[label].append(0.0)
        cpu = time.process_time()
        motion: Motion = self._timed("frame", track)(*images)
        self._spent["cpu"][-1] = 1e3 * (time.process_time() - cpu)
        return motion

    def print(self) -> None:
        """Print one row for each stage; the first frame, which has no motion, does not count."""
        for label, values in self._spent.items():
            spent = np.array(values[1:])
            print(
                f"    {label:<20} median {np.median(spent):6.2f} ms   p99 {np.percentile(spent, 99):6.2f} ms",
                flush=True,
            )

    def _timed(self, label: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap a stage so that its time is added to the frame's."""

        def wrapper(*args: Any, **kwargs: Any) -> Any:
            start = time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                self._spent[label][-1] += 1e3 * (time.perf_counter() - start)

        return wrapper


def run(drive: Drive, config: StereoOdometryConfig | None = None) -> tuple[Array, list[Motion]]:
    """Run the odometry over a drive: poses (N, 4, 4) and motions."""
    odometry = StereoOdometry(drive.camera(), config)
    motions = [odometry.track(*pair) for pair in drive.pairs()]
    return chain_poses(motions), motions


def chain_poses(motions: list[Motion]) -> Array:
    """Poses (N, 4, 4) from motions, the first at the identity."""
    poses = [np.eye(4)]
    for motion in motions[1:]:
        poses.append(poses[-1] @ motion.T_previous_current)
    return np.array(poses)


def path_length_m(poses: Array) -> float:
    """Length of the path along poses (N, 4, 4), metres."""
    return float(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum())


def end_error(poses: Array, truth: Array) -> float:
    """Error of the last position, per cent of the path length, without alignment; NaN for a drive of no length."""
    if len(truth) < 2:
        return float("nan")
    return 100 * float(np.linalg.norm(poses[-1, :3, 3] - truth[-1, :3, 3])) / path_length_m(truth)


def measure(
    description: str | None,
    stages: tuple[tuple[Any, str, str], ...],
    track: Callable[[Drive, StageTimes], object],
    report: Callable[[Drive, StageTimes], None],
) -> None:
    """Parse a command line that names drives, and report on each.

    Args:
        description: text of `--help`.
        stages: stages of the odometry that are timed.
        track: function that runs the odometry on a drive; called once before the measurement, because this compiles.
        report: function that runs the odometry on a drive and prints the results.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", type=existing)
    parser.add_argument("sequences", nargs="+")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--frames", type=int, default=1_000_000)
    arguments = parser.parse_args()
    cv2.setNumThreads(arguments.threads)
    times = StageTimes(stages)
    track(Drive(arguments.root, arguments.sequences[0], 20), times)
    for name in arguments.sequences:
        report(Drive(arguments.root, name, arguments.frames), times)
