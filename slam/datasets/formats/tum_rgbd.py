"""Datasets in the layout of TUM RGB-D (Sturm et al., IROS 2012); the depth images are not read.

`[NAME/]{rgb.txt, rgb/<seconds>.png, groundtruth.txt}`; OpenLORIS-Scene (Shi et al., ICRA 2020) calls the list
`color.txt`. The layout does not include a calibration: it is read from a `camera.toml` beside the list, or taken from
the benchmark's cameras by the name of the sequence.
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


_LISTS = ("rgb.txt", "color.txt")
_OPENLORIS_REMARK = (
    "groundtruth.txt beside color.txt: if its poses are those of the robot's base, errors include the camera's place on"
    " the robot"
)


def is_tum_rgbd(folder: Path) -> bool:
    """Whether a folder is one sequence in this layout."""
    return (folder / "rgb.txt").is_file() or ((folder / "color.txt").is_file() and (folder / "color").is_dir())


def _list(folder: Path) -> Path:
    return next(folder / name for name in _LISTS if (folder / name).is_file())


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
            " none; write one with fx, fy, cx and cy (of OpenLORIS they are in sensors.yaml)"
        )
    path, poses = _list(folder), folder / "groundtruth.txt"
    left = read_stream(path, folder, SPACE_SEPARATED_SECONDS)
    truth = read_ground_truth(poses, left) if poses.is_file() else None
    remarks = (_OPENLORIS_REMARK,) if truth is not None and path.name == "color.txt" else ()
    recording = RawRecording(folder.absolute().name, left, ground_truth=truth, remarks=remarks)
    return build_dataset(recording, camera.rectification)


def open_tum_rgbd_images(spec: DatasetSpec) -> ImageDataset:
    """Open the colour images; they are undistorted if the camera is known.

    Raises:
        DataError: a file is missing, damaged or inconsistent with the others.
    """
    folder = _folder(spec)
    if _camera(folder) is not None:
        return LeftImages.of(open_tum_rgbd(spec))
    stream = read_stream(_list(folder), folder, SPACE_SEPARATED_SECONDS)
    return UncalibratedImages(folder.absolute().name, stream.images, stream.timestamps, remarks=stream.remarks)


def _folder(spec: DatasetSpec) -> Path:
    return find_dataset(spec.path, spec.sequence, is_tum_rgbd, "rgb.txt or color.txt")


def _camera(folder: Path) -> CameraToml | None:
    path = folder / CAMERA_TOML
    if path.is_file():
        return read_camera_toml(path)
    place = re.search(r"freiburg([123])", folder.absolute().name)
    return None if place is None else CameraToml(path, FREIBURG[place.group(1)])
