"""Datasets of a custom camera: folders of images or video files, with a calibration in `camera.toml`.

`{camera.toml, *.png}` or `{camera.toml, left/*.png, right/*.png}`; video files may replace the folders. `times.txt`
beside the images holds their times, seconds, if their rate is not constant. The `camera.toml` of a single video is in
its folder.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.datasets.calibration_yaml import find_calibration
from slam.datasets.camera_toml import CAMERA_TOML, CameraToml
from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.image_sequence import ImageSequence, list_images, open_image_sequence, read_times
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
from slam.datasets.video import VIDEO_SUFFIXES, Video, is_video, open_video
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
        raise DataError(
            f"{path}: expected the calibration of the camera, found none; write it: fx, fy, cx, cy, and baseline for a"
            " pair (docs/drives.md)"
        )
    return build_dataset(_raw_recording(spec, settings), settings.rectification)


def open_custom_camera_images(spec: DatasetSpec) -> ImageDataset:
    """Open the left camera's images; they are undistorted if there is a calibration.

    Raises:
        DataError: there are no images, or the calibration is invalid.
    """
    if find_calibration(camera_toml_path(spec.path).parent) is not None:
        return LeftImages.of(open_custom_camera(spec))
    if list_images(spec.path):
        return open_image_sequence(spec.path, fps=spec.fps)
    path = _find_cameras(spec.path)[0]
    if path is None:
        raise _no_camera_error(spec.path)
    images = open_video(path) if is_video(path) else _image_folder(path)
    times = _find_times(path, images, spec.fps)
    return UncalibratedImages(spec.path.absolute().name, images, times)


def _raw_recording(spec: DatasetSpec, settings: CameraToml) -> RawRecording:
    left, right = _cameras(spec.path, settings)
    remarks = settings.remarks
    if right is not None and not settings.is_pair:
        right, remarks = (
            None,
            (
                *remarks,
                f"{settings.path.name} has no baseline: the left camera alone is used",
            ),
        )
    elif right is None and settings.is_pair:
        remarks = (
            *remarks,
            f"{settings.path.name} describes two cameras, there are images of one",
        )
    fps = spec.fps or settings.fps
    left_stream = open_stream(left, fps)
    return RawRecording(
        name=spec.path.absolute().name,
        left=left_stream,
        right=None if right is None else _open_right_stream(right, fps, left.name, len(left_stream.timestamps)),
        ground_truth=None if settings.ground_truth is None else read_ground_truth(settings.ground_truth, left_stream),
        remarks=remarks,
    )


def _open_right_stream(path: Path, fps: float | None, left_name: str, left_count: int) -> CameraStream:
    stream = open_stream(path, fps)
    count, has_times = len(stream.timestamps), not path.is_dir() or (path / "times.txt").is_file()
    # Without times of its own, one missing image would shift all later ones to the wrong partner.
    if not has_times and count != left_count:
        raise DataError(f"{path}: expected {left_count} images as in {left_name}, found {count}; copy it again")
    return stream


def _cameras(path: Path, settings: CameraToml) -> tuple[Path, Path | None]:
    """Folders or video files of the left and the right camera: those that the settings name, else the usual ones."""
    found = _find_cameras(path)
    left = _find_by_name(settings, settings.left) if settings.left else found[0]
    right = _find_by_name(settings, settings.right) if settings.right else found[1]
    if left is None:
        raise _no_camera_error(path)
    return left, right


def _find_by_name(settings: CameraToml, name: str) -> Path:
    path = settings.path.parent / name
    if not (is_video(path) or list_images(path)):
        raise DataError(f"{settings.path}: expected images or a video called {name}, found none; check the name")
    return path


def _no_camera_error(path: Path) -> DataError:
    names = ", ".join(pair[0] for pair in PAIR_NAMES)
    return DataError(
        f"{path}: expected images, one video, or a folder or video called {names}, found none; name it as left in"
        f" {CAMERA_TOML}"
    )


def _find_cameras(path: Path) -> tuple[Path | None, Path | None]:
    if path.is_file() or list_images(path):
        return path, None
    named = {item.stem if is_video(item) else item.name: item for item in _list_media(path)}
    for left, right in PAIR_NAMES:
        if left in named:
            return named[left], named.get(right)
    return (next(iter(named.values())), None) if len(named) == 1 else (None, None)


def _list_media(folder: Path) -> list[Path]:
    """List the video files and the folders of images in a folder; the folder itself if it contains images."""
    if list_images(folder):
        return [folder]
    return [item for item in sorted(folder.iterdir()) if is_video(item) or list_images(item)]


def open_stream(path: Path, fps: float | None) -> CameraStream:
    """Open a folder of images or a video file with its times.

    Args:
        path: folder or video file.
        fps: images per second, where there is no `times.txt`; None to use a video's own times.

    Raises:
        DataError: there are no images, or their times are unknown.
    """
    images = open_video(path) if path.suffix.lower() in VIDEO_SUFFIXES else _image_folder(path)
    times = _find_times(path, images, fps)
    if times is None:
        raise DataError(
            f"{path}: expected the times of {len(images)} images, found no times.txt; give --fps, or fps in"
            f" {CAMERA_TOML}"
        )
    return CameraStream(images, times)


def _image_folder(folder: Path) -> ImageSequence:
    files = list_images(folder)
    if not files:
        raise DataError(f"{folder}: expected images or a video, found none; check the name")
    return ImageSequence(folder.absolute().name, files, None)


def _find_times(path: Path, images: ImageSequence | Video, fps: float | None) -> Array | None:
    """Times (N,) from `times.txt`, else from the frame rate, else from the video itself; else None."""
    places = [path / "times.txt", path.parent / "times.txt"] if path.is_dir() else [path.with_suffix(".txt")]
    file = next((place for place in places if place.is_file()), None)
    if file is not None:
        return read_times(file, len(images))
    if fps is not None:
        return np.arange(len(images)) / fps
    return images.timestamps
