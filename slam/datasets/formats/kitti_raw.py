"""Drives in the layouts of KITTI's raw data (Geiger et al., IJRR 2013) and of KITTI-360 (Liao et al., PAMI 2022).

    [DATE/]DATE_drive_XXXX_sync/image_00/{data/0000000000.png, timestamps.txt}      DATE/calib_cam_to_cam.txt
    data_2d_raw/DATE_drive_XXXX_sync/image_00/{data_rect/0000000000.png, timestamps.txt}   calibration/perspective.txt

Cameras 00 and 01 are the grey pair of KITTI and the only pair of KITTI-360, 02 and 03 the colour pair of KITTI. The
images are rectified and numbered; line n of `timestamps.txt` is the time of image n. OXTS and laser are not read.
"""

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.datasets.dataset import DatasetSpec, subfolders
from slam.datasets.formats.image_sequence import ImageSequence
from slam.datasets.formats.kitti import read_projections, stereo_camera
from slam.datasets.formats.kitti_files import numbered_images
from slam.datasets.formats.recording import (
    CameraStream,
    ImageDataset,
    LeftImages,
    RawRecording,
    RectifiedDataset,
    UncalibratedImages,
    build_dataset,
)
from slam.datasets.rectification import identity_rectification
from slam.errors import DataError
from slam.io.files import read_lines

Array = NDArray[np.float64]

_PAIRS = (("00", "01"), ("02", "03"))
_IMAGE_FOLDERS = ("data", "data_rect")
_CALIBRATIONS = ("calib_cam_to_cam.txt", "perspective.txt", "calibration/perspective.txt")
_RATE_HZ = 10.0  # of both recordings
_DEPTH = 2  # levels of folders from the root of KITTI-360, or a folder of several dates, to a drive


def is_kitti_raw(root: Path) -> bool:
    """Whether a folder is a drive in one of these layouts, or holds some."""
    return bool(_find_drives(root, _DEPTH))


def open_kitti_raw(spec: DatasetSpec) -> RectifiedDataset:
    """Open a drive and check all files but the images themselves.

    Raises:
        DataError: a file is missing, damaged or inconsistent with the others.
    """
    drive = _find_drive(spec)
    if drive.absolute().name.endswith("_extract"):
        raise DataError(f"{drive}: expected rectified images, found raw ones; download the drive as synced+rectified")
    pair = _choose_pair(drive)
    right = None if spec.left_only or not _image_folder(drive, pair[1]) else _numbered_stream(drive, pair[1], spec.fps)
    left = _numbered_stream(drive, pair[0], spec.fps)
    path = _find_calibration(drive)
    P_left, P_right = read_projections(path, [f"P_rect_{camera}" for camera in pair], right is not None)
    if right is None:
        recording = RawRecording(drive.absolute().name, left[1])
    else:
        recording = _pair_by_number(drive.absolute().name, left, right)
    return build_dataset(recording, lambda size: identity_rectification(stereo_camera(P_left, P_right, size)))


def open_kitti_raw_images(spec: DatasetSpec) -> ImageDataset:
    """Open the left images of a drive; no calibration is needed.

    Raises:
        DataError: there are no images, or their times do not fit them.
    """
    drive = _find_drive(spec)
    try:
        return LeftImages.of(open_kitti_raw(spec))
    except DataError:
        _, stream = _numbered_stream(drive, _choose_pair(drive)[0], spec.fps)
        return UncalibratedImages(drive.absolute().name, stream.images, stream.timestamps, remarks=stream.remarks)


def _find_drive(spec: DatasetSpec) -> Path:
    drives = {drive.absolute().name: drive for drive in _find_drives(spec.path, _DEPTH)}
    if not drives:
        raise DataError(f"{spec.path}: expected a drive with image_00/data/0000000000.png, found none; check the path")
    if spec.sequence is None and len(drives) > 1:
        raise DataError(f"{spec.path}: expected one drive, found {', '.join(drives)}; choose one with --sequence")
    name = spec.sequence or next(iter(drives))
    if name not in drives:
        raise DataError(f"{spec.path}: expected the drive {name}, found {', '.join(drives)}; choose with --sequence")
    return drives[name]


