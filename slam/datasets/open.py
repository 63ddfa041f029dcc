"""Opens a dataset, whatever its format."""

from pathlib import Path

from slam.datasets.dataset import Dataset
from slam.datasets.kinds import FORMATS, detect_format
from slam.datasets.left_images import ImageDataset
from slam.datasets.source import DatasetSpec


def open_dataset(source: DatasetSpec | Path | str, sequence: str | None = None) -> Dataset:
    """Open a calibrated dataset of any format in `FORMATS`.

    Args:
        source: folder, file, or a full specification.
        sequence: name of one of several sequences below the folder ("00"); None where there is only one.

    Raises:
        DataError: the dataset is missing, damaged or inconsistent, or it has no calibration.
        ConfigError: the format does not exist.
    """
    spec = source if isinstance(source, DatasetSpec) else DatasetSpec(Path(source), sequence)
    return FORMATS[detect_format(spec)].open_dataset(spec)


def open_images(spec: DatasetSpec) -> ImageDataset:
    """Open the left camera's images of a dataset. They are undistorted if there is a calibration; none is needed.

    Raises:
        DataError: the images are missing, damaged or inconsistent.
        ConfigError: the format does not exist.
    """
    return FORMATS[detect_format(spec)].open_images(spec)
