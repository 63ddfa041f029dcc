"""The one door to recordings."""

from pathlib import Path

from slam.datasets.dataset import Dataset
from slam.datasets.kinds import KINDS, kind_of
from slam.datasets.left_images import ImageRecording
from slam.datasets.source import Source


def open_drive(source: Path | str, sequence: str | None = None) -> Dataset:
    """Open a recorded drive of whatever kind.

    Args:
        source: folder or file.
        sequence: name of one of several drives below the folder ("00"); None where there is only one.

    Raises:
        DataError: the drive is missing, damaged or inconsistent.
    """
    return open_source(Source(Path(source), sequence))


def open_source(source: Source) -> Dataset:
    """Open a recorded drive; a new layout is a new file in this folder and a line in `KINDS`.

    Raises:
        DataError: the drive is missing, damaged or inconsistent, or has no calibration.
        ConfigError: a kind that does not exist.
    """
    return KINDS[kind_of(source)].drive(source)


def open_left_images(source: Source) -> ImageRecording:
    """Open what the left camera of a recording saw. A calibration is used where there is one, and not needed.

    Raises:
        DataError: there are no images, or they are damaged or inconsistent.
        ConfigError: a kind that does not exist.
    """
    return KINDS[kind_of(source)].images(source)
