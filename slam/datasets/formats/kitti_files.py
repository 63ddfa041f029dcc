"""Finds the files of a KITTI odometry sequence, however the archives were unpacked.

`<root>/[dataset/]sequences/XX/{image_0, image_1, image_2, image_3, calib.txt, times.txt}` and `poses/XX.txt`
beside `sequences`. Cameras 0 and 1 are the grey pair, 2 and 3 the colour pair; numbering and layout: KITTI
odometry devkit.
"""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.datasets.formats.image_sequence import IMAGE_SUFFIXES, list_images
from slam.errors import DataError
from slam.io.files import read_lines

# KITTI's numbers of the left and right cameras. The grey pair is preferred because it needs no conversion.
_PAIRS = ((0, 1), (2, 3))


@dataclass(frozen=True)
class StereoFiles:
    """Paths of the images of a sequence.

    Attributes:
        cameras: KITTI's numbers of the left and right camera, (0, 1) grey or (2, 3) colour.
        left: N paths, in order.
        right: N paths with the same numbers, or None in a sequence with one camera.
    """

    cameras: tuple[int, int]
    left: tuple[Path, ...]
    right: tuple[Path, ...] | None


def is_kitti(root: Path) -> bool:
    """Whether a folder is in this layout, or the folder of one sequence."""
    folders = (root, root / "sequences", root / "dataset" / "sequences")
    return any(_has_images(folder) for folder in folders) or bool(sequence_names(root))


def find_sequence(root: Path, sequence: str | None) -> Path:
    """Return the folder of one sequence.

    Args:
        root: folder that contains `sequences`, its parent, `sequences` itself, or the folder of one sequence.
        sequence: name of the sequence ("00"); None where there is only one.

    Raises:
        DataError: the folder or the sequence does not exist, or there are several sequences and none was named.
    """
    if not root.is_dir():
        found = "a file" if root.exists() else "nothing"
        raise DataError(f"{root}: expected a folder in KITTI odometry layout, found {found}; check the path")
    if _has_images(root) and sequence in (None, root.absolute().name):
        return root
    return _choose(root, _sequences(root), sequence)


def _choose(root: Path, folders: dict[str, Path], sequence: str | None) -> Path:
    names = ", ".join(folders)
    if not folders:
        raise DataError(f"{root}: expected sequences/XX/image_0/000000.png, found none; name the folder above it")
    if sequence is None and len(folders) > 1:
        raise DataError(f"{root}: expected one sequence, found {names}; choose one with --sequence")
    name = next(iter(folders)) if sequence is None else sequence
    if name not in folders:
        raise DataError(f"{root}: expected sequence {name}, found {names}; choose one with --sequence")
    return folders[name]


def sequence_names(root: Path) -> tuple[str, ...]:
    """Names of all sequences below a folder in KITTI layout; empty if it has none."""
    return tuple(_sequences(root)) if root.is_dir() else ()


def find_poses(sequence: Path) -> Path | None:
    """File of the ground-truth poses of the sequence in a folder; None where there is none."""
    here = sequence.absolute()
    name = f"{here.name}.txt"
    places = [here.parent.parent / "poses" / name, here.parent / "poses" / name, here / "poses.txt"]
    return next((path for path in places if path.is_file()), None)


def find_images(sequence: Path, left_only: bool = False) -> StereoFiles:
    """Find the images of a sequence: the grey pair, else the colour pair, else the left images of either.

    Args:
        sequence: folder of the sequence.
        left_only: whether right images are not looked at.

    Raises:
        DataError: there are no images, their numbering has gaps, or left and right numbers differ.
    """
    present = [pair for pair in _PAIRS if (sequence / f"image_{pair[0]}").is_dir()]
    present.sort(key=lambda pair: not (sequence / f"image_{pair[1]}").is_dir())  # a pair before a single camera
    if not present:
        raise DataError(f"{sequence}: expected the folder image_0 or image_2, found neither; unpack the images there")
    left, right = (sequence / f"image_{camera}" for camera in present[0])
    left_files = _consecutive_images(left)
    if left_only or not right.is_dir():
        return StereoFiles(present[0], left_files, None)
    right_files = _consecutive_images(right)
    _check_partners(left_files, right_files)
    return StereoFiles(present[0], left_files, right_files)


def _check_partners(left: tuple[Path, ...], right: tuple[Path, ...]) -> None:
    left_folder, right_folder = left[0].parent, right[0].parent
    if len(right) != len(left):
        raise DataError(
            f"{right_folder}: expected {len(left)} images as in {left_folder.name}, found {len(right)};"
            " copy the missing ones, or use the left camera alone with --mono"
        )
    for one, other in zip(left, right, strict=True):
        if int(one.stem) != int(other.stem):
            raise DataError(
                f"{right_folder}: expected {one.name} as in {left_folder.name}, found {other.name}; unpack both again"
            )


def numbered_images(folder: Path) -> tuple[Path, ...]:
    """Images of a folder whose names are numbers, in their order.

    Raises:
        DataError: there are none, a name is no number, or a number occurs twice.
    """
    files = list_images(folder)
    if not files:
        raise DataError(
            f"{folder}: expected images 000000.png, 000001.png, ... (or {', '.join(sorted(IMAGE_SUFFIXES))}), found"
            " none; unpack the images there"
        )
    for file in sorted(files):
        if not file.stem.isdecimal():
            raise DataError(f"{file}: expected a name like 000000.png; rename or remove this image")
    by_number = sorted(files, key=lambda file: int(file.stem))
    for one, other in pairwise(by_number):
        if int(one.stem) == int(other.stem):
            raise DataError(f"{folder}: expected each number once, found {one.name} and {other.name}; remove one set")
    return tuple(by_number)


def _consecutive_images(folder: Path) -> tuple[Path, ...]:
    files = numbered_images(folder)
    steps = np.diff([int(file.stem) for file in files])
    if (steps != 1).any():
        at = int(np.argmax(steps != 1))
        raise DataError(
            f"{folder}: expected images without gaps in their numbers, found {files[at + 1].name} after"
            f" {files[at].name}; copy the missing images or renumber"
        )
    return files


def read_calibration_lines(path: Path) -> dict[str, NDArray[np.float64]]:
    """Read the lines 'NAME: numbers' of a calibration file of KITTI; lines with words or nothing are passed over.

    Raises:
        DataError: the file is missing, or a line has no name.
    """
    found = {}
    lines = [(number, line) for number, line in enumerate(read_lines(path), start=1) if line.strip()]
    if not lines:
        raise DataError(f"{path}: expected only lines such as 'P0: 12 numbers', found none; copy the calibration again")
    for number, line in lines:
        name, colon, words = line.partition(":")
        if not colon:
            raise DataError(
                f"{path}, line {number}: expected only lines such as 'P0: 12 numbers', found {line.strip()[:40]!r};"
                " remove the line"
            )
        try:
            found[name.strip()] = np.array(words.split(), np.float64)
        except ValueError:
            continue  # such as the time of the calibration
    return found


def _sequences(root: Path) -> dict[str, Path]:
    for folder in (root / "sequences", root / "dataset" / "sequences"):
        if folder.is_dir():
            return {item.name: item for item in sorted(folder.iterdir()) if item.is_dir()}
    return {item.name: item for item in sorted(root.iterdir()) if item.is_dir() and _has_images(item)}


def _has_images(folder: Path) -> bool:
    return any((folder / f"image_{left}").is_dir() for left, _ in _PAIRS)
