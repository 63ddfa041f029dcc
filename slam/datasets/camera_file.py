"""`camera.toml`: what somebody knows of their own camera. Four numbers are enough for one eye, five for two.

    fx = 718.9                      # focal lengths and principal point, pixels
    fy = 718.9
    cx = 607.2
    cy = 185.2
    baseline = 0.537                # metres, of a pair whose cameras are alike, parallel and side by side

    model = "radtan"                # lens of both: radtan, rational, equidistant (or their names in ROS)
    distortion = [-0.28, 0.07, 0.0002, 0.00002]
    fps = 20                        # images a second, where neither times.txt nor a video says
    left = "cam0"                   # folder, video file or topic of a bag; found by itself where it is obvious
    right = "cam1"
    ground_truth = "poses.tum"      # T_world_camera of the left camera, TUM or KITTI

A pair that is not rectified has, instead of the baseline, the right camera in a table of its own:

    [right_camera]
    fx = ...                        # fy, cx, cy, model and distortion likewise
    T_left_right = [[...], [...], [...], [...]]     # its pose in the left camera's frame, metres
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.datasets.lens import Lens
from slam.datasets.rectification import NOMINAL_BASELINE, Rectification, Size, rectify_alike, rectify_pair
from slam.datasets.source import is_rate
from slam.errors import DataError
from slam.storage.text import read_lines
from slam.storage.trajectory import MAX_ROTATION_ERROR

Array = NDArray[np.float64]

NAME = "camera.toml"

_LENS = ("fx", "fy", "cx", "cy")
_OF_LENS = (*_LENS, "model", "distortion")
_TEXTS = ("left", "right", "ground_truth")
_LONGEST_NAME = 255  # bytes: what a file may be called
_KEYS = (*_OF_LENS, "baseline", "fps", *_TEXTS, "right_camera")


@dataclass(frozen=True)
class RightCamera:
    """The right camera of a pair that is not rectified.

    Attributes:
        lens: its own.
        T_left_right: (4, 4) its pose in the left camera's frame, metres.
    """

    lens: Lens
    T_left_right: Array


@dataclass(frozen=True)
class CameraFile:
    """What stands in a `camera.toml`.

    Attributes:
        path: of the file.
        lens: of the left camera, or of both.
        baseline: of a pair of such cameras, metres; None where there is one, or where `right_camera` says more.
        right_camera: of a pair that is not rectified.
        fps: images a second, or None.
        left, right: names of folders, video files or topics, or None to find them.
        ground_truth: file of poses, or None.
    """

    path: Path
    lens: Lens
    baseline: float | None = None
    right_camera: RightCamera | None = None
    fps: float | None = None
    left: str | None = None
    right: str | None = None
    ground_truth: Path | None = None

    @property
    def is_pair(self) -> bool:
        """Whether it describes two cameras."""
        return self.baseline is not None or self.right_camera is not None

    def rectification(self, size: Size) -> Rectification:
        """How images of a size (width, height) become those of an ideal camera or pair.

        Raises:
            DataError: the numbers do not fit together.
        """
        try:
            if self.right_camera is not None:
                return rectify_pair(self.lens, self.right_camera.lens, self.right_camera.T_left_right, size)
            return rectify_alike(self.lens, size, NOMINAL_BASELINE if self.baseline is None else self.baseline)
        except ValueError as error:
            raise DataError(f"{self.path}: {error}; calibrate again or mend the numbers") from None


def read_camera_file(path: Path) -> CameraFile:
    """Read a `camera.toml`.

    Raises:
        DataError: the file is missing or no TOML, a key is missing or unknown, or a value is none.
    """
    try:
        table = tomllib.loads("\n".join(read_lines(path)))
    except (ValueError, RecursionError) as error:  # besides its own, what Python thinks too long or too deep
        raise DataError(f"{path}: expected TOML, found {error}; mend that line") from None
    try:
        return _camera_file(path, table)
    except ValueError as error:
        raise DataError(f"{path}: {error}; mend it, see docs/drives.md") from None


def _camera_file(path: Path, table: dict[str, Any]) -> CameraFile:
    _refuse_others(table, _KEYS)
    texts = {key: _text(table[key], key) for key in _TEXTS if key in table}
    truth = texts.pop("ground_truth", None)
    right = table.get("right_camera")
    if right is not None and "baseline" in table:
        raise ValueError("expected baseline or [right_camera], found both")
    fps = _positive(table, "fps")
    if fps is not None and not is_rate(fps):
        raise ValueError(f"expected images a second fps, found {fps:g}")
    return CameraFile(
        path,
        _lens(table),
        baseline=_positive(table, "baseline"),
        right_camera=None if right is None else _right_camera(right),
        fps=fps,
        ground_truth=None if truth is None else path.parent / truth,
        **texts,
    )


def _right_camera(table: object) -> RightCamera:
    if not isinstance(table, dict):
        raise ValueError(f"expected a table [right_camera], found {str(table)[:60]!r}")
    _refuse_others(table, (*_OF_LENS, "T_left_right"))
    try:
        return RightCamera(_lens(table), check_pose(table.get("T_left_right"), "T_left_right"))
    except ValueError as error:
        raise ValueError(f"[right_camera] {error}") from None


def check_pose(value: object, name: str) -> Array:
    """A pose (4, 4) from lists of numbers, 4 x 4 or 16 in a row.

    Raises:
        ValueError: it is none.
    """
    try:
        T = np.array(value, dtype=np.float64).reshape(4, 4)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"expected 4 x 4 numbers {name}, found {str(value)[:60]}") from None
    R = T[:3, :3]
    if not np.isfinite(T).all() or np.abs(T[:3]).max() > 1e6 or not np.array_equal(T[3], [0, 0, 0, 1]):
        raise ValueError(f"expected a pose {name} whose last row is 0 0 0 1, found {T[3].tolist()}")
    if np.abs(R @ R.T - np.eye(3)).max() > MAX_ROTATION_ERROR or np.linalg.det(R) < 0:
        raise ValueError(f"expected a rotation in {name}, found a matrix that is none")
    return T


def _lens(table: dict[str, Any]) -> Lens:
    missing = [key for key in _LENS if key not in table]
    if missing:
        raise ValueError(f"expected fx, fy, cx and cy, found no {missing[0]}")
    fx, fy, cx, cy = (_number(table[key], key) for key in _LENS)
    coefficients = table.get("distortion", [])
    if not isinstance(coefficients, list):
        raise ValueError(f"expected a list of numbers distortion, found {str(coefficients)[:60]}")
    model = _text(table.get("model", "radtan" if coefficients else "none"), "model")
    return Lens(fx, fy, cx, cy, model, tuple(_number(value, "distortion") for value in coefficients))


def _number(value: object, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"expected a number {name}, found {str(value)[:60]!r}")
    try:
        number = float(value)
    except OverflowError:
        raise ValueError(f"expected a number {name}, found one beyond all bounds") from None
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
    if not isinstance(value, str) or not value or "\0" in value or len(value.encode()) > _LONGEST_NAME:
        raise ValueError(f"expected a text {name} of up to {_LONGEST_NAME} bytes, found {str(value)[:60]!r}")
    return value


def _refuse_others(table: dict[str, Any], known: tuple[str, ...]) -> None:
    others = sorted(set(table) - set(known))
    if others:
        raise ValueError(f"expected only {', '.join(known)}, found {others[0][:60]!r}")
