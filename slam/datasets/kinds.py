"""The layouts of recordings that can be read, and how each is told from the others."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from slam.datasets.bag import left_of_bag, open_bag
from slam.datasets.bag_file import is_bag
from slam.datasets.city_centre import open_city_centre
from slam.datasets.dataset import Dataset
from slam.datasets.euroc import is_euroc, left_of_euroc, open_euroc
from slam.datasets.folders import holds_drives, subfolders
from slam.datasets.images import ImageSequence, open_images
from slam.datasets.kitti import open_kitti
from slam.datasets.kitti_files import sequence_names
from slam.datasets.left_images import ImageRecording
from slam.datasets.malaga import open_malaga
from slam.datasets.new_college import open_new_college
from slam.datasets.own_camera import is_described, is_own_camera, left_of_own_camera, open_own_camera
from slam.datasets.source import Source
from slam.datasets.tum_rgbd import is_tum_rgbd, left_of_tum_rgbd, open_tum_rgbd
from slam.errors import ConfigError, DataError

_CITY_CENTRE_IMAGES = 2474


@dataclass(frozen=True)
class Kind:
    """A layout.

    Attributes:
        recognises: whether a path is of this kind.
        drive: opens it for the whole chain, and checks everything but the images themselves.
        images: opens what the left camera saw, for place recognition.
    """

    recognises: Callable[[Path], bool]
    drive: Callable[[Source], Dataset]
    images: Callable[[Source], ImageRecording]


def _for_places(recognises: Callable[[Path], bool], images: Callable[[Path], ImageSequence]) -> Kind:
    """A recording that the chapter recognises places in, and nothing else."""

    def refuse(source: Source) -> Dataset:
        raise DataError(
            f"{source.path}: expected a calibration, found images of places alone; use it with revisit places"
        )

    return Kind(recognises, refuse, lambda source: images(source.path))


def _named(pattern: str, count: int = 1) -> Callable[[Path], bool]:
    """Whether a folder, or one at most two below it, holds at least so many files whose whole name matches."""
    name = re.compile(pattern, re.IGNORECASE)

    def recognises(root: Path) -> bool:
        below = subfolders(root)
        folders = [root, *below, *(inner for folder in below for inner in subfolders(folder))] if root.is_dir() else []
        return any(len(list(islice(_matching(folder, name), count))) == count for folder in folders)

    return recognises


def _matching(folder: Path, name: re.Pattern[str]) -> Iterator[Path]:
    return (item for item in folder.iterdir() if name.fullmatch(item.name))


def _is_kitti(root: Path) -> bool:
    folders = (root, root / "sequences", root / "dataset" / "sequences")
    return any((f / "image_0").is_dir() or (f / "image_2").is_dir() for f in folders) or bool(sequence_names(root))


# In this order: what says most about itself comes first, and a folder of images last.
KINDS = {
    "bag": Kind(is_bag, open_bag, left_of_bag),
    "euroc": Kind(lambda root: holds_drives(root, is_euroc), open_euroc, left_of_euroc),
    "tum-rgbd": Kind(lambda root: holds_drives(root, is_tum_rgbd), open_tum_rgbd, left_of_tum_rgbd),
    "own-camera": Kind(is_described, open_own_camera, left_of_own_camera),
    "kitti": Kind(
        _is_kitti,
        lambda source: open_kitti(source.path, source.sequence),
        lambda source: open_images(source.path, source.sequence, source.fps),
    ),
    "malaga": _for_places(_named(r"CAMERA1_[\d.]+_left\.(jpg|png)"), open_malaga),
    "new-college": _for_places(_named(r"StereoImages__[\d.]+-left\.(pnm|ppm|pgm|png|jpg)"), open_new_college),
    "city-centre": _for_places(_named(r"\d{4}\.jpg", _CITY_CENTRE_IMAGES), open_city_centre),
    "images": Kind(is_own_camera, open_own_camera, left_of_own_camera),
}


def kind_of(source: Source) -> str:
    """Name of the layout that was named, else of the first one that recognises the source.

    Raises:
        ConfigError: the named one does not exist.
        DataError: nothing recognises it.
    """
    if source.kind is not None:
        if source.kind not in KINDS:
            raise ConfigError(f"--format: expected one of {', '.join(KINDS)}, found {source.kind!r}")
        return source.kind
    if not source.path.exists():
        raise DataError(f"{source.path}: expected a recording, found nothing; check the path")
    found = next((name for name, kind in KINDS.items() if kind.recognises(source.path)), None)
    if found is None:
        raise DataError(
            f"{source.path}: expected images or a folder in KITTI layout, found neither, nor a recording of another"
            f" kind ({', '.join(KINDS)}); check the path"
        )
    return found
