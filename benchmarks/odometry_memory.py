"""Memory of the stereo odometry over a long drive, which its window bounds.

    python benchmarks/odometry_memory.py ROOT 05 [--frames 10000] [--shrink 3]

The images are shown forwards and backwards until the number of frames is reached, with a black image now and then.
"state" is the pickled size of everything that the odometry holds, "process" the resident memory of the whole process.
Smaller images are tracked faster: `--shrink 3` takes a few minutes.
"""

import argparse
import pickle
from pathlib import Path

import cv2
import numpy as np
from command_line import existing, run_script
from odometry_drives import Array, Drive, Pair

from odometry import StereoCamera, StereoOdometry

_FAULT_EVERY = 97  # frames between two black images


def resident_mb() -> float:
    """Resident memory of this process, megabytes (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def frame(pairs: list[Pair], k: int) -> Pair:
    """Return the k-th pair of a drive that runs forwards and backwards."""
    if k % _FAULT_EVERY == _FAULT_EVERY - 1:
        return np.zeros_like(pairs[0][0]), np.zeros_like(pairs[0][1])
    turn = 2 * len(pairs) - 2
    return pairs[min(k % turn, turn - k % turn)]


def smaller(image: Array, factor: int) -> Array:
    """Average blocks of pixels."""
    height, width = image.shape
    return cv2.resize(image, (width // factor, height // factor), interpolation=cv2.INTER_AREA)


def camera_of(drive: Drive, factor: int) -> StereoCamera:
    """Return the camera of images shrunk by a factor."""
    c = drive.camera()
    centre = ((c.cx + 0.5) / factor - 0.5, (c.cy + 0.5) / factor - 0.5)
    return StereoCamera(c.fx / factor, c.fy / factor, *centre, c.baseline, c.width // factor, c.height // factor)


def main() -> None:
    """Parse the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", type=existing)
    parser.add_argument("sequence")
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--shrink", type=int, default=1, help="divide the size of the images by this")
    arguments = parser.parse_args()
    drive = Drive(arguments.root, arguments.sequence)
    pairs = [tuple(smaller(image, arguments.shrink) for image in pair) for pair in drive.pairs()]
    odometry = StereoOdometry(camera_of(drive, arguments.shrink))
    print(" frames  state MB  process MB")
    for k in range(arguments.frames):
        odometry.track(*frame(pairs, k))
        if (k + 1) % 1000 == 0:
            state = len(pickle.dumps(odometry)) / 1e6
            print(f"{k + 1:7d}  {state:8.2f}  {resident_mb():10.1f}", flush=True)


if __name__ == "__main__":
    run_script(main)
