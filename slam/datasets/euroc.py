"""Drives in the layout of EuRoC MAV (Burri et al., IJRR 35(10) 2016), which others have taken over.

`[NAME/]mav0/{cam0, cam1}/{data.csv, sensor.yaml, data/<nanoseconds>.png}`: the pair is not rectified, and `sensor.yaml`
says how each camera sits in the vehicle. `mav0/state_groundtruth_estimate0/data.csv` holds poses of the vehicle.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from odometry import se3
from slam.datasets.assembly import Eye, Recording, TrueWay, assemble, read_eye
from slam.datasets.camera_drive import CameraDrive
from slam.datasets.camera_file import check_pose
from slam.datasets.folders import find_drive
from slam.datasets.left_images import ImageRecording, RawImages, left_images
from slam.datasets.lens import Lens
from slam.datasets.rectification import Rectification, Size, rectify_alike, rectify_pair
from slam.datasets.source import Source
from slam.datasets.stamped import CSV_NANOSECONDS, read_stamped
from slam.errors import DataError
from slam.storage.text import read_lines
from slam.storage.trajectory import check_positions

Array = NDArray[np.float64]

_TRUTH = "state_groundtruth_estimate0"


@dataclass(frozen=True)
class Sensor:
    """A camera as its `sensor.yaml` describes it.

    Attributes:
        path: of the file.
        lens: intrinsics and distortion.
        T_body_camera: (4, 4) pose of the camera in the vehicle, metres.
    """

    path: Path
    lens: Lens
    T_body_camera: Array


def is_euroc(folder: Path) -> bool:
    """Whether a folder is one drive in this layout."""
    return _cameras(folder).joinpath("cam0", "data.csv").is_file()


def open_euroc(source: Source) -> CameraDrive:
    """Open a drive and check everything but the images themselves.

    Raises:
        DataError: one line that names the file, what was expected and found, and the remedy.
    """
    folder = _folder(source)
    cameras = _cameras(folder)
    left = read_sensor(cameras / "cam0" / "sensor.yaml")
    right = read_sensor(cameras / "cam1" / "sensor.yaml") if (cameras / "cam1" / "data.csv").is_file() else None
    recording = Recording(
        name=folder.absolute().name,
        left=_eye(cameras / "cam0"),
        right=None if right is None else _eye(cameras / "cam1"),
        truth=_true_way(cameras / _TRUTH / "data.csv", left),
    )
    return assemble(recording, lambda size: _rectify(left, right, size))


def left_of_euroc(source: Source) -> ImageRecording:
    """What the left camera saw, straightened where a `sensor.yaml` says how.

    Raises:
        DataError: one line that names the file, what was expected and found, and the remedy.
    """
    folder = _folder(source)
    if (_cameras(folder) / "cam0" / "sensor.yaml").is_file():
        return left_images(open_euroc(source))
    eye = _eye(_cameras(folder) / "cam0")
    return RawImages(folder.absolute().name, eye.images, eye.times)


def _folder(source: Source) -> Path:
    return find_drive(source.path, source.sequence, is_euroc, "mav0/cam0/data.csv")


def _cameras(folder: Path) -> Path:
    return folder / "mav0" if (folder / "mav0").is_dir() else folder


def _eye(folder: Path) -> Eye:
    return read_eye(folder / "data.csv", folder / "data", CSV_NANOSECONDS)


def _rectify(left: Sensor, right: Sensor | None, size: Size) -> Rectification:
    try:
        if right is None:
            return rectify_alike(left.lens, size)
        T_left_right = se3.inverse(left.T_body_camera) @ right.T_body_camera
        return rectify_pair(left.lens, right.lens, T_left_right, size)
    except ValueError as error:
        raise DataError(f"{left.path}: {error}; mend it or the one of cam1") from None


def _true_way(path: Path, left: Sensor) -> TrueWay | None:
    if not path.is_file():
        return None
    rows = read_stamped(path, CSV_NANOSECONDS, 8)  # time, position, quaternion with w first
    with np.errstate(over="ignore"):  # of lengths beyond all bounds, which are refused
        lengths = np.linalg.norm(rows[:, 4:], axis=1)
    if (lengths < 1e-6).any() or not np.isfinite(lengths).all():
        raise DataError(f"{path}: expected unit quaternions in columns 5 to 8, found others; copy the file again")
    check_positions(path, rows[:, 1:4])
    T_world_body = np.repeat(np.eye(4)[None], len(rows), axis=0)
    T_world_body[:, :3, :3] = Rotation.from_quat(rows[:, [5, 6, 7, 4]]).as_matrix()
    T_world_body[:, :3, 3] = rows[:, 1:4]
    return TrueWay(rows[:, 0], T_world_body @ left.T_body_camera)


def read_sensor(path: Path) -> Sensor:
    """Read a camera's `sensor.yaml`.

    Raises:
        DataError: the file is missing or no YAML, or a value is missing or none.
    """
    import yaml  # late: only those who drive in this layout wait for it

    text = "\n".join(line for line in read_lines(path) if not line.startswith("%YAML"))
    try:
        if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text)):
            raise ValueError("aliases, by which a few lines can unfold into billions")
        table = yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise DataError(f"{path}: expected YAML, found {str(error)[:200]}; copy the file again") from None
    try:
        return _sensor(path, table if isinstance(table, dict) else {})
    except ValueError as error:
        raise DataError(f"{path}: {error}; copy the file again or mend it") from None


def _sensor(path: Path, table: dict[Any, Any]) -> Sensor:
    placed = table.get("T_BS")
    T_body_camera = check_pose(placed.get("data") if isinstance(placed, dict) else placed, "T_BS")
    fx, fy, cx, cy = _numbers(table, "intrinsics", 4)
    coefficients = _numbers(table, "distortion_coefficients")
    model = str(table.get("distortion_model", "radial-tangential")) if coefficients else "none"
    return Sensor(path, Lens(fx, fy, cx, cy, model, coefficients), T_body_camera)


def _numbers(table: dict[Any, Any], name: str, count: int | None = None) -> tuple[float, ...]:
    value: Any = table.get(name, [] if count is None else None)
    try:
        numbers = tuple(map(float, value))
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"expected a list of numbers {name}, found {str(value)[:60]}") from None
    if count is not None and len(numbers) != count:
        raise ValueError(f"expected {count} numbers {name}, found {len(numbers)}")
    return numbers
