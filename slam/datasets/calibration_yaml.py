"""Reads the calibration files of other tools: OpenCV, Kalibr, ROS and ORB-SLAM. All of them are YAML.

A file is recognised by what is in it, so its name does not matter:

* Kalibr's `camchain.yaml`: `cam0`, `cam1` with `intrinsics`, `distortion_coeffs`, `T_cn_cnm1`, `rostopic`;
* OpenCV's stereo calibration: `M1 D1 M2 D2 R T`, in one file or two, or the same matrices under similar names;
* one camera of OpenCV or ROS: `camera_matrix`, `distortion_coefficients`; ROS's `left.yaml`, `right.yaml` are a pair;
* ORB-SLAM's settings: `Camera.fx` or `Camera1.fx`, with `Camera.bf`, `Stereo.T_c1_c2`, or `LEFT.K` and `LEFT.P`;
  of a depth camera `DepthMapFactor` or `RGBD.DepthMapFactor`.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from slam.datasets.camera_toml import CAMERA_TOML, CameraToml, RightCamera, parse_pose, read_camera_toml
from slam.datasets.distortion_models import CameraModel
from slam.datasets.rectification import Size
from slam.errors import DataError
from slam.io.files import read_lines

Array = NDArray[np.float64]
Table = Mapping[str, Any]

_SUFFIXES = (".yaml", ".yml")
_MATRIX_TAG = "tag:yaml.org,2002:opencv-matrix"
_MAX_FILE_BYTES = 1_000_000  # a calibration is some kilobytes
# Names of OpenCV's matrices without case and punctuation; {} is the side.
_K_NAMES = ("m{}", "k{}", "cameramatrix{}", "{}cameramatrix", "{}k", "mtx{}", "intrinsics{}", "intrinsicmatrix{}")
_D_NAMES = ("d{}", "distcoeffs{}", "distortioncoefficients{}", "{}distcoeffs", "{}distortioncoefficients", "{}d")
_R_NAMES = ("r{}", "rectificationmatrix{}", "{}r")  # rectification of one camera
_P_NAMES = ("p{}", "projectionmatrix{}", "{}p")
_SIDES = (("1", "left", "l"), ("2", "right", "r"))
_MIN_COEFFICIENTS = 4  # k1 k2 p1 p2
_ROS_NAMES = {
    "camera_matrix": "k",
    "distortion_coefficients": "d",
    "rectification_matrix": "r",
    "projection_matrix": "p",
}
_SIZE = ("width", "height")
_ORB_SLAM_MODELS = {"KannalaBrandt8": "equidistant"}


def read_yaml(path: Path) -> dict[str, Any]:
    """Read a YAML file; a matrix of OpenCV becomes a table with its rows, cols and data.

    Raises:
        DataError: the file is missing or is not YAML.
    """
    import yaml  # imported here because most datasets have none

    class _Loader(yaml.SafeLoader):
        """Reads plain values and OpenCV's matrices; nothing that a file holds can run."""

    _Loader.add_constructor(_MATRIX_TAG, lambda loader, node: loader.construct_mapping(node, deep=True))
    text = "\n".join(line for line in read_lines(path) if not line.startswith("%YAML"))
    try:
        if any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text)):
            raise ValueError("aliases, which can expand a few lines to billions")
        table = _Loader(text).get_single_data()
    except (yaml.YAMLError, RecursionError, ValueError, TypeError, AttributeError) as error:
        raise DataError(f"{path}: expected YAML, found {str(error)[:200]}; copy the file again") from None
    return {str(key): value for key, value in table.items()} if isinstance(table, dict) else {}


def find_calibration(folder: Path) -> CameraToml | None:
    """Read the calibration of the cameras of a folder: its `camera.toml`, else a YAML file; None if it has neither.

    A `camera.toml` without intrinsics adds its values (fps, names, ground truth) to the calibration of a YAML file.

    Raises:
        DataError: the calibration is invalid, or there are several.
    """
    path = folder / CAMERA_TOML
    if not path.is_file():
        return _find_yaml(folder)
    return read_camera_toml(path, lambda: _find_yaml(folder))


