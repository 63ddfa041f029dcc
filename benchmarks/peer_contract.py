"""The command line of the programs that `peers.py` runs, for those that are written in Python.

It imports NumPy and OpenCV alone: ORB-SLAM3 runs in an environment without Revisit, and the memory of a small program
must be its own. A program is called as

    PROGRAM LEFT RIGHT CALIB TIMES OUT

* LEFT and RIGHT: folders with the images of a rectified pair, of equal names in the order of the drive.
* CALIB: KITTI's calib.txt with the lines `P0:` and `P1:`, 12 numbers each.
* TIMES: seconds of each pair, one a line.
* OUT: an empty folder, into which it writes `odometry.txt`: T_first_camera of each pair before loop closing, in KITTI's
  format, 12 numbers a line, the upper three rows of the matrix. It may write more: `corrected.txt`, the same after loop
  closing; `loops.csv`, a table with the columns `query` and `match`, indices of the images of each closed loop;
  `milliseconds.txt`, the wall-clock time of each frame; `remark.txt`, a line that the reader of the table must know.

Every pair has its line, whether or not it was tracked. Exit code 0 means success.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]


@dataclass(frozen=True)
class StereoDrive:
    """The input and the output folder of a program.

    Attributes:
        left, right: folders of images.
        calibration, times: files.
        out: folder for the results.
    """

    left: Path
    right: Path
    calibration: Path
    times: Path
    out: Path

    def read_projections(self) -> tuple[Array, Array]:
        """Read the projection matrices (3, 4) of the left and the right camera, pixels and pixels times metres."""
        lines = dict(line.split(":") for line in self.calibration.read_text().splitlines() if ":" in line)
        P_left, P_right = (np.array(lines[name].split(), np.float64).reshape(3, 4) for name in ("P0", "P1"))
        return P_left, P_right

    def read_times(self) -> Array:
        """Read the seconds (N,) of the pairs."""
        return np.loadtxt(self.times, ndmin=1)

    def read_pairs(self) -> Iterator[tuple[Image, Image]]:
        """Read the grey images, pair by pair, in the order of their names."""
        for file in sorted(self.left.iterdir()):
            left, right = (cv2.imread(str(side / file.name), cv2.IMREAD_GRAYSCALE) for side in (self.left, self.right))
            yield left, right

    def write_poses(self, name: str, poses: Sequence[Array]) -> None:
        """Write T_first_camera, N matrices (4, 4), metres, into a file of the output folder."""
        np.savetxt(self.out / name, np.array(poses)[:, :3].reshape(len(poses), 12), fmt="%.9g")


def make_parser(description: str | None) -> argparse.ArgumentParser:
    """Make a parser of the five arguments."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("left", "right", "calibration", "times", "out"):
        parser.add_argument(name, type=Path)
    return parser


def take_drive(given: argparse.Namespace) -> StereoDrive:
    """Return the five arguments of a parsed command line."""
    return StereoDrive(given.left, given.right, given.calibration, given.times, given.out)
