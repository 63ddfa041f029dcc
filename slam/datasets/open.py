"""The one door to recorded drives."""

from pathlib import Path

from slam.datasets.dataset import Dataset
from slam.datasets.kitti import open_kitti


def open_drive(source: Path, sequence: str | None = None) -> Dataset:
    """Open a recorded drive; a new format is a new file in this folder and a choice here.

    Args:
        source: folder in KITTI odometry layout, or the folder of one sequence.
        sequence: its name ("00"); None where there is only one.

    Raises:
        DataError: the drive is missing, damaged or inconsistent.
    """
    return open_kitti(source, sequence)
