"""What faults of the recording do to the stereo odometry: one finite pose each, flags, and the way kept.

    python benchmarks/odometry_faults.py ROOT 05 06 01 [--frames 60]

ROOT holds drives in KITTI's layout with `poses/NN.txt`. Each fault strikes in the middle of the drive. "predicted"
counts the frames that are flagged; "error" is that of the last position over the
way driven, unaligned; the row "none" is the drive without fault.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from odometry_drift import read_camera

from odometry import StereoOdometry, se3

Pair = tuple[np.ndarray, np.ndarray]
Frames = list[tuple[float, Pair, np.ndarray]]  # time in seconds, images, true pose
_SECONDS = 0.1  # between images


def read(root: Path, name: str, count: int) -> Frames:
    """Read the first images of a drive with their true poses."""
    folder = root / "sequences" / name
    files = sorted((folder / "image_0").glob("*.png"))[:count]
    truth = np.tile(np.eye(4), (len(files), 1, 1))
    truth[:, :3] = np.loadtxt(root / "poses" / f"{name}.txt").reshape(-1, 3, 4)[: len(files)]
    pairs = [tuple(cv2.imread(str(folder / f"image_{side}" / f.name), 0) for side in (0, 1)) for f in files]
    return [(_SECONDS * k, pair, pose) for k, (pair, pose) in enumerate(zip(pairs, truth, strict=True))]


def dropped(count: int) -> Callable[[Frames, int], Frames]:
    """Leave out images; the time stamps show it."""
    return lambda frames, at: frames[:at] + frames[at + count :]


def replaced(count: int, change: Callable[[Pair, int], Pair]) -> Callable[[Frames, int], Frames]:
    """Change the images of some frames."""

    def strike(frames: Frames, at: int) -> Frames:
        return [
            (time, change(pair, k) if at <= k < at + count else pair, pose)
            for k, (time, pair, pose) in enumerate(frames)
        ]

    return strike


def filled(value: int) -> Callable[[Pair, int], Pair]:
    """Images of one grey value."""
    return lambda pair, k: (np.full_like(pair[0], value), np.full_like(pair[1], value))


def noise(pair: Pair, k: int) -> Pair:
    """Images of noise."""
    rng = np.random.default_rng(k)
    return tuple(rng.integers(0, 256, image.shape, dtype=np.uint8) for image in pair)  # type: ignore[return-value]


def blurred(pair: Pair, k: int) -> Pair:
    """Images without detail."""
    return tuple(cv2.GaussianBlur(image, (0, 0), 8.0) for image in pair)  # type: ignore[return-value]


def dark(pair: Pair, k: int) -> Pair:
    """Images at an eighth of the light."""
    return tuple(image // 8 for image in pair)  # type: ignore[return-value]


def occluded(pair: Pair, k: int) -> Pair:
    """A textured truck, ten pixels of disparity away, that keeps its distance and fills 60 % of the view."""
    height, width = pair[0].shape
    truck = np.random.default_rng(0).integers(0, 256, (height, width), dtype=np.uint8)
    truck = cv2.GaussianBlur(truck, (0, 0), 2.0)
    truck = cv2.normalize(truck, None, 20, 235, cv2.NORM_MINMAX)
    left, right = pair[0].copy(), pair[1].copy()
    rows, columns = slice(int(0.1 * height), int(0.9 * height)), slice(int(0.125 * width), int(0.875 * width))
    left[rows, columns] = truck[rows, columns]
    right[rows, columns] = np.roll(truck, -10, axis=1)[rows, columns]
    return left, right


FAULTS: dict[str, Callable[[Frames, int], Frames]] = {
    "none": lambda frames, at: frames,
    "1 dropped": dropped(1),
    "5 dropped": dropped(5),
    "30 dropped": dropped(30),
    "1 black": replaced(1, filled(0)),
    "5 black": replaced(5, filled(0)),
    "5 white": replaced(5, filled(255)),
    "5 noise": replaced(5, noise),
    "5 blurred": replaced(5, blurred),
    "5 dark": replaced(5, dark),
    "5 repeated": lambda frames, at: frames[:at] + [frames[at]] * 5 + frames[at:],
    "8 swapped": replaced(8, lambda pair, k: (pair[1], pair[0])),
    "10 occluded": replaced(10, occluded),
}


def run(camera: Any, frames: Frames) -> tuple[np.ndarray, list[Any]]:
    """Run the odometry: poses (N, 4, 4) and motions."""
    odometry, poses, motions = StereoOdometry(camera), [np.eye(4)], []
    for time, pair, _ in frames:
        motions.append(odometry.track(*pair, time))
        poses.append(poses[-1] @ motions[-1].T_previous_current)
    return np.array(poses[1:]), motions


def end_error(poses: np.ndarray, frames: Frames) -> float:
    """Error of the last position over the way driven, per cent."""
    truth = np.array([pose for _, _, pose in frames])
    way = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1).sum()
    end = se3.inverse(truth[0]) @ truth[-1]
    return 100 * float(np.linalg.norm(poses[-1][:3, 3] - end[:3, 3])) / way


def report(root: Path, name: str, count: int) -> None:
    """Print one table: a row for each fault."""
    frames = read(root, name, count)
    camera = read_camera(root / "sequences" / name, frames[0][1][0].shape)
    print(f"\n{name}: {len(frames)} frames\n    {'fault':<12} predicted  finite  error %  reasons")
    for fault, strike in FAULTS.items():
        struck = strike(frames, len(frames) * 2 // 5)
        poses, motions = run(camera, struck)
        flagged = [m for m in motions if m.predicted]
        finite = bool(np.isfinite(poses).all()) and len(poses) == len(struck)
        reasons = "; ".join(sorted({m.reason for m in flagged}))
        print(f"    {fault:<12} {len(flagged):9d}  {finite!s:>6}  {end_error(poses, struck):7.2f}  {reasons}")


def main() -> None:
    """Parse the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", type=Path)
    parser.add_argument("sequences", nargs="+")
    parser.add_argument("--frames", type=int, default=200)
    arguments = parser.parse_args()
    for name in arguments.sequences:
        report(arguments.root, name, arguments.frames)


if __name__ == "__main__":
    main()