def _find_yaml(folder: Path) -> CameraToml | None:
    files = [f for f in sorted(folder.iterdir()) if f.suffix.lower() in _SUFFIXES and f.is_file()]
    tables = {file: table for file in files if (table := _read_candidate(file))}
    # OpenCV's example program writes the pose of the right camera into a file of its own.
    poses = [file for file, table in tables.items() if _matrix(table, ("t",), 3) is not None and not _has_camera(table)]
    if len(poses) == 1:
        extrinsics = tables.pop(poses[0])
        tables = {file: {**extrinsics, **table} for file, table in tables.items()}
    try:
        pair = _ros_pair(tables)
        found = [pair] if pair else [camera for f, t in tables.items() if (camera := read_calibration(f, t))]
    except ValueError as error:
        raise DataError(f"{folder}: {error}; correct it, or write {CAMERA_TOML}") from None
    if len(found) > 1:
        names = ", ".join(camera.path.name for camera in found)
        raise DataError(f"{folder}: expected one calibration, found {names}; keep one there, or write {CAMERA_TOML}")
    return replace(found[0], remarks=(*found[0].remarks, f"calibration of {found[0].path.name}")) if found else None


def _read_candidate(file: Path) -> dict[str, Any]:
    """The table of a file that may be a calibration; empty for other files, which may hold anything."""
    try:
        return read_yaml(file) if file.stat().st_size <= _MAX_FILE_BYTES else {}
    except (DataError, OSError):
        return {}


def read_calibration(path: Path, table: Table) -> CameraToml | None:
    """Convert the table of a YAML file; None if it is no calibration of cameras.

    Raises:
        ValueError: a number is missing or impossible.
    """
    try:
        return _from_kalibr(path, table) or _from_orb_slam(path, table) or _from_opencv(path, table)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from None


def _from_kalibr(path: Path, table: Table) -> CameraToml | None:
    cameras = [c for name in ("cam0", "cam1") if isinstance(c := table.get(name), dict) and "intrinsics" in c]
    if not cameras:
        return None
    models = [_kalibr_model(camera) for camera in cameras]
    size = parse_numbers(cameras[0], "resolution", 2) if "resolution" in cameras[0] else (0, 0)
    topics = [str(camera["rostopic"]) if "rostopic" in camera else None for camera in cameras]
    camera = CameraToml(path, models[0], size=(int(size[0]), int(size[1])), topics=tuple(t for t in topics if t))
    others = sorted(name for name in table if re.fullmatch(r"cam([2-9]|\d\d+)", name))
    if others:
        camera = replace(camera, remarks=(f"{', '.join(others)} of {path.name} are not used",))
    return camera if len(cameras) == 1 else replace(camera, right_camera=RightCamera(models[1], _kalibr_pose(cameras)))


def _kalibr_model(camera: Table) -> CameraModel:
    if camera.get("camera_model", "pinhole") != "pinhole":
        raise ValueError(f"expected the camera_model pinhole, found {str(camera['camera_model'])[:40]!r}")
    fx, fy, cx, cy = parse_numbers(camera, "intrinsics", 4)
    coefficients = parse_numbers(camera, "distortion_coeffs")
    model = str(camera.get("distortion_model", "radtan")) if coefficients else "none"
    return CameraModel(fx, fy, cx, cy, model, coefficients)


def _kalibr_pose(cameras: list[dict[str, Any]]) -> Array:
    """T_left_right (4, 4) of cam0 and cam1."""
    if "T_cn_cnm1" in cameras[1]:
        return se3.inverse(parse_pose(cameras[1]["T_cn_cnm1"], "T_cn_cnm1"))
    left, right = (parse_pose(camera.get("T_cam_imu"), "T_cn_cnm1 or T_cam_imu") for camera in cameras)
    return left @ se3.inverse(right)


