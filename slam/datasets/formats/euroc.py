"""Datasets in the layout of EuRoC MAV (Burri et al., IJRR 35(10) 2016), which TUM-VI and others use too.

`[NAME/]mav0/{cam0, cam1}/{data.csv, sensor.yaml, data/<nanoseconds>.png}`: the pair is not rectified; `sensor.yaml`
holds each camera's calibration and its pose in the vehicle. `mav0/state_groundtruth_estimate0/data.csv` holds the
vehicle's poses.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from odometry import se3
from slam.datasets.calibration_yaml import parse_numbers, read_yaml
from slam.datasets.camera_toml import parse_pose
from slam.datasets.dataset import DatasetSpec, find_dataset
from slam.datasets.distortion_models import CameraModel
from slam.datasets.formats.recording import (
    CameraStream,
    GroundTruthTrajectory,
    ImageDataset,
    LeftImages,
    RawRecording,
    RectifiedDataset,
    UncalibratedImages,
    build_dataset,
    read_stream,
)
from slam.datasets.formats.timestamped_lists import CSV_NANOSECONDS, read_timestamped_rows
from slam.datasets.rectification import Rectification, Size, rectify_pair, rectify_parallel
from slam.errors import DataError
from slam.io.trajectory_files import check_positions

Array = NDArray[np.float64]

_GROUND_TRUTH = "state_groundtruth_estimate0"
_MIN_QUATERNION_NORM = 1e-6  # shorter ones have no direction


@dataclass(frozen=True)
class EurocCamera:
    """Contents of a camera's `sensor.yaml`.

    Attributes:
        path: file that was read.
        model: intrinsics and distortion.
        T_body_camera: (4, 4) pose of the camera in the vehicle's frame, metres.
    """

    path: Path
    model: CameraModel
    T_body_camera: Array


def is_euroc(folder: Path) -> bool:
    """Whether a folder is one sequence in this layout."""
    return _cameras(folder).joinpath("cam0", "data.csv").is_file()


def open_euroc(spec: DatasetSpec) -> RectifiedDataset:
    """Open a sequence and check all files but the images themselves.

    Raises:
        DataError: a file is missing, damaged or inconsistent with the others.
    """
    folder = _folder(spec)
    cameras = _cameras(folder)
    left = read_sensor_yaml(cameras / "cam0" / "sensor.yaml")
    right = read_sensor_yaml(cameras / "cam1" / "sensor.yaml") if (cameras / "cam1" / "data.csv").is_file() else None
    recording = RawRecording(
        name=folder.absolute().name,
        left=_stream(cameras / "cam0"),
        right=None if right is None else _stream(cameras / "cam1"),
        ground_truth=_read_ground_truth(cameras / _GROUND_TRUTH / "data.csv", left),
    )
    return build_dataset(recording, lambda size: _rectify(left, right, size))


def open_euroc_images(spec: DatasetSpec) -> ImageDataset:
    """Open the left camera's images; they are undistorted if there is a `sensor.yaml`.

    Raises:
        DataError: a file is missing, damaged or inconsistent with the others.
    """
    folder = _folder(spec)
    if (_cameras(folder) / "cam0" / "sensor.yaml").is_file():
        return LeftImages.of(open_euroc(spec))
    stream = _stream(_cameras(folder) / "cam0")
    return UncalibratedImages(folder.absolute().name, stream.images, stream.timestamps)


def _folder(spec: DatasetSpec) -> Path:
    return find_dataset(spec.path, spec.sequence, is_euroc, "mav0/cam0/data.csv")


def _cameras(folder: Path) -> Path:
    return folder / "mav0" if (folder / "mav0").is_dir() else folder


def _stream(folder: Path) -> CameraStream:
    return read_stream(folder / "data.csv", folder / "data", CSV_NANOSECONDS)


def _rectify(left: EurocCamera, right: EurocCamera | None, size: Size) -> Rectification:
    try:
        if right is None:
            return rectify_parallel(left.model, size)
        T_left_right = se3.inverse(left.T_body_camera) @ right.T_body_camera
        return rectify_pair(left.model, right.model, T_left_right, size)
    except ValueError as error:
        raise DataError(f"{left.path}: {error}; correct it or the one of cam1") from None


def _read_ground_truth(path: Path, left: EurocCamera) -> GroundTruthTrajectory | None:
    if not path.is_file():
        return None
    rows = read_timestamped_rows(path, CSV_NANOSECONDS, 8)  # time, position, quaternion with w first
    with np.errstate(over="ignore"):  # a norm that overflows is refused below
        lengths = np.linalg.norm(rows[:, 4:], axis=1)
    if (lengths < _MIN_QUATERNION_NORM).any() or not np.isfinite(lengths).all():
        raise DataError(f"{path}: expected unit quaternions in columns 5 to 8, found others; copy the file again")
    check_positions(path, rows[:, 1:4])
    T_world_body = np.repeat(np.eye(4)[None], len(rows), axis=0)
    T_world_body[:, :3, :3] = Rotation.from_quat(rows[:, [5, 6, 7, 4]]).as_matrix()
    T_world_body[:, :3, 3] = rows[:, 1:4]
    return GroundTruthTrajectory(rows[:, 0], T_world_body @ left.T_body_camera)


def read_sensor_yaml(path: Path) -> EurocCamera:
    """Read a camera's `sensor.yaml`.

    Raises:
        DataError: the file is missing or is not YAML, or a value is missing or invalid.
    """
    try:
        return _sensor(path, read_yaml(path))
    except ValueError as error:
        raise DataError(f"{path}: {error}; copy the file again or correct it") from None


def _sensor(path: Path, table: dict[str, Any]) -> EurocCamera:
    pose = table.get("T_BS")
    T_body_camera = parse_pose(pose.get("data") if isinstance(pose, dict) else pose, "T_BS")
    fx, fy, cx, cy = parse_numbers(table, "intrinsics", 4)
    coefficients = parse_numbers(table, "distortion_coefficients")
    model = str(table.get("distortion_model", "radial-tangential")) if coefficients else "none"
    return EurocCamera(path, CameraModel(fx, fy, cx, cy, model, coefficients), T_body_camera)
