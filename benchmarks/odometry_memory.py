"""Memory of the stereo odometry over a long drive: what it holds is bounded by its window.

    python benchmarks/odometry_memory.py ROOT 05 [--frames 10000]

The drive is driven forth and back until so many frames have been seen, with a fault now and then. "state" is
the size of everything the odometry holds, pickled; "process" the resident memory of the whole process.
"""

import argparse
import pickle
from pathlib import Path

import numpy as np
from odometry_drives import Drive, Pair

from odometry import StereoOdometry

_FAULT_EVERY = 97  # frames between two black images


def resident_mb() -> float:
    """Resident memory of this process, megabytes (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def frame(pairs: list[Pair], k: int) -> Pair:
    """Choose the k-th pair of a drive forth and back."""
    if k % _FAULT_EVERY == _FAULT_EVERY - 1:
        return np.zeros_like(pairs[0][0]), np.zeros_like(pairs[0][1])
    turn = 2 * len(pairs) - 2
    return pairs[min(k % turn, turn - k % turn)]


def main() -> None:
    """Parse the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("root", type=Path)
    parser.add_argument("sequence")
    parser.add_argument("--frames", type=int, default=10_000)
    arguments = parser.parse_args()
    drive = Drive(arguments.root, arguments.sequence)
    pairs, odometry = list(drive.pairs()), StereoOdometry(drive.camera())
    print(" frames  state MB  process MB")
    for k in range(arguments.frames):
        odometry.track(*frame(pairs, k))
        if (k + 1) % 1000 == 0:
            state = len(pickle.dumps(odometry)) / 1e6
            print(f"{k + 1:7d}  {state:8.2f}  {resident_mb():10.1f}", flush=True)


if __name__ == "__main__":
    main()
