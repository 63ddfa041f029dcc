"""What faults of the recording do to the odometry: one finite pose each, flags, and the way kept.

    python benchmarks/odometry_faults.py ROOT 05 06 01 [--frames 60] [--mono]

ROOT holds drives in KITTI's layout with `poses/NN.txt`. Each fault strikes after two fifths of the drive.
"predicted" counts the frames that are flagged; "error" is that of the last position over the distance driven,
unaligned; "after" counts only the path after the fault; the row "none" is the drive without fault. Images that were
dropped in a bend show nothing of what came before: the path is extrapolated, flagged, and wrong.
With `--mono` the left images are used alone, and their scale is that of the way before the fault.
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from odometry_drives import Array, Drive, Pair, chain_poses, end_error, path_length_m

from odometry import MonoOdometry, StereoCamera, StereoOdometry, se3

Frames = list[tuple[float, Pair, Array]]  # time in seconds, images, true pose
_SECONDS = 0.1  # between images


def read(drive: Drive) -> Frames:
    """Read a drive's images with their true poses."""
    return [(_SECONDS * k, pair, pose) for k, (pair, pose) in enumerate(zip(drive.pairs(), drive.truth(), strict=True))]


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
_LONGEST = 11  # frames until every fault but missing images is over, which are over at once


def run(camera: StereoCamera, frames: Frames) -> list[Any]:
    """Run the stereo odometry: one motion a frame."""
    odometry = StereoOdometry(camera)
    return [odometry.track(*pair, time) for time, pair, _ in frames]


def run_mono(camera: StereoCamera, frames: Frames) -> list[Any]:
    """Run the monocular odometry: one motion a frame."""
    odometry = MonoOdometry(camera)
    return [odometry.track(left, time) for time, (left, _), _ in frames]


def errors(poses: Array, frames: Frames, recovered: int) -> tuple[float, float]:
    """Error at the end, per cent of the distance: from the start, and from the frame where the fault was over."""
    truth = np.array([pose for _, _, pose in frames])
    rest, rest_truth = (se3.inverse(each[recovered]) @ each[recovered:] for each in (poses, truth))
    return end_error(poses, truth), end_error(rest, rest_truth)


def in_metres(poses: Array, frames: Frames, at: int) -> Array:
    """Poses (N, 4, 4) with the scale of the way before a frame."""
    truth = np.array([pose for _, _, pose in frames])
    poses = poses.copy()
    poses[:, :3, 3] *= path_length_m(truth[:at]) / path_length_m(poses[:at])
    return poses


def report(drive: Drive, mono: bool) -> None:
    """Print one table: a row for each fault."""
    frames, camera = read(drive), drive.camera()
    at = len(frames) * 2 // 5
    print(f"\n{drive.name}: {len(frames)} frames\n    {'fault':<12} predicted  finite  error %  after %  reasons")
    for fault, strike in FAULTS.items():
        struck = strike(frames, at)
        motions = (run_mono if mono else run)(camera, struck)
        finite = np.isfinite(chain_poses(motions)).all() and len(motions) == len(struck)
        flagged, reasons = sum(m.predicted for m in motions), "; ".join(sorted({m.reason for m in motions} - {""}))
        poses = in_metres(chain_poses(motions), struck, at) if mono else chain_poses(motions)
        total, after = errors(poses, struck, max(at, min(at + _LONGEST, len(struck) - 5)))
        print(f"    {fault:<12} {flagged:9d}  {finite!s:>6}  {total:7.2f}  {after:7.2f}  {reasons}", flush=True)


def main() -> None:
    """Parse the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", type=Path)
    parser.add_argument("sequences", nargs="+")
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--mono", action="store_true")
    arguments = parser.parse_args()
    for name in arguments.sequences:
        report(Drive(arguments.root, name, arguments.frames), arguments.mono)


if __name__ == "__main__":
    main()
