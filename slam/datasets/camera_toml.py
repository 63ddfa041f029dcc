"""Reads `camera.toml`, the calibration of a custom camera. One camera needs four numbers, a rectified pair five.

    fx = 718.9                      # focal lengths and principal point, pixels
    fy = 718.9
    cx = 607.2
    cy = 185.2
    baseline = 0.537                # metres, of a pair of equal, parallel cameras side by side

    model = "radtan"                # distortion of both: radtan, rational, equidistant (or their names in ROS)
    distortion = [-0.28, 0.07, 0.0002, 0.00002]
    fps = 20                        # images per second, if there is no times.txt and no video
    left = "cam0"                   # folder, video file or topic of a bag; usual names are found without it
    right = "cam1"
    depth = "depth"                 # folder or topic of depth images that are registered to the left ones
    depth_scale = 1000              # their units per metre; without it 1000, or 1 if they are floats
    ground_truth = "poses.tum"      # T_world_camera of the left camera, TUM or KITTI

For an unrectified pair, a table with the right camera replaces the baseline:

    [right_camera]
    fx = ...                        # fy, cx, cy, model and distortion likewise
    T_left_right = [[...], [...], [...], [...]]     # its pose in the left camera's frame, metres
"""

import difflib
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.datasets.dataset import is_valid_fps
from slam.datasets.distortion_models import CameraModel
from slam.datasets.rectification import NOMINAL_BASELINE_M, Rectification, Size, rectify_pair, rectify_parallel
from slam.errors import DataError
from slam.io.files import read_lines
from slam.io.trajectory_files import MAX_ROTATION_ERROR

Array = NDArray[np.float64]

CAMERA_TOML = "camera.toml"  # name of the file

_INTRINSICS = ("fx", "fy", "cx", "cy")
_CAMERA_KEYS = (*_INTRINSICS, "model", "distortion")
_TEXT_KEYS = ("left", "right", "depth", "ground_truth")
_KEYS = (*_CAMERA_KEYS, "baseline", "fps", *_TEXT_KEYS, "depth_scale", "right_camera")
# What users write instead, where the known key is spelt quite differently.
_SYNONYMS = {
    **dict.fromkeys(("images", "image", "images_left", "folder", "video", "topic"), "left"),
    **dict.fromkeys(("rate", "hz", "frequency"), "fps"),
    **dict.fromkeys(("f", "focal", "focal_length"), "fx"),
    **dict.fromkeys(("coefficients", "d", "distortion_coefficients"), "distortion"),
    **dict.fromkeys(("poses", "truth", "trajectory"), "ground_truth"),
    **dict.fromkeys(("extrinsics", "pose", "t_c1_c2"), "T_left_right"),
    **dict.fromkeys(("depth_images", "images_depth", "depth_folder", "depth_topic"), "depth"),
    **dict.fromkeys(("depthmapfactor", "depth_factor", "depth_units", "scale", "png_depth_scale"), "depth_scale"),
    "images_right": "right",
    "b": "baseline",
    "distortion_model": "model",
    "cam1": "right_camera",
}
_MAX_NAME_BYTES = 255  # of a file name in Linux's file systems
_MAX_TRANSLATION = 1e6  # m, of a pose in a calibration: more is damage


@dataclass(frozen=True)
class RightCamera:
    """The right camera of an unrectified pair.

    Attributes:
        model: intrinsics and distortion of the right camera.
        T_left_right: (4, 4) pose of the right camera in the left camera's frame, metres.
    """

    model: CameraModel
    T_left_right: Array


@dataclass(frozen=True)
class CameraToml:
    """Contents of a `camera.toml`, or of another file with the same numbers.

    Attributes:
        path: file that was read.
        model: intrinsics and distortion of the left camera, or of both cameras.
        baseline_m: baseline of a pair of equal, parallel cameras; None with one camera or with `right_camera`.
        right_camera: right camera of an unrectified pair, or None.
        fps: images per second, or None.
        left, right: names of folders, video files or topics; None to find them.
        depth: name of the folder or topic of depth images, or None.
        depth_scale: units of depth per metre; None for the usual ones.
        ground_truth: file of poses, or None.
        size: width and height of the images that were calibrated, pixels; zeros if unknown.
        topics: image topics of the cameras in a bag, if the file names them.
        remarks: notes for the user.
    """

    path: Path
    model: CameraModel
    baseline_m: float | None = None
    right_camera: RightCamera | None = None
    fps: float | None = None
    left: str | None = None
    right: str | None = None
    depth: str | None = None
    depth_scale: float | None = None
    ground_truth: Path | None = None
    size: Size = (0, 0)
    topics: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def is_pair(self) -> bool:
        """Whether the file describes two cameras."""
        return self.baseline_m is not None or self.right_camera is not None

    def rectification(self, size: Size) -> Rectification:
        """Compute the rectification of images of a size (width, height).

        Raises:
            DataError: the calibration contradicts itself.
        """
        if self.size not in (size, (0, 0)):
            raise DataError(
                f"{self.path}: expected images of {self.size[0]} x {self.size[1]}, found {size[0]} x {size[1]};"
                f" calibrate images of this size, or write their fx, fy, cx and cy into {CAMERA_TOML}"
            )
        try:
            if self.right_camera is not None:
                return rectify_pair(self.model, self.right_camera.model, self.right_camera.T_left_right, size)
            return rectify_parallel(
                self.model, size, NOMINAL_BASELINE_M if self.baseline_m is None else self.baseline_m
            )
        except ValueError as error:
            raise DataError(f"{self.path}: {error}; calibrate again or correct the numbers") from None


