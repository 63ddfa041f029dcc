"""Datasets in the layout of TUM RGB-D (Sturm et al., IROS 2012), and what the field writes in its style.

`[NAME/]{rgb.txt, rgb/<seconds>.png, depth.txt, depth/<seconds>.png, groundtruth.txt}`; OpenLORIS-Scene (Shi et al.,
ICRA 2020) calls the lists `color.txt` and `aligned_depth.txt`. Recordings for ORB-SLAM and ICL-NUIM have one list of
both, `associations.txt`. The layout does not include a calibration: it is read from a `camera.toml` beside the list,
taken from the benchmark's cameras by the name of the sequence, or read from a YAML file of another tool. TUM's depth is
corrected already: its scale is 5000 with all its cameras.

ICL-NUIM (Handa et al., ICRA 2014) is rendered with y up: its page of codes gives fy = -480. The images are upright, so
with y down fy is 480, and the poses are mirrored: T becomes S T S with S = diag(1, -1, 1, 1). Reports of users agree:
ETH3D/badslam issue 59, shichaoy/cube_slam issue 2, victorprad/InfiniTAM issue 65. Its lists count the images from 0,
its poses from 1, and there are 30 images in a second.
"""

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from slam.datasets.calibration_yaml import find_calibration
from slam.datasets.camera_toml import CAMERA_TOML, CameraToml, read_camera_toml
from slam.datasets.dataset import DatasetSpec, find_dataset
from slam.datasets.depth_units import MILLIMETRES, TUM_UNITS
from slam.datasets.distortion_models import CameraModel
from slam.datasets.formats.depth_images import DEPTH_UNUSED, DepthStream, open_depth_folder, read_depth_list
from slam.datasets.formats.ground_truth import GroundTruthTrajectory, read_timed_poses
from slam.datasets.formats.recording import (
    CameraStream,
    ImageDataset,
    LeftImages,
    RawRecording,
    RectifiedDataset,
    UncalibratedImages,
    build_dataset,
    read_ground_truth,
)
from slam.datasets.formats.timestamped_lists import SPACE_SEPARATED_SECONDS, read_cells, read_image_list
from slam.datasets.time_sync import short_name
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

ICL_NUIM = CameraModel(481.2, 480.0, 319.5, 239.5)  # with y down
_Y_DOWN = np.diag([1.0, -1.0, 1.0, 1.0])  # S, mirrors the y axis
_COUNTED_FPS = 30.0  # images per second where a list counts them: of the Kinect, and in ICL-NUIM


@dataclass(frozen=True)
class _Lists:
    """Names of the lists of a sequence, and the scale of its depth.

    Attributes:
        colour: list of the colour images.
        depth: list of the depth images.
        units_per_m: scale of the depth.
    """

    colour: str
    depth: str
    units_per_m: float


_TUM, _OPENLORIS = _Lists("rgb.txt", "depth.txt", TUM_UNITS), _Lists("color.txt", "aligned_depth.txt", MILLIMETRES)
_ASSOCIATIONS = ("associations.txt", "associate.txt", "associated.txt", "association.txt")
_OPENLORIS_REMARK = (
    "groundtruth.txt beside color.txt: if its poses are those of the robot's base, errors include the camera's place on"
    " the robot"
)


def is_tum_rgbd(folder: Path) -> bool:
    """Whether a folder is one sequence in this layout."""
    is_openloris = (folder / "color.txt").is_file() and (folder / "color").is_dir()
    return (folder / "rgb.txt").is_file() or is_openloris or _find_associations(folder) is not None


def _find_associations(folder: Path) -> Path | None:
    """The list of colour and depth images of a folder, by its name and a folder that it must have beside it."""
    has_images = any((folder / name).is_dir() for name in ("rgb", "color", "depth"))
    return next((folder / name for name in _ASSOCIATIONS if has_images and (folder / name).is_file()), None)


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
    colour = _read_color(folder, spec.fps or camera.fps)
    depth, trouble = (None, ()) if spec.left_only else _read_depth(folder, camera, colour)
    truth, poses_remarks = _read_truth(folder, colour)
    recording = RawRecording(
        folder.absolute().name, colour.stream, depth=depth, ground_truth=truth, remarks=(*trouble, *poses_remarks)
    )
    return build_dataset(recording, replace(camera, baseline_m=None, right_camera=None).rectification)


def open_tum_rgbd_images(spec: DatasetSpec) -> ImageDataset:
    """Open the colour images; they are undistorted if the camera is known.

    Raises:
        DataError: a file is missing, damaged or inconsistent with the others.
    """
    folder = _folder(spec)
    if _camera(folder) is not None:
        return LeftImages.of(open_tum_rgbd(replace(spec, left_only=True)))
    stream = _read_color(folder, spec.fps).stream
    return UncalibratedImages(folder.absolute().name, stream.images, stream.timestamps, remarks=stream.remarks)


def _folder(spec: DatasetSpec) -> Path:
    return find_dataset(spec.path, spec.sequence, is_tum_rgbd, "rgb.txt, color.txt or associations.txt")