def _from_orb_slam(path: Path, table: Table) -> CameraToml | None:
    names = [name for name in ("Camera1", "Camera", "Camera2") if f"{name}.fx" in table]
    if not names:
        return None
    left, *others = (_orb_slam_model(table, name) for name in names)
    width, height = (int(parse_numbers(table, f"Camera.{n}", 1)[0]) if f"Camera.{n}" in table else 0 for n in _SIZE)
    fps = parse_numbers(table, "Camera.fps", 1)[0] if "Camera.fps" in table else None
    factors = [name for name in ("RGBD.DepthMapFactor", "DepthMapFactor") if name in table]
    depth_scale = parse_numbers(table, factors[0], 1)[0] if factors else None
    if depth_scale is not None and depth_scale <= 0:
        raise ValueError(f"expected {factors[0]} above 0, found {depth_scale:g}")
    size = (width, height) if width and height else (0, 0)
    camera = CameraToml(path, left, fps=fps, size=size, depth_scale=depth_scale)
    pose = next((table[name] for name in ("Stereo.T_c1_c2", "Tlr") if name in table), None)
    if pose is not None:
        numbers = _numbers_of(pose, "Stereo.T_c1_c2")
        T = parse_pose([*numbers, *(0, 0, 0, 1)] if len(numbers) == 3 * 4 else numbers, "Stereo.T_c1_c2")
        return replace(camera, right_camera=RightCamera(others[0] if others else left, T))
    rectified = _from_rectified(path, table)
    if rectified is not None:
        return replace(rectified, fps=fps)
    if "Stereo.b" in table:
        return replace(camera, baseline_m=parse_numbers(table, "Stereo.b", 1)[0])
    # With a depth camera, bf is only a scale of its depth.
    is_pair = "Camera.bf" in table and not any(name.startswith(("DepthMap", "RGBD.")) for name in table)
    return replace(camera, baseline_m=parse_numbers(table, "Camera.bf", 1)[0] / left.fx) if is_pair else camera


def _orb_slam_model(table: Table, name: str) -> CameraModel:
    fx, fy, cx, cy = (parse_numbers(table, f"{name}.{key}", 1)[0] for key in ("fx", "fy", "cx", "cy"))
    kind = str(table.get("Camera.type", "PinHole"))
    keys = ("k1", "k2", "k3", "k4") if kind in _ORB_SLAM_MODELS else ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    found = [parse_numbers(table, f"{name}.{key}", 1)[0] if f"{name}.{key}" in table else None for key in keys]
    if not any(value is not None for value in found):
        return CameraModel(fx, fy, cx, cy)
    coefficients = tuple(value or 0.0 for value in found)
    while len(coefficients) > _MIN_COEFFICIENTS and found[len(coefficients) - 1] is None:
        coefficients = coefficients[:-1]
    return CameraModel(fx, fy, cx, cy, _ORB_SLAM_MODELS.get(kind, "radtan"), coefficients)


def _from_opencv(path: Path, table: Table) -> CameraToml | None:
    """One camera or a pair by matrices in OpenCV's notation."""
    pair = [_opencv_model(table, side) for side in _SIDES]
    if pair[0] is None or pair[1] is None:
        model = _opencv_model(table, ("",))
        return None if model is None else CameraToml(path, model, size=_opencv_size(table))
    rectified = _from_rectified(path, table)
    R, t = (
        _matrix(table, ("r", "rotation", "rotationmatrix", "rmat"), 9),
        _matrix(table, ("t", "translation", "translationvector", "tvec"), 3),
    )
    if t is None and rectified is not None:
        return rectified
    if t is None:
        raise ValueError("expected R and T, the pose of the right camera beside M1 and M2, found none")
    T_right_left = se3.pose(np.eye(3) if R is None else R.reshape(3, 3), t)
    T = se3.inverse(parse_pose(T_right_left, "R, T"))
    return CameraToml(path, pair[0], right_camera=RightCamera(pair[1], T), size=_opencv_size(table))


def _from_rectified(path: Path, table: Table) -> CameraToml | None:
    """A pair by the rotations R1, R2 and projections P1, P2 that rectify it; None if they are not all there."""
    models = [_opencv_model(table, side) for side in _SIDES]
    R = [_matrix(table, _named(_R_NAMES, side), 9) for side in _SIDES]
    P = [_matrix(table, _named(_P_NAMES, side), 12) for side in _SIDES]
    if models[0] is None or models[1] is None or any(m is None for m in (*R, *P)):
        return None
    R_view_left, R_view_right = (np.asarray(m).reshape(3, 3) for m in R)
    offsets = [-float(p[3] / p[0]) for p in P if p is not None and p[0] > 0]
    if len(offsets) < len(P):
        raise ValueError("expected positive focal lengths in P1 and P2, found others")
    to_right = np.array([offsets[1] - offsets[0], 0.0, 0.0])
    T = parse_pose(se3.pose(R_view_left.T @ R_view_right, R_view_left.T @ to_right), "R1, R2")
    return CameraToml(path, models[0], right_camera=RightCamera(models[1], T), size=_opencv_size(table))