def read_camera_toml(path: Path, find_other: Callable[[], CameraToml | None] = lambda: None) -> CameraToml:
    """Read a `camera.toml`.

    Args:
        path: file to read.
        find_other: finds the calibration in another file, which is used if this one has no calibration.

    Raises:
        DataError: the file is missing or is not TOML, a key is missing or unknown, or a value is invalid.
    """
    try:
        table = tomllib.loads("\n".join(read_lines(path)))
    except (ValueError, RecursionError) as error:  # also raised for numbers with too many digits and for deep nesting
        raise DataError(f"{path}: expected TOML, found {error}; correct that line") from None
    has_cameras = any(key in table for key in (*_CAMERA_KEYS, "baseline", "right_camera"))
    other = None if has_cameras else find_other()
    try:
        return _camera_file(path, table, other)
    except ValueError as error:
        raise DataError(f"{path}: {error}; correct it, see docs/drives.md") from None


def _camera_file(path: Path, table: dict[str, Any], other: CameraToml | None) -> CameraToml:
    _reject_unknown_keys(table, _KEYS)
    given: dict[str, Any] = {key: _text(table[key], key) for key in _TEXT_KEYS if key in table}
    given |= {key: _positive(table, key) for key in ("fps", "depth_scale") if key in table}
    if "ground_truth" in given:
        given["ground_truth"] = path.parent / given["ground_truth"]
    right = table.get("right_camera")
    if right is not None and "baseline" in table:
        raise ValueError("expected baseline or [right_camera], found both")
    if not is_valid_fps(given.get("fps", 1.0)):
        raise ValueError(f"expected fps in images per second, found {given['fps']:g}")
    if other is not None:
        return replace(other, **given)
    return CameraToml(
        path,
        _camera_model(table),
        baseline_m=_positive(table, "baseline"),
        right_camera=None if right is None else _right_camera(right),
        **given,
    )


def _right_camera(table: object) -> RightCamera:
    if not isinstance(table, dict):
        raise ValueError(f"expected a table [right_camera], found {str(table)[:60]!r}")
    try:
        _reject_unknown_keys(table, (*_CAMERA_KEYS, "T_left_right"))
        return RightCamera(_camera_model(table), parse_pose(table.get("T_left_right"), "T_left_right"))
    except ValueError as error:
        raise ValueError(f"[right_camera] {error}") from None


def parse_pose(value: object, name: str) -> Array:
    """Return a pose (4, 4) from nested lists of 4 x 4 numbers or a list of 16.

    Raises:
        ValueError: the value is not a pose.
    """
    try:
        T = np.array(value, dtype=np.float64).reshape(4, 4)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"expected 4 x 4 numbers {name}, found {str(value)[:60]}") from None
    R = T[:3, :3]
    if not np.isfinite(T).all() or np.abs(T[:3]).max() > _MAX_TRANSLATION or not np.array_equal(T[3], [0, 0, 0, 1]):
        raise ValueError(f"expected a pose {name} whose last row is 0 0 0 1, found {T[3].tolist()}")
    if np.abs(R @ R.T - np.eye(3)).max() > MAX_ROTATION_ERROR or np.linalg.det(R) < 0:
        raise ValueError(f"expected a rotation in {name}, found a matrix that is not one")
    return T


def _camera_model(table: dict[str, Any]) -> CameraModel:
    missing = [key for key in _INTRINSICS if key not in table]
    if missing:
        raise ValueError(f"expected fx, fy, cx and cy, found no {missing[0]}")
    fx, fy, cx, cy = (_number(table[key], key) for key in _INTRINSICS)
    coefficients = table.get("distortion", [])
    if not isinstance(coefficients, list):
        raise ValueError(f"expected a list of numbers distortion, found {str(coefficients)[:60]}")
    model = _text(table.get("model", "radtan" if coefficients else "none"), "model")
    return CameraModel(fx, fy, cx, cy, model, tuple(_number(value, "distortion") for value in coefficients))


def _number(value: object, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"expected a number {name}, found {str(value)[:60]!r}")
    try:
        number = float(value)
    except OverflowError:
        raise ValueError(f"expected a number {name}, found one that is too large") from None
    if not abs(number) < np.inf:
        raise ValueError(f"expected a finite number {name}, found {number}")
    return number


def _positive(table: dict[str, Any], name: str) -> float | None:
    if name not in table:
        return None
    number = _number(table[name], name)
    if number <= 0:
        raise ValueError(f"expected {name} above 0, found {number:g}")
    return number


def _text(value: object, name: str) -> str:
    if not isinstance(value, str) or not value or "\0" in value or len(value.encode()) > _MAX_NAME_BYTES:
        raise ValueError(f"expected a text {name} of up to {_MAX_NAME_BYTES} bytes, found {str(value)[:60]!r}")
    return value


def _reject_unknown_keys(table: dict[str, Any], known: tuple[str, ...]) -> None:
    others = sorted(set(table) - set(known))
    if others:
        raise ValueError(f"expected only {', '.join(known)}, found {others[0][:60]!r}{_suggestion(others[0], known)}")


def _suggestion(key: str, known: tuple[str, ...]) -> str:
    """Question whether the nearest known key was meant; empty if none is near."""
    lower = key.lower()
    near = difflib.get_close_matches(lower, [name.lower() for name in known], 1)
    meant = next((name for name in known if [name.lower()] == near), _SYNONYMS.get(lower))
    return f" (did you mean {meant}?)" if meant in known else ""