def _camera(folder: Path) -> CameraToml | None:
    known, path = _known_camera(folder), folder / CAMERA_TOML
    if known is None:
        return find_calibration(folder)
    return read_camera_toml(path, lambda: CameraToml(path, known)) if path.is_file() else CameraToml(path, known)


def _known_camera(folder: Path) -> CameraModel | None:
    """Camera of a sequence of TUM RGB-D or ICL-NUIM, by its name or its file of poses."""
    place = re.search(r"freiburg([123])", folder.absolute().name)
    if place is not None:
        return FREIBURG[place.group(1)]
    return None if _find_numbered_poses(folder) is None else ICL_NUIM


def _find_numbered_poses(folder: Path) -> Path | None:
    """ICL-NUIM's file of poses."""
    return next(iter(sorted(folder.glob("*.gt.freiburg"))), None)


@dataclass(frozen=True)
class _ColorList:
    """The colour images of a sequence and the list that names them.

    Attributes:
        stream: the images.
        path: the list.
        columns: of the time, the colour image and the depth image in the list; the last is -1 in a list of colour.
        images_per_s: rate at which a list that counts the images has been read; 1 where it has their times.
    """

    stream: CameraStream
    path: Path
    columns: tuple[int, int, int]
    images_per_s: float = 1.0


def _read_color(folder: Path, fps: float | None) -> _ColorList:
    own = [folder / lists.colour for lists in (_TUM, _OPENLORIS) if (folder / lists.colour).is_file()]
    path = own[0] if own else _find_associations(folder)
    assert path is not None, "a folder that is_tum_rgbd"
    columns = (0, 1, -1) if own else _find_columns(path)
    images = read_image_list(path, folder, SPACE_SEPARATED_SECONDS, columns[:2])
    times, remarks = images.timestamps, images.remarks
    assert times is not None
    if own or len(times) < 2 or times[0] > len(times) or np.any(times % 1) or np.median(np.diff(times)) != 1:
        return _ColorList(CameraStream(images, times, remarks), path, columns)
    rate = fps or _COUNTED_FPS
    remarks += (f"{short_name(path)} counts the images: {rate:g} in a second are assumed; --fps gives another rate",)
    return _ColorList(CameraStream(images, times / rate, remarks), path, columns, rate)


def _find_columns(path: Path) -> tuple[int, int, int]:
    """Columns of the time, the colour image and the depth image in a list of both: either may come first."""
    first = read_cells(path, SPACE_SEPARATED_SECONDS, 4)[1][0]
    return (2, 3, 1) if "depth" in first[1].lower() and "depth" not in first[3].lower() else (0, 1, 3)


def _read_depth(folder: Path, camera: CameraToml, colour: _ColorList) -> tuple[DepthStream | None, tuple[str, ...]]:
    """Depth images of a sequence; None, with a remark, where they cannot be used."""
    lists = _OPENLORIS if colour.path.name == _OPENLORIS.colour else _TUM
    path = folder / (camera.depth or lists.depth)
    images = path if camera.depth else path.with_suffix("")
    scale = camera.depth_scale or lists.units_per_m
    try:
        if camera.depth is None and colour.columns[2] >= 0:
            columns = (colour.columns[0], colour.columns[2])
            stream = read_depth_list(colour.path, folder, SPACE_SEPARATED_SECONDS, columns, scale)
            return replace(stream, timestamps=stream.timestamps / colour.images_per_s, remarks=()), ()
        if path.is_file():
            return read_depth_list(path, folder, SPACE_SEPARATED_SECONDS, (0, 1), scale), ()
        if camera.depth is not None or images.is_dir():
            return open_depth_folder(images, colour.stream.timestamps, scale), ()
    except DataError as error:
        return None, (f"{error}; {DEPTH_UNUSED}",)
    if lists == _OPENLORIS and (folder / _TUM.depth).is_file():
        trouble = f"depth of {_TUM.depth} is not registered to the colour: {DEPTH_UNUSED}"
        return None, (f"{trouble}; unpack aligned_depth and {lists.depth}",)
    return None, ()


def _read_truth(folder: Path, colour: _ColorList) -> tuple[GroundTruthTrajectory | None, tuple[str, ...]]:
    """Measured poses of a sequence, if there are any, and a remark about what they may be."""
    path, numbered = folder / "groundtruth.txt", _find_numbered_poses(folder)
    if path.is_file():
        truth = read_ground_truth(path, colour.stream)
        return truth, (_OPENLORIS_REMARK,) if colour.path.name == _OPENLORIS.colour else ()
    if numbered is None or colour.columns[2] < 0:
        return None, ()
    truth = read_timed_poses(numbered, SPACE_SEPARATED_SECONDS, (4, 5, 6, 7))
    mirrored = _Y_DOWN @ truth.poses @ _Y_DOWN
    return replace(truth, timestamps=truth.timestamps / colour.images_per_s, poses=mirrored), ()
