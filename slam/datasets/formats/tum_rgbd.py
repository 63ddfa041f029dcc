"""Datasets in the layout of TUM RGB-D (Sturm et al., IROS 2012); the depth images are not read.

`[NAME/]{rgb.txt, rgb/<seconds>.png, groundtruth.txt}`. The layout does not include a calibration: it is read
from a `camera.toml` beside `rgb.txt`, or taken from the benchmark's cameras by the name of the sequence.
"""

import re
from pathlib import Path

from slam.datasets.camera_toml import CAMERA_TOML, CameraToml, read_camera_toml
from slam.datasets.dataset import DatasetSpec, find_dataset
from slam.datasets.distortion_models import CameraModel
from slam.datasets.formats.recording import (
    ImageDataset,
    LeftImages,
    RawRecording,
    RectifiedDataset,
    UncalibratedImages,
    build_dataset,
    read_ground_truth,
    read_stream,
)
from slam.datasets.formats.timestamped_lists import SPACE_SEPARATED_SECONDS
from slam.errors import DataError

# Colour cameras of the benchmark by the number in the sequence's name, from the benchmark's page "Intrinsic Camera
# Calibration of the Kinect".
FREIBURG = {
    "1": CameraModel(
        517.306, 516.469, 318.643, 255.314, "radtan", (0.262383, -0.953104, -0.005358, 0.002628, 1.163314)
    ),
    "2": CameraModel(
        520.909, 521.007, 325.141, 249.702, "radtan", (0.231222, -0.784899, -0.003257, -0.000105, 0.917205)
    ),
    "3": CameraModel(535.4, 539.2, 320.1, 247.6),
}


def is_tum_rgbd(folder: Path) -> bool:
    """Whether a folder is one sequence in this layout."""
    return (folder / "rgb.txt").is_file()


def open_tum_rgbd(spec: DatasetSpec) -> RectifiedDataset:
    """Open a sequence and check all files but the images themselves.

    Raises:
        DataError: a file is missing, damaged or inconsistent with the others.
    """
    folder = _folder(spec)
    camera = _camera(folder)
    if camera is None:
        raise DataError(
            f"{folder / CAMERA_TOML}: expected the calibration, as the folder's name has no freiburg1, 2 or 3, found"
            " none; write one with fx, fy, cx and cy"
        )
    left, poses = read_stream(folder / "rgb.txt", folder, SPACE_SEPARATED_SECONDS), folder / "groundtruth.txt"
    truth = read_ground_truth(poses, left) if poses.is_file() else None
    return build_dataset(RawRecording(folder.absolute().name, left, ground_truth=truth), camera.rectification)


def open_tum_rgbd_images(spec: DatasetSpec) -> ImageDataset:
    """Open the colour images; they are undistorted if the camera is known.

    Raises:
        DataError: a file is missing, damaged or inconsistent with the others.
    """
    folder = _folder(spec)
    if _camera(folder) is not None:
        return LeftImages.of(open_tum_rgbd(spec))
    stream = read_stream(folder / "rgb.txt", folder, SPACE_SEPARATED_SECONDS)
    return UncalibratedImages(folder.absolute().name, stream.images, stream.timestamps)


def _folder(spec: DatasetSpec) -> Path:
    return find_dataset(spec.path, spec.sequence, is_tum_rgbd, "rgb.txt")


def _camera(folder: Path) -> CameraToml | None:
    path = folder / CAMERA_TOML
    if path.is_file():
        return read_camera_toml(path)
    place = re.search(r"freiburg([123])", folder.absolute().name)
    return None if place is None else CameraToml(path, FREIBURG[place.group(1)])
