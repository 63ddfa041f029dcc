"""Finds the files of a KITTI odometry sequence, however the archives were unpacked.

`<root>/[dataset/]sequences/XX/{image_0, image_1, image_2, image_3, calib.txt, times.txt}` and `poses/XX.txt`
beside `sequences`. Cameras 0 and 1 are the grey pair, 2 and 3 the colour pair; numbering and layout: KITTI
odometry devkit.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slam.errors import DataError

# KITTI's numbers of the left and right cameras. The grey pair is preferred because it needs no conversion.
_PAIRS = ((0, 1), (2, 3))


@dataclass(frozen=True)
class StereoFiles:
    """Paths of the images of a sequence.

    Attributes:
        cameras: KITTI's numbers of the left and right camera, (0, 1) grey or (2, 3) colour.
        left: N paths, in order.
        right: N paths with the same names, or None in a sequence with one camera.
    """

    cameras: tuple[int, int]
    left: tuple[Path, ...]
    right: tuple[Path, ...] | None


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


def find_images(sequence: Path) -> StereoFiles:
    """Find the images of a sequence: the grey pair, else the colour pair, else the left images of either.

    Raises:
        DataError: there are no images, their numbering has gaps, or left and right numbers differ.
    """
    present = [pair for pair in _PAIRS if (sequence / f"image_{pair[0]}").is_dir()]
    present.sort(key=lambda pair: not (sequence / f"image_{pair[1]}").is_dir())  # a pair before a single camera
    if present:
        left, right = (sequence / f"image_{camera}" for camera in present[0])
        return _stereo_files(present[0], left, right)
    raise DataError(f"{sequence}: expected the folder image_0 or image_2, found neither; unpack the images there")


def _stereo_files(cameras: tuple[int, int], left: Path, right: Path) -> StereoFiles:
    left_files = _numbered_images(left)
    if not right.is_dir():
        return StereoFiles(cameras, left_files, None)
    right_files = _numbered_images(right)
    if len(right_files) != len(left_files):
        raise DataError(
            f"{right}: expected {len(left_files)} images as in {left.name}, found {len(right_files)};"
            " copy the missing ones or remove the folder to use one camera"
        )
    for one, other in zip(left_files, right_files, strict=True):
        if int(one.stem) != int(other.stem):
            raise DataError(f"{right}: expected {one.name} as in {left.name}, found {other.name}; unpack both again")
    return StereoFiles(cameras, left_files, right_files)


def _numbered_images(folder: Path) -> tuple[Path, ...]:
    files = [file for file in folder.glob("*.png") if not file.name.startswith(".")]
    if not files:
        raise DataError(f"{folder}: expected images 000000.png, 000001.png, ..., found none; unpack the images there")
    for file in sorted(files):
        if not file.stem.isdecimal():
            raise DataError(f"{file}: expected a name like 000000.png; rename or remove this image")
    files.sort(key=lambda file: int(file.stem))
    steps = np.diff([int(file.stem) for file in files])
    if (steps != 1).any():
        at = int(np.argmax(steps != 1))
        raise DataError(
            f"{folder}: expected images without gaps in their numbers, found {files[at + 1].name} after"
            f" {files[at].name}; copy the missing images or renumber"
        )
    return tuple(files)


def _sequences(root: Path) -> dict[str, Path]:
    for folder in (root / "sequences", root / "dataset" / "sequences"):
        if folder.is_dir():
            return {item.name: item for item in sorted(folder.iterdir()) if item.is_dir()}
    return {item.name: item for item in sorted(root.iterdir()) if item.is_dir() and _has_images(item)}


def _has_images(folder: Path) -> bool:
    return any((folder / f"image_{left}").is_dir() for left, _ in _PAIRS)
