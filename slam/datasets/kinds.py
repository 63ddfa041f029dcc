"""The registry of dataset formats, and the detection of a dataset's format from its files.

A new format is a file in this folder and a line in `FORMATS`: see docs/add_a_dataset.md. Why a format is detected
by its files: docs/decisions/datasets_by_content.md.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from slam.datasets.bag import open_bag, open_bag_images
from slam.datasets.bag_file import is_bag
from slam.datasets.city_centre import open_city_centre
from slam.datasets.dataset import Dataset
from slam.datasets.euroc import is_euroc, open_euroc, open_euroc_images
from slam.datasets.folders import contains_dataset, subfolders
from slam.datasets.images import ImageSequence, open_image_sequence
from slam.datasets.kitti import open_kitti
from slam.datasets.kitti_files import sequence_names
from slam.datasets.left_images import ImageDataset
from slam.datasets.malaga import open_malaga
from slam.datasets.new_college import open_new_college
from slam.datasets.own_camera import has_camera_toml, is_custom_camera, open_custom_camera, open_custom_camera_images
from slam.datasets.source import DatasetSpec
from slam.datasets.tum_rgbd import is_tum_rgbd, open_tum_rgbd, open_tum_rgbd_images
from slam.errors import ConfigError, DataError

_CITY_CENTRE_IMAGES = 2474  # fewer numbered .jpg files may be anybody's


@dataclass(frozen=True)
class DatasetFormat:
    """How datasets of one format are detected and opened.

    Attributes:
        matches: whether a path holds a dataset of this format.
        open_dataset: opens it for SLAM; checks all files but the images themselves.
        open_images: opens the left camera's images for place recognition; needs no calibration.
    """

    matches: Callable[[Path], bool]
    open_dataset: Callable[[DatasetSpec], Dataset]
    open_images: Callable[[DatasetSpec], ImageDataset]


def _images_only(matches: Callable[[Path], bool], open_images: Callable[[Path], ImageSequence]) -> DatasetFormat:
    """Return a format without calibration, which serves place recognition alone."""

    def refuse(spec: DatasetSpec) -> Dataset:
        raise DataError(
            f"{spec.path}: expected a calibration, found images of places alone; use it with revisit places"
        )

    return DatasetFormat(matches, refuse, lambda spec: open_images(spec.path))


def _has_files(pattern: str, min_count: int = 1) -> Callable[[Path], bool]:
    """Return a test whether a folder, or one up to two levels below it, has `min_count` files of matching names."""
    name = re.compile(pattern, re.IGNORECASE)

    def matches(root: Path) -> bool:
        if not root.is_dir():
            return False
        below = subfolders(root)
        folders = [root, *below, *(inner for folder in below for inner in subfolders(folder))]
        return any(_count_up_to(folder, name, min_count) == min_count for folder in folders)

    return matches


def _count_up_to(folder: Path, name: re.Pattern[str], limit: int) -> int:
    # Matching stops at the limit: a folder may hold a hundred thousand images.
    matching = (item for item in folder.iterdir() if name.fullmatch(item.name))
    return len(list(islice(matching, limit)))


def _is_kitti(root: Path) -> bool:
    folders = (root, root / "sequences", root / "dataset" / "sequences")
    return any((f / "image_0").is_dir() or (f / "image_2").is_dir() for f in folders) or bool(sequence_names(root))


# The order matters: formats with the most distinctive files come first, a bare folder of images comes last.
FORMATS = {
    "bag": DatasetFormat(is_bag, open_bag, open_bag_images),
    "euroc": DatasetFormat(lambda root: contains_dataset(root, is_euroc), open_euroc, open_euroc_images),
    "tum-rgbd": DatasetFormat(lambda root: contains_dataset(root, is_tum_rgbd), open_tum_rgbd, open_tum_rgbd_images),
    "own-camera": DatasetFormat(has_camera_toml, open_custom_camera, open_custom_camera_images),
    "kitti": DatasetFormat(
        _is_kitti,
        lambda spec: open_kitti(spec.path, spec.sequence),
        lambda spec: open_image_sequence(spec.path, spec.sequence, spec.fps),
    ),
    "malaga": _images_only(_has_files(r"CAMERA1_[\d.]+_left\.(jpg|png)"), open_malaga),
    "new-college": _images_only(_has_files(r"StereoImages__[\d.]+-left\.(pnm|ppm|pgm|png|jpg)"), open_new_college),
    "city-centre": _images_only(_has_files(r"\d{4}\.jpg", _CITY_CENTRE_IMAGES), open_city_centre),
    "images": DatasetFormat(is_custom_camera, open_custom_camera, open_custom_camera_images),
}


def detect_format(spec: DatasetSpec) -> str:
    """Return the name of the requested format, or of the first format that matches the path.

    Raises:
        ConfigError: the requested format does not exist.
        DataError: no format matches.
    """
    if spec.format is not None:
        if spec.format not in FORMATS:
            raise ConfigError(f"--format: expected one of {', '.join(FORMATS)}, found {spec.format!r}")
        return spec.format
    if not spec.path.exists():
        raise DataError(f"{spec.path}: expected a recording, found nothing; check the path")
    found = next((name for name, candidate in FORMATS.items() if candidate.matches(spec.path)), None)
    if found is None:
        raise DataError(
            f"{spec.path}: expected images or a folder in KITTI layout, found neither, nor a recording of another"
            f" format ({', '.join(FORMATS)}); check the path"
        )
    return found
