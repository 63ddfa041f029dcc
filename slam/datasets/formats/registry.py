"""Dataset formats: their registry, and the detection of a dataset's format from its files.

A new format is a file in this folder and a line in `FORMATS`: see docs/add_a_dataset.md. Why a format is detected
by its files: docs/decisions/datasets_by_content.md.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from slam.datasets.dataset import Dataset, DatasetSpec, contains_dataset, subfolders
from slam.datasets.formats.custom_camera import (
    describe_contents,
    describe_known_layout,
    has_camera_toml,
    is_custom_camera,
    open_custom_camera,
    open_custom_camera_images,
)
from slam.datasets.formats.depth_images import DEPTH_UNUSED
from slam.datasets.formats.euroc import is_euroc, open_euroc, open_euroc_images
from slam.datasets.formats.image_sequence import ImageSequence
from slam.datasets.formats.kitti import open_image_sequence, open_kitti
from slam.datasets.formats.kitti_files import is_kitti
from slam.datasets.formats.kitti_raw import is_kitti_raw, open_kitti_raw, open_kitti_raw_images
from slam.datasets.formats.place_datasets import open_city_centre, open_malaga, open_new_college
from slam.datasets.formats.recording import LEFT_ALONE, ImageDataset, check_size
from slam.datasets.formats.rosbag_dataset import open_bag, open_bag_images
from slam.datasets.formats.rosbag_file import is_bag
from slam.datasets.formats.tum_rgbd import is_tum_rgbd, open_tum_rgbd, open_tum_rgbd_images
from slam.errors import ConfigError, DataError

_REMEDY = "check the path; other images must be converted to png, other videos to mp4"
_CITY_CENTRE_IMAGES = 2474  # fewer .jpg files with numbers may be any recording


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
    """Return a format without calibration, for place recognition only."""

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


# The order matters: formats with the most distinctive files come first, a bare folder of images comes last.
FORMATS = {
    "bag": DatasetFormat(is_bag, open_bag, open_bag_images),
    "euroc": DatasetFormat(lambda root: contains_dataset(root, is_euroc), open_euroc, open_euroc_images),
    "tum-rgbd": DatasetFormat(lambda root: contains_dataset(root, is_tum_rgbd), open_tum_rgbd, open_tum_rgbd_images),
    "own-camera": DatasetFormat(has_camera_toml, open_custom_camera, open_custom_camera_images),
    "kitti": DatasetFormat(
        is_kitti,
        lambda spec: open_kitti(spec.path, spec.sequence, spec.left_only),
        lambda spec: open_image_sequence(spec.path, spec.sequence, spec.fps),
    ),
    "kitti-raw": DatasetFormat(is_kitti_raw, open_kitti_raw, open_kitti_raw_images),
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
        contents = describe_contents(spec.path) if spec.path.is_dir() else "a file"
        raise DataError(
            f"{spec.path}: expected images or a folder in KITTI layout, found neither, nor a recording of another"
            f" format ({', '.join(FORMATS)}), but {contents}; {describe_known_layout(spec.path) or _REMEDY}"
        )
    return found


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


def open_for_odometry(spec: DatasetSpec, mono: bool) -> Dataset:
    """Open a calibrated dataset for odometry with two cameras, a depth camera or one camera.

    Raises:
        DataError: as `open_dataset`, or there are neither right images nor depth and one of them is needed.
        ConfigError: the format does not exist.
    """
    dataset = open_dataset(replace(spec, left_only=mono))
    if not dataset.has_right and not dataset.has_depth and not mono:
        reasons = "".join(
            f" ({remark})" for remark in dataset.remarks if LEFT_ALONE in remark or DEPTH_UNUSED in remark
        )
        found = f"found left ones only{reasons}"
        raise DataError(
            f"{spec.path}: expected left and right images, {found}; use one camera with --mono, or add the right images"
            " or a depth image for each left one"
        )
    return dataset


def open_images(spec: DatasetSpec) -> ImageDataset:
    """Open the left camera's images of a dataset, whatever is wrong with the right camera.

    They are undistorted if there is a calibration; none is needed.

    Raises:
        DataError: the images are missing, damaged, inconsistent or too small.
        ConfigError: the format does not exist.
    """
    images = FORMATS[detect_format(spec)].open_images(replace(spec, left_only=True))
    height, width = images[0].shape
    check_size(str(spec.path), (width, height))
    return images
