"""Finds the images of published place-recognition datasets by their names, anywhere below a folder."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.datasets.images import natural_sort_key
from slam.errors import DataError


def find_named_images(root: Path, pattern: str, example: str, origin: str) -> tuple[Path, ...]:
    """Files below `root` whose whole name matches a pattern, in natural order of the names.

    Args:
        root: folder into which the dataset was unpacked.
        pattern: regular expression of a file name, matched without regard to case.
        example: a matching name, for the error message.
        origin: address from which the dataset can be downloaded, for the error message.

    Raises:
        DataError: no file matches, or two files have the same name (two datasets, or one unpacked twice).
    """
    name = re.compile(pattern, re.IGNORECASE)
    found = [path for path in root.rglob("*") if name.fullmatch(path.name) and path.is_file()]
    if not found:
        raise DataError(f"{root}: expected images such as {example}, found none; get them from {origin}")
    names = {path.name for path in found}
    if len(names) < len(found):
        raise DataError(
            f"{root}: expected each image once, found {len(found)} files of {len(names)} names; keep one set"
        )
    return tuple(sorted(found, key=lambda path: natural_sort_key(Path(path.name))))


def parse_times(files: Sequence[Path], fps: float) -> NDArray[np.float64]:
    """Times (N,) of images from their file names, seconds; at a fixed rate if the names have no increasing times.

    Args:
        files: N paths.
        fps: images per second of the fixed rate.
    """
    numbers = [re.search(r"\d+\.\d+", file.stem) for file in files]
    times = np.array([float(number.group()) if number else np.nan for number in numbers])
    return times if (np.diff(times) > 0).all() and np.isfinite(times).all() else np.arange(len(files)) / fps
