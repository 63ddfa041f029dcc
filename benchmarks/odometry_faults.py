"""Faults of a recording and the odometry: is every pose finite, is the fault flagged, and how far off is the path?

    python benchmarks/odometry_faults.py ROOT 05 06 01 [--frames 60] [--mono]

ROOT holds drives in KITTI's layout with `poses/NN.txt`. Each fault begins after two fifths of the drive. The column
"predicted" counts the flagged frames, "error" is the error of the last position in per cent of the path length, without
alignment, "after" is the same for the path after the fault alone, and the row "none" is the drive without fault. Images
after a gap in a bend have nothing in common with those before it: the path is extrapolated, flagged, and wrong. With
`--mono` the left images are used alone, and the path before the fault gives the scale.
"""

import argparse
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from command_line import existing, run_script
from odometry_drives import Array, Drive, Pair, chain_poses, end_error, path_length_m

from odometry import MonoOdometry, StereoCamera, StereoOdometry, se3

Frames = list[tuple[float, Pair, Array]]  # time in seconds, images, true pose
_PERIOD_S = 0.1  # between images


def read(drive: Drive) -> Frames:
    """Read a drive's images with their true poses."""
    return [
        (_PERIOD_S * k, pair, pose) for k, (pair, pose) in enumerate(zip(drive.pairs(), drive.truth(), strict=True))
    ]


def drop_images(count: int) -> Callable[[Frames, int], Frames]:
    """Return a fault that leaves out images; the timestamps show the gap."""
    return lambda frames, at: frames[:at] + frames[at + count :]


def change_images(count: int, change: Callable[[Pair, int], Pair]) -> Callable[[Frames, int], Frames]:
    """Return a fault that changes the images of some frames."""

    def strike(frames: Frames, at: int) -> Frames:
        return [
            (time, change(pair, k) if at <= k < at + count else pair, pose)
            for k, (time, pair, pose) in enumerate(frames)
        ]

    return strike


def fill(value: int) -> Callable[[Pair, int], Pair]:
    """Return a change to images of one grey value."""
    return lambda pair, k: (np.full_like(pair[0], value), np.full_like(pair[1], value))


def replace_by_noise(pair: Pair, k: int) -> Pair:
    """Replace a pair by noise."""
    rng = np.random.default_rng(k)
    return tuple(rng.integers(0, 256, image.shape, dtype=np.uint8) for image in pair)  # type: ignore[return-value]


def blur(pair: Pair, k: int) -> Pair:
    """Remove the detail of a pair."""
    return tuple(cv2.GaussianBlur(image, (0, 0), 8.0) for image in pair)  # type: ignore[return-value]


def darken(pair: Pair, k: int) -> Pair:
    """Reduce the brightness of a pair to an eighth."""
    return tuple(image // 8 for image in pair)  # type: ignore[return-value]


def occlude(pair: Pair, k: int) -> Pair:
    """Put a textured truck before a pair; it keeps its distance, 10 px of disparity, and fills 60 % of the view."""
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
    "1 dropped": drop_images(1),
    "5 dropped": drop_images(5),
    "30 dropped": drop_images(30),
    "1 black": change_images(1, fill(0)),
    "5 black": change_images(5, fill(0)),
    "5 white": change_images(5, fill(255)),
    "5 noise": change_images(5, replace_by_noise),
    "5 blurred": change_images(5, blur),
    "5 dark": change_images(5, darken),
    "5 repeated": lambda frames, at: frames[:at] + [frames[at]] * 5 + frames[at:],
    "8 swapped": change_images(8, lambda pair, k: (pair[1], pair[0])),
    "10 occluded": change_images(10, occlude),
}
_MAX_FAULT_FRAMES = 11  # until every fault is over; a gap of missing images is over with the next frame


def run(camera: StereoCamera, frames: Frames) -> list[Any]:
    """Run the stereo odometry and return the motion of each frame."""
    odometry = StereoOdometry(camera)
    return [odometry.track(*pair, time) for time, pair, _ in frames]


def run_mono(camera: StereoCamera, frames: Frames) -> list[Any]:
    """Run the monocular odometry and return the motion of each frame."""
    odometry = MonoOdometry(camera)
    return [odometry.track(left, time) for time, (left, _), _ in frames]


def errors(poses: Array, frames: Frames, recovered: int) -> tuple[float, float]:
    """Return the end error, per cent of the path length: from the start, and from the frame where the fault is over."""
    truth = np.array([pose for _, _, pose in frames])
    rest, rest_truth = (se3.inverse(each[recovered]) @ each[recovered:] for each in (poses, truth))
    return end_error(poses, truth), end_error(rest, rest_truth)


def scale_to_metres(poses: Array, frames: Frames, at: int) -> Array:
    """Scale poses (N, 4, 4) so that the path before a frame has its true length."""
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
        poses = scale_to_metres(chain_poses(motions), struck, at) if mono else chain_poses(motions)
        total, after = errors(poses, struck, max(at, min(at + _MAX_FAULT_FRAMES, len(struck) - 5)))
        print(f"    {fault:<12} {flagged:9d}  {finite!s:>6}  {total:7.2f}  {after:7.2f}  {reasons}", flush=True)


def main() -> None:
    """Parse the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", type=existing)
    parser.add_argument("sequences", nargs="+")
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--mono", action="store_true")
    arguments = parser.parse_args()
    for name in arguments.sequences:
        report(Drive(arguments.root, name, arguments.frames), arguments.mono)


if __name__ == "__main__":
    run_script(main)