def _ros_pair(tables: Mapping[Path, Table]) -> CameraToml | None:
    """The pair of the files left.yaml and right.yaml that ROS's camera_calibration writes; None if there is none."""
    sides: dict[str, list[Table]] = {"left": [], "right": []}
    for file, table in tables.items():
        for side in sides:
            if side in file.stem.lower() and "camera_matrix" in table and "projection_matrix" in table:
                sides[side].append(table)
    if [len(found) for found in sides.values()] != [1, 1]:
        return None
    both = {f"{short}{k + 1}": sides[side][0].get(n) for k, side in enumerate(sides) for n, short in _ROS_NAMES.items()}
    path = next(file for file in tables if "left" in file.stem.lower())
    shared = {n: sides["left"][0].get(n) for n in ("distortion_model", "image_width", "image_height")}
    return _from_rectified(path, {n: v for n, v in (both | shared).items() if v is not None})


def _has_camera(table: Table) -> bool:
    return any(_matrix(table, _named(_K_NAMES, side), 9) is not None for side in (*_SIDES, ("",)))


def _opencv_model(table: Table, side: tuple[str, ...]) -> CameraModel | None:
    K = _matrix(table, _named(_K_NAMES, side), 9)
    if K is None:
        return None
    plain = _plain(table)
    D = next((name for name in _named(_D_NAMES, side) if name in plain), None)
    coefficients = () if D is None else _numbers_of(plain[D], D)
    is_fisheye = str(_plain(table).get("fisheyemodel", "0")).lower() in ("1", "true")
    model = "fisheye" if is_fisheye else str(_plain(table).get("distortionmodel", "plumb_bob"))
    if not any(coefficients) and model not in ("fisheye", "equidistant"):
        model, coefficients = "none", ()
    return CameraModel(float(K[0]), float(K[4]), float(K[2]), float(K[5]), model, coefficients)


def _opencv_size(table: Table) -> Size:
    plain = _plain(table)
    try:
        if "imagesize" in plain:
            width, height = _numbers_of(plain["imagesize"], "image_size")
        else:
            width, height = float(plain["imagewidth"]), float(plain["imageheight"])
        return int(width), int(height)
    except (KeyError, TypeError, ValueError, OverflowError):
        return 0, 0


def _named(patterns: tuple[str, ...], sides: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(pattern.format(side) for side in sides for pattern in patterns)


def _plain(table: Table) -> dict[str, Any]:
    """The table with names without case and punctuation."""
    return {re.sub(r"[^a-z0-9]", "", name.lower()): value for name, value in table.items()}


def _matrix(table: Table, names: tuple[str, ...], count: int) -> Array | None:
    """Numbers (count,) of the first of some matrices; None if there is none: other files may use the same names."""
    plain = _plain(table)
    for name in names:
        try:
            numbers = _numbers_of(plain.get(name), name)
        except ValueError:
            continue
        if len(numbers) == count:
            return np.array(numbers)
    return None


def parse_numbers(table: Table, name: str, count: int | None = None) -> tuple[float, ...]:
    """The finite numbers under a name; none are missing if a count is given.

    Raises:
        ValueError: there are others, or another count.
    """
    numbers = _numbers_of(table.get(name, [] if count is None else None), name)
    if count is not None and len(numbers) != count:
        raise ValueError(f"expected {count} numbers {name}, found {len(numbers)}")
    return numbers


def _numbers_of(value: Any, name: str) -> tuple[float, ...]:
    """The numbers of a number, a list, nested lists, or a matrix of OpenCV."""
    data = value.get("data") if isinstance(value, dict) else value
    try:
        numbers = np.array(data, np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        numbers = np.array([np.nan])
    if data is None or not np.isfinite(numbers).all():
        raise ValueError(f"expected a list of numbers {name}, found {str(value)[:60]}") from None
    return tuple(numbers.tolist())
