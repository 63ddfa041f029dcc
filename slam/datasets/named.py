"""Images that are known by their names, wherever below a folder they were unpacked."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.datasets.images import natural
from slam.errors import DataError


def images_named(root: Path, pattern: str, example: str, origin: str) -> tuple[Path, ...]:
    """Files below `root` whose whole name matches, in the natural order of the names.

    Args:
        root: where somebody unpacked the recording.
        pattern: regular expression of a name, whatever its case.
        example: such a name, for the message.
        origin: where the recording is to be had, for the message.

    Raises:
        DataError: there is none, or the same name twice: two recordings, or one unpacked twice.
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
    return tuple(sorted(found, key=lambda path: natural(Path(path.name))))


def times_in_names(files: Sequence[Path], rate: float) -> NDArray[np.float64]:
    """Times (N,) of images, seconds, that stand in their names; where these do not increase, equal steps at a rate.

    Args:
        files: N paths.
        rate: images a second.
    """
    numbers = [re.search(r"\d+\.\d+", file.stem) for file in files]
    times = np.array([float(number.group()) if number else np.nan for number in numbers])
    return times if (np.diff(times) > 0).all() and np.isfinite(times).all() else np.arange(len(files)) / rate
