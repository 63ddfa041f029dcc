"""Datasets of a custom camera: folders of images or video files, with a calibration in `camera.toml`.

`{camera.toml, *.png}` or `{camera.toml, left/*.png, right/*.png}`; video files may replace the folders. A depth camera
has a folder of depth images beside that of its colour images: `camera.toml` names it. `times.txt` beside the images
holds their times, seconds, if their rate is not constant; names that are dates in seconds or nanoseconds are times too.
The `camera.toml` of a single video is in its folder.

Some layouts of public recordings become readable by a `camera.toml`: they are recognised, and a message says what to
write.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.datasets.calibration_yaml import find_calibration
from slam.datasets.camera_toml import CAMERA_TOML, CameraToml
from slam.datasets.dataset import DatasetSpec, subfolders
from slam.datasets.formats.camera_streams import find_times, open_camera_images, open_pair, open_stream
from slam.datasets.formats.depth_images import open_depth_folder
from slam.datasets.formats.image_sequence import (
    IMAGE_SUFFIXES,
    list_images,
    open_image_folder,
)
from slam.datasets.formats.recording import (
    LEFT_ALONE,
    ImageDataset,
    LeftImages,
    RawRecording,
    RectifiedDataset,
    UncalibratedImages,
    build_dataset,
    read_ground_truth,
    rectify_left,
)
from slam.datasets.rectification import Rectification, Size
from slam.datasets.video import VIDEO_SUFFIXES, is_video
from slam.errors import DataError

Array = NDArray[np.float64]

# Usual names of the folders or videos of a left and a right camera.
PAIR_NAMES = (
    ("left", "right"),
    ("cam0", "cam1"),
    ("image_0", "image_1"),
    ("image_left", "image_right"),
    ("cam_l", "cam_r"),
)
_MAX_STRAY_IMAGES = 9  # beside folders of images or videos: previews and plots, no recording
_MAX_SHOWN = 6  # names in an error message


def camera_toml_path(path: Path) -> Path:
    """Path at which the `camera.toml` of a folder or a video file is expected."""
    return (path if path.is_dir() else path.parent) / CAMERA_TOML


def has_camera_toml(path: Path) -> bool:
    """Whether a path is a folder or a video file with a `camera.toml`."""
    return camera_toml_path(path).is_file() and (path.is_dir() or is_video(path))


def is_custom_camera(path: Path) -> bool:
    """Whether a path is a video file, or a folder with images or videos in it."""
    return is_video(path) or (path.is_dir() and bool(_list_media(path)))


def open_custom_camera(spec: DatasetSpec) -> RectifiedDataset:
    """Open a dataset and check all files but the images themselves.

    Raises:
        DataError: a file is missing, damaged or inconsistent with the others.
    """
    path = camera_toml_path(spec.path)
    settings = find_calibration(path.parent)
    if settings is None:
        known = describe_known_layout(spec.path)
        remedy = known or "write it: fx, fy, cx, cy, and baseline for a pair (docs/drives.md)"
        raise DataError(f"{path}: expected the calibration of the camera, found none; {remedy}")
    return build_dataset(_raw_recording(spec, settings), rectification_of(settings, spec.left_only))


def rectification_of(settings: CameraToml, left_only: bool) -> Callable[[Size], Rectification]:
    """Rectification of a camera file, for which nothing about the right camera matters if the left alone is used."""
    if not left_only:
        return settings.rectification
    return rectify_left(settings.rectification, replace(settings, right_camera=None, baseline_m=None).rectification)


def open_custom_camera_images(spec: DatasetSpec) -> ImageDataset:
    """Open the left camera's images; they are undistorted if there is a calibration.

    Raises:
        DataError: there are no images, or the calibration is invalid.
    """
    if find_calibration(camera_toml_path(spec.path).parent) is not None:
        return LeftImages.of(open_custom_camera(replace(spec, left_only=True)))
    path = _find_cameras(spec.path)[0]
    if path is None:
        raise _no_camera_error(spec.path)
    if path == spec.path and path.is_dir():
        return open_image_folder(path, spec.fps)
    images = open_camera_images(path)
    times = find_times(path, images, spec.fps)
    return UncalibratedImages(spec.path.absolute().name, images, times.seconds, remarks=times.remarks)


def _raw_recording(spec: DatasetSpec, settings: CameraToml) -> RawRecording:
    depth = None if spec.left_only or settings.depth is None else _find_depth(settings, settings.depth)
    left, right = _cameras(spec.path, settings)
    remarks = settings.remarks
    if spec.left_only:
        right = None
    elif right is not None and not settings.is_pair:
        alone = f"{settings.path.name} has no baseline: {LEFT_ALONE}"
        right, remarks = None, remarks if depth is not None else (*remarks, alone)
    elif right is None and settings.is_pair:
        remarks = (
            *remarks,
            f"{settings.path.name} describes two cameras, there are images of one",
        )
    fps = spec.fps or settings.fps
    left_stream, right_stream = (open_stream(left, fps), None) if right is None else open_pair(left, right, fps)
    times, scale = left_stream.timestamps, settings.depth_scale
    return RawRecording(
        name=spec.path.absolute().name,
        left=left_stream,
        right=right_stream,
        depth=None if depth is None else open_depth_folder(depth, times, scale),
        ground_truth=None if settings.ground_truth is None else read_ground_truth(settings.ground_truth, left_stream),
        remarks=remarks,
    )


def _cameras(path: Path, settings: CameraToml) -> tuple[Path, Path | None]:
    """Folders or video files of the left and the right camera: those that the settings name, else the usual ones."""
    found = _find_cameras(path, settings.depth)
    left = _find_by_name(settings, settings.left) if settings.left else found[0]
    if left is None:
        raise _no_camera_error(path)
    return left, settings.path.parent / settings.right if settings.right else found[1]


def _find_by_name(settings: CameraToml, name: str) -> Path:
    path = settings.path.parent / name
    if not (is_video(path) or list_images(path)):
        raise DataError(f"{settings.path}: expected images or a video called {name}, found none; check the name")
    return path


def _find_depth(settings: CameraToml, name: str) -> Path:
    path = settings.path.parent / name
    if not path.is_dir():
        raise DataError(f"{settings.path}: expected a folder of depth images called {name}, found none; check depth")
    return path


def _no_camera_error(path: Path) -> DataError:
    known = describe_known_layout(path)
    if known:
        return DataError(f"{path}: expected the images of a known camera, found {describe_contents(path)}; {known}")
    names = ", ".join(pair[0] for pair in PAIR_NAMES)
    return DataError(
        f"{path}: expected images, one video, or a folder or video called {names}, found {describe_contents(path)};"
        f" name it as left in {CAMERA_TOML}, or convert it (images: {_list(IMAGE_SUFFIXES)}; videos:"
        f" {_list(VIDEO_SUFFIXES)})"
    )


def _list(suffixes: Iterable[str]) -> str:
    return " ".join(sorted(suffixes))


def describe_contents(folder: Path) -> str:
    """Names of some folders and files of a folder, for error messages; of many files of one suffix, one."""
    shown = {item.name if item.is_dir() else item.suffix.lower(): item for item in sorted(folder.iterdir())}
    names = [f"{item.name}/" if item.is_dir() else item.name for item in shown.values() if item.name[0] != "."]
    return ", ".join(names[:_MAX_SHOWN]) + (", ..." if len(names) > _MAX_SHOWN else "") or "nothing"


def _find_cameras(path: Path, depth: str | None = None) -> tuple[Path | None, Path | None]:
    """Left and right camera by the usual names, else the only camera beside the depth images of a name.

    A few pictures beside folders of images are not a camera.
    """
    own = list_images(path)
    if path.is_file():
        return path, None
    others = [item for item in _list_media_in(path) if item.name != depth]
    named = {item.stem if is_video(item) else item.name: item for item in others}
    for left, right in PAIR_NAMES:
        if left in named and (is_video(named[left]) or len(list_images(named[left])) >= len(own)):
            return named[left], named.get(right)
    if own and (len(own) > _MAX_STRAY_IMAGES or not others):
        return path, None
    return (others[0], None) if len(others) == 1 else (None, None)


def _list_media(folder: Path) -> list[Path]:
    """List the video files and the folders of images in a folder; the folder itself if it contains images."""
    if list_images(folder):
        return [folder]
    return _list_media_in(folder)


def _list_media_in(folder: Path) -> list[Path]:
    return [item for item in sorted(folder.iterdir()) if is_video(item) or list_images(item)]


@dataclass(frozen=True)
class KnownLayout:
    """A layout and its remedy.

    Attributes:
        name: name of the data set.
        matches: whether a folder is one recording in this layout.
        remedy: what to write, and where; {folder} is the folder.
    """

    name: str
    matches: Callable[[Path], bool]
    remedy: str


def _has(*names: str) -> Callable[[Path], bool]:
    return lambda folder: all((folder / name).exists() for name in names)


LAYOUTS = (
    KnownLayout(
        "TartanAir",
        _has("image_left", "pose_left.txt"),
        "write {folder}/camera.toml with fx = 320, fy = 320, cx = 320, cy = 240, baseline = 0.25, fps = 10;"
        " pose_left.txt has other axes and is not read",
    ),
    KnownLayout(
        "TartanAir V2",
        _has("image_lcam_front"),
        "write {folder}/camera.toml with fx = 320, fy = 320, cx = 320, cy = 320, baseline = 0.25, fps = 10,"
        ' left = "image_lcam_front", right = "image_rcam_front"; the poses have other axes and are not read',
    ),
    KnownLayout(
        "4Seasons",
        _has("undistorted_images"),
        "write {folder}/undistorted_images/camera.toml with fx, fy, cx, cy and baseline from the undistorted_calib"
        " files, and name the folder undistorted_images: the times are in the names of its images",
    ),
    KnownLayout(
        "4Seasons",
        _has("distorted_images", "times.txt"),
        "unpack undistorted_images too, and name that folder with a camera.toml in it",
    ),
)


def describe_known_layout(path: Path) -> str:
    """Return the name of the layout of a folder, or of one directly below, and its remedy; an empty text if unknown."""
    for folder in (path, *subfolders(path)):
        layout = next((layout for layout in LAYOUTS if layout.matches(folder)), None)
        if layout is not None:
            return f"this is the layout of {layout.name}: {layout.remedy.format(folder=folder)}"
    return ""