def _find_drives(root: Path, depth: int) -> list[Path]:
    if not root.is_dir():
        return []
    if any(_image_folder(root, left) for left, _ in _PAIRS):
        return [root]
    return [drive for folder in subfolders(root) for drive in _find_drives(folder, depth - 1)] if depth else []


def _image_folder(drive: Path, camera: str) -> Path | None:
    folders = (drive / f"image_{camera}" / name for name in _IMAGE_FOLDERS)
    return next((folder for folder in folders if folder.is_dir()), None)


def _choose_pair(drive: Path) -> tuple[str, str]:
    """The grey pair, else the colour pair, else the left camera of either."""
    present = [pair for pair in _PAIRS if _image_folder(drive, pair[0])]
    return next((pair for pair in present if _image_folder(drive, pair[1])), present[0])


def _find_calibration(drive: Path) -> Path:
    here = drive.absolute()
    places = [folder / name for folder in (here, *here.parents[:_DEPTH]) for name in _CALIBRATIONS]
    path = next((path for path in places if path.is_file()), None)
    if path is None:
        raise DataError(
            f"{drive}: expected calib_cam_to_cam.txt (KITTI) or calibration/perspective.txt (KITTI-360) in a folder"
            " above, found none; unpack the calibration of that date there"
        )
    return path


def _numbered_stream(drive: Path, camera: str, fps: float | None) -> tuple[list[int], CameraStream]:
    """Numbers of the images of a camera, and the images."""
    folder = _image_folder(drive, camera)
    assert folder is not None
    files = numbered_images(folder)
    numbers = [int(file.stem) for file in files]
    seconds, remarks = _times(folder.parent / "timestamps.txt", numbers, fps)
    return numbers, CameraStream(ImageSequence(folder.parent.name, files, None), seconds, remarks)


def _times(path: Path, numbers: list[int], fps: float | None) -> tuple[Array, tuple[str, ...]]:
    if not path.is_file():
        remark = f"{path.parent.name}: no timestamps.txt: {fps or _RATE_HZ:g} images a second are assumed"
        return np.array(numbers) / (fps or _RATE_HZ), () if fps else (remark,)
    lines = [line.strip() for line in read_lines(path)]
    if numbers[-1] >= len(lines):
        raise DataError(
            f"{path}: expected a time in line {numbers[-1] + 1}, for image {numbers[-1]}, found {len(lines)} lines;"
            " copy it again"
        )
    seconds = np.array([_seconds(path, number + 1, lines[number]) for number in numbers])
    if (np.diff(seconds) <= 0).any():
        at = int(np.argmax(np.diff(seconds) <= 0)) + 1
        raise DataError(
            f"{path}, line {numbers[at] + 1}: expected increasing times, found {lines[numbers[at]]}; correct the line,"
            " or remove the file: 10 images a second are then assumed"
        )
    return seconds, ()


def _seconds(path: Path, line: int, text: str) -> float:
    try:
        if not re.fullmatch(r"[-\d]+([ T][:.\d]+)?", text):  # NumPy takes words such as today, and warns of time zones
            raise ValueError(text)
        return float(np.datetime64(text.replace(" ", "T"), "ns").astype(np.int64)) / 1e9
    except ValueError:
        expected = "a time such as 2011-09-30 12:40:25.078650880"
        raise DataError(f"{path}, line {line}: expected {expected}, found {text[:40]!r}; copy it again") from None


def _pair_by_number(
    name: str, left: tuple[list[int], CameraStream], right: tuple[list[int], CameraStream]
) -> RawRecording:
    """Pair the images of equal numbers: they were triggered together, whatever their times say."""
    common, rows, right_rows = np.intersect1d(left[0], right[0], return_indices=True)
    if not len(common):
        raise DataError(
            f"{right[1].images.where(0)}: expected the numbers of the left images, found none of them; copy them again"
        )
    alone = len(left[0]) + len(right[0]) - 2 * len(common)
    remarks = (f"{alone} images without a partner in the other camera are left out",) if alone else ()
    first = left[1].subset(rows)
    second = CameraStream(right[1].subset(right_rows).images, first.timestamps)
    return RawRecording(name, first, second, remarks=remarks)
