"""Datasets of a custom camera: folders of images or video files, with a calibration in `camera.toml`.

`{camera.toml, *.png}` or `{camera.toml, left/*.png, right/*.png}`; video files may replace the folders. `times.txt`
beside the images holds their times, seconds, if their rate is not constant; names that are dates in seconds or
nanoseconds are times too. The `camera.toml` of a single video is in its folder.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.datasets.camera_toml import CAMERA_TOML, CameraToml, read_camera_toml
from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.image_sequence import (
    IMAGE_SUFFIXES,
    ImageSequence,
    check_one_camera,
    list_images,
    open_image_folder,
    read_times,
    times_from_names,
)
from slam.datasets.formats.recording import (
    CameraStream,
    ImageDataset,
    LeftImages,
    RawRecording,
    RectifiedDataset,
    UncalibratedImages,
    build_dataset,
    read_ground_truth,
    rectify_left,
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
_MAX_STRAY_IMAGES = 9  # beside folders of images or videos: previews and plots, no recording
_MAX_SHOWN = 6  # names in an error message
# Steps of a video without a gap, relative to their median; relative difference of two equal rates.
_MAX_EVEN_STEP, _MAX_RATE_DIFFERENCE = 1.5, 1e-3


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
    if not path.is_file():
        raise DataError(
            f"{path}: expected the calibration of the camera, found none; write it: fx, fy, cx, cy, and baseline for a"
            " pair (docs/drives.md)"
        )
    settings = read_camera_toml(path)
    recording = _raw_recording(spec, settings)
    if not spec.left_only:
        return build_dataset(recording, settings.rectification)
    alone = replace(settings, right_camera=None, baseline_m=None)
    return build_dataset(recording, rectify_left(settings.rectification, alone.rectification))


def open_custom_camera_images(spec: DatasetSpec) -> ImageDataset:
    """Open the left camera's images; they are undistorted if there is a `camera.toml`.

    Raises:
        DataError: there are no images, or the `camera.toml` is invalid.
    """
    if camera_toml_path(spec.path).is_file():
        return LeftImages.of(open_custom_camera(replace(spec, left_only=True)))
    path = _find_cameras(spec.path)[0]
    if path is None:
        raise _no_camera_error(spec.path)
    if path == spec.path and path.is_dir():
        return open_image_folder(path, spec.fps)
    images = _open_images(path)
    times = _find_times(path, images, spec.fps)
    return UncalibratedImages(spec.path.absolute().name, images, times.seconds, remarks=times.remarks)


def _raw_recording(spec: DatasetSpec, settings: CameraToml) -> RawRecording:
    left, right = _cameras(spec.path, settings)
    remarks: tuple[str, ...] = ()
    if spec.left_only:
        right = None
    elif right is not None and not settings.is_pair:
        right, remarks = None, (f"{settings.path.name} has no baseline: the left camera alone is used",)
    elif right is None and settings.is_pair:
        remarks = (f"{settings.path.name} describes two cameras, there are images of one",)
    fps = spec.fps or settings.fps
    left_stream, right_stream = (open_stream(left, fps), None) if right is None else _open_pair(left, right, fps)
    return RawRecording(
        name=spec.path.absolute().name,
        left=left_stream,
        right=right_stream,
        ground_truth=None if settings.ground_truth is None else read_ground_truth(settings.ground_truth, left_stream),
        remarks=remarks,
    )


def _open_pair(left: Path, right: Path, fps: float | None) -> tuple[CameraStream, CameraStream]:
    """Open two cameras whose images are paired by time, or by number if their counts agree.

    Raises:
        DataError: a camera cannot be read, or nothing says which images belong together.
    """
    images = _open_images(left), _open_images(right)
    times = _find_times(left, images[0], fps), _find_times(right, images[1], fps)
    if all(isinstance(video, Video) and video.has_times for video in images):
        own = _find_times(left, images[0], None), _find_times(right, images[1], None)
        if fps is not None and not times[0].are_recorded:  # the rate of the user, the gaps of the videos
            own = tuple(_at_rate(time, fps * _median_step(own[0].seconds)) for time in own)  # type: ignore[assignment]
        times = own
        _check_gaps(left, right, own)
    elif not times[1].are_recorded and len(images[0]) != len(images[1]):
        # Without times of its own, one missing image would shift all later ones to the wrong partner.
        raise DataError(
            f"{right}: expected {len(images[0])} images as in {left.name}, found {len(images[1])}; copy it again, or"
            " use the left camera alone with --mono"
        )
    return _stream(left, images[0], times[0]), _stream(right, images[1], times[1])


def _at_rate(times: "ImageTimes", factor: float) -> "ImageTimes":
    return times if times.seconds is None else replace(times, seconds=times.seconds / factor)


def _median_step(seconds: Array | None) -> float:
    return 1.0 if seconds is None or len(seconds) < 2 else float(np.median(np.diff(seconds)))


def _check_gaps(left: Path, right: Path, times: tuple["ImageTimes", "ImageTimes"]) -> None:
    """Raise DataError if one of two videos has fewer images, but no gap and the same rate: nothing shows the missing."""
    seconds = [time.seconds for time in times if time.seconds is not None]
    steps = [np.diff(each) for each in seconds]
    if len(seconds) < 2 or len(seconds[0]) == len(seconds[1]) or min(map(len, steps)) == 0:
        return
    medians = [float(np.median(step)) for step in steps]
    are_even = all(step.max() < _MAX_EVEN_STEP * median for step, median in zip(steps, medians, strict=True))
    if are_even and abs(medians[0] / medians[1] - 1) < _MAX_RATE_DIFFERENCE:
        raise DataError(
            f"{right}: expected {len(seconds[0])} images as in {left.name}, found {len(seconds[1])}, and no gap in the"
            " times that shows which are missing; cut both videos to the same images, or use --mono"
        )


def _cameras(path: Path, settings: CameraToml) -> tuple[Path, Path | None]:
    """Folders or video files of the left and the right camera: those that the settings name, else the usual ones."""
    found = _find_cameras(path)
    left = _find_by_name(settings, settings.left) if settings.left else found[0]
    if left is None:
        raise _no_camera_error(path)
    return left, settings.path.parent / settings.right if settings.right else found[1]


def _find_by_name(settings: CameraToml, name: str) -> Path:
    path = settings.path.parent / name
    if not (is_video(path) or list_images(path)):
        raise DataError(f"{settings.path}: expected images or a video called {name}, found none; check the name")
    return path


def _no_camera_error(path: Path) -> DataError:
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


def _find_cameras(path: Path) -> tuple[Path | None, Path | None]:
    """Left and right camera by the usual names, else the only camera; a few pictures beside them are not a camera."""
    own = list_images(path)
    if path.is_file():
        return path, None
    others = [item for item in sorted(path.iterdir()) if is_video(item) or list_images(item)]
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
    return [item for item in sorted(folder.iterdir()) if is_video(item) or list_images(item)]


def open_stream(path: Path, fps: float | None) -> CameraStream:
    """Open a folder of images or a video file with its times.

    Args:
        path: folder or video file.
        fps: images per second, where there is no `times.txt`; None to use a video's own times.

    Raises:
        DataError: there are no images, or their times are unknown.
    """
    images = _open_images(path)
    return _stream(path, images, _find_times(path, images, fps))


def _stream(path: Path, images: ImageSequence | Video, times: "ImageTimes") -> CameraStream:
    if times.seconds is None:
        raise DataError(
            f"{path}: expected the times of {len(images)} images, found no times.txt; give --fps, or fps in"
            f" {CAMERA_TOML}"
        )
    return CameraStream(images, times.seconds, times.remarks)


def _open_images(path: Path) -> ImageSequence | Video:
    if path.suffix.lower() in VIDEO_SUFFIXES and not path.is_dir():
        return open_video(path)
    files = list_images(path)
    if not files:
        raise DataError(f"{path}: expected images or a video, found none; check the name")
    check_one_camera(files)
    return ImageSequence(path.absolute().name, files, None)


@dataclass(frozen=True)
class ImageTimes:
    """Times of the images of one camera.

    Attributes:
        seconds: (N,) increasing; None if they are unknown.
        remarks: notes for the user.
        are_recorded: whether they were recorded with the images; if not, images were counted at a constant rate.
    """

    seconds: Array | None
    remarks: tuple[str, ...] = ()
    are_recorded: bool = True


def _find_times(path: Path, images: ImageSequence | Video, fps: float | None) -> ImageTimes:
    """Times from `times.txt`, else from the frame rate, else from the video itself or the names of the images."""
    places = [path / "times.txt", path.parent / "times.txt"] if path.is_dir() else [path.with_suffix(".txt")]
    file = next((place for place in places if place.is_file()), None)
    if file is not None:
        return ImageTimes(*read_times(file, len(images)))
    if fps is not None:
        return ImageTimes(np.arange(len(images)) / fps, are_recorded=False)
    if isinstance(images, Video):
        return ImageTimes(images.timestamps, images.remarks, images.has_times)
    return ImageTimes(*times_from_names(images.files))
