"""Datasets in the layout of EuRoC MAV (Burri et al., IJRR 35(10) 2016), which TUM-VI and others use too.

`[NAME/]mav0/{cam0, cam1}/{data.csv, sensor.yaml, data/<nanoseconds>.png}`: the pair is not rectified; `sensor.yaml`
holds each camera's calibration and its pose in the vehicle. `mav0/state_groundtruth_estimate0/data.csv`, in TUM-VI
`mav0/mocap0/data.csv`, holds the vehicle's poses.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.datasets.calibration_yaml import find_calibration, parse_numbers, read_yaml
from slam.datasets.camera_toml import CAMERA_TOML, CameraToml, parse_pose
from slam.datasets.dataset import DatasetSpec, find_dataset
from slam.datasets.distortion_models import CameraModel
from slam.datasets.formats.custom_camera import rectification_of
from slam.datasets.formats.ground_truth import GroundTruthTrajectory, read_timed_poses
from slam.datasets.formats.recording import (
    CameraStream,
    ImageDataset,
    LeftImages,
    RawRecording,
    RectifiedDataset,
    UncalibratedImages,
    build_dataset,
    read_stream,
    rectify_left,
)
from slam.datasets.formats.timestamped_lists import CSV_NANOSECONDS
from slam.datasets.rectification import Rectification, Size, rectify_pair, rectify_parallel
from slam.errors import DataError

Array = NDArray[np.float64]

# Folders of the vehicle's poses, of EuRoC and of TUM-VI.
_GROUND_TRUTH = ("state_groundtruth_estimate0", "mocap0")


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
    if not (cameras / "cam0" / "sensor.yaml").is_file():
        return _open_with_other_calibration(spec, folder)
    left, has_right = read_sensor_yaml(cameras / "cam0" / "sensor.yaml"), (cameras / "cam1" / "data.csv").is_file()
    recording = RawRecording(
        name=folder.absolute().name,
        left=_stream(cameras / "cam0"),
        right=_stream(cameras / "cam1") if has_right and not spec.left_only else None,
        ground_truth=_read_ground_truth(cameras, left),
    )

    def rectify_one(size: Size) -> Rectification:
        return _rectify(left, None, size)

    def rectify_both(size: Size) -> Rectification:
        return _rectify(left, read_sensor_yaml(cameras / "cam1" / "sensor.yaml"), size)

    if not has_right:
        return build_dataset(recording, rectify_one)
    return build_dataset(recording, rectify_left(rectify_both, rectify_one) if spec.left_only else rectify_both)


def _open_with_other_calibration(spec: DatasetSpec, folder: Path) -> RectifiedDataset:
    """Open a sequence without `sensor.yaml`; its poses are of the vehicle, whose camera's place is then unknown."""
    cameras, settings = _cameras(folder), _find_calibration(folder)
    if settings is None:
        raise DataError(
            f"{cameras / 'cam0' / 'sensor.yaml'}: expected this file, found none; copy it there, or write"
            f" {folder / CAMERA_TOML} (of TUM-VI the numbers are in dso/camchain.yaml)"
        )
    has_right = settings.is_pair and not spec.left_only and (cameras / "cam1" / "data.csv").is_file()
    right = _stream(cameras / "cam1") if has_right else None
    recording = RawRecording(folder.absolute().name, _stream(cameras / "cam0"), right, remarks=settings.remarks)
    return build_dataset(recording, rectification_of(settings, spec.left_only))


def _find_calibration(folder: Path) -> CameraToml | None:
    """The calibration beside `mav0`, else that in the folder in which TUM-VI has Kalibr's; None if there is none."""
    return find_calibration(folder) or (find_calibration(folder / "dso") if (folder / "dso").is_dir() else None)


def open_euroc_images(spec: DatasetSpec) -> ImageDataset:
    """Open the left camera's images; they are undistorted if there is a `sensor.yaml`.

    Raises:
        DataError: a file is missing, damaged or inconsistent with the others.
    """
    folder = _folder(spec)
    if (_cameras(folder) / "cam0" / "sensor.yaml").is_file() or _find_calibration(folder) is not None:
        return LeftImages.of(open_euroc(spec))
    stream = _stream(_cameras(folder) / "cam0")
    return UncalibratedImages(folder.absolute().name, stream.images, stream.timestamps, remarks=stream.remarks)


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


def _read_ground_truth(cameras: Path, left: EurocCamera) -> GroundTruthTrajectory | None:
    path = next(
        (cameras / name / "data.csv" for name in _GROUND_TRUTH if (cameras / name / "data.csv").is_file()), None
    )
    if path is None:
        return None
    T_world_body = read_timed_poses(path, CSV_NANOSECONDS, (5, 6, 7, 4))  # a quaternion with w first
    return replace(T_world_body, poses=T_world_body.poses @ left.T_body_camera)


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
