"""Drives of one's own camera: folders of images or video files, and what is known of the camera in `camera.toml`.

`{camera.toml, *.png}` or `{camera.toml, left/*.png, right/*.png}`, with videos in the place of folders just as well;
`times.txt` beside the images, seconds, where they were not taken at an even rate. A video file alone has its
`camera.toml` in the same folder.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.datasets.assembly import Eye, Recording, assemble, read_true_way
from slam.datasets.camera_drive import CameraDrive
from slam.datasets.camera_file import NAME, CameraFile, read_camera_file
from slam.datasets.images import ImageSequence, images_in, open_images, read_times
from slam.datasets.left_images import ImageRecording, RawImages, left_images
from slam.datasets.source import Source
from slam.datasets.video import SUFFIXES, Video, is_video, open_video
from slam.errors import DataError

Array = NDArray[np.float64]

# What people call the folders or videos of a left and a right camera.
PAIRS = (("left", "right"), ("cam0", "cam1"), ("image_0", "image_1"), ("image_left", "image_right"), ("cam_l", "cam_r"))


def camera_file_of(path: Path) -> Path:
    """Where the `camera.toml` of a folder or of a video file lies."""
    return (path if path.is_dir() else path.parent) / NAME


def is_described(path: Path) -> bool:
    """Whether a path is a folder or a video file with a `camera.toml`."""
    return camera_file_of(path).is_file() and (path.is_dir() or is_video(path))


def is_own_camera(path: Path) -> bool:
    """Whether a path is a video file, or a folder with images or videos in it."""
    return is_video(path) or (path.is_dir() and bool(_media(path)))


def open_own_camera(source: Source) -> CameraDrive:
    """Open a drive and check everything but the images themselves.

    Raises:
        DataError: one line that names the file, what was expected and found, and the remedy.
    """
    path = camera_file_of(source.path)
    if not path.is_file():
        raise DataError(
            f"{path}: expected the calibration of the camera, found none; write it: fx, fy, cx, cy, and baseline for a"
            " pair (docs/drives.md)"
        )
    settings = read_camera_file(path)
    return assemble(_recording(source, settings), settings.rectification)


def left_of_own_camera(source: Source) -> ImageRecording:
    """What the left camera saw, straightened where a `camera.toml` says how.

    Raises:
        DataError: there are no images, or they and the `camera.toml` do not fit.
    """
    if camera_file_of(source.path).is_file():
        return left_images(open_own_camera(source))
    if images_in(source.path):
        return open_images(source.path, fps=source.fps)
    path = _found(source.path)[0]
    if path is None:
        raise _no_camera(source.path)
    images = open_video(path) if is_video(path) else _image_folder(path)
    times = _known_times(path, images, source.fps)
    return RawImages(source.path.absolute().name, images, times)


def _recording(source: Source, settings: CameraFile) -> Recording:
    left, right = _cameras(source.path, settings)
    remarks: tuple[str, ...] = ()
    if right is not None and not settings.is_pair:
        right, remarks = None, (f"{settings.path.name} has no baseline: the left camera alone is used",)
    elif right is None and settings.is_pair:
        remarks = (f"{settings.path.name} describes two cameras, there are images of one",)
    rate = source.fps or settings.fps
    eye = open_eye(left, rate)
    other = None if right is None else open_eye(right, rate)
    if right is not None and other is not None and right.is_dir() and not (right / "times.txt").is_file():
        _check_count(right, len(other.times), left, len(eye.times))
    return Recording(
        name=source.path.absolute().name,
        left=eye,
        right=other,
        truth=None if settings.ground_truth is None else read_true_way(settings.ground_truth, eye),
        remarks=remarks,
    )


def _check_count(right: Path, found: int, left: Path, expected: int) -> None:
    # without times of its own, one image too few would put all later ones to the wrong partner
    if found != expected:
        raise DataError(f"{right}: expected {expected} images as in {left.name}, found {found}; copy it again")


def _cameras(path: Path, settings: CameraFile) -> tuple[Path, Path | None]:
    """Folders or video files of the left and the right camera."""
    found = _found(path)
    left = _named(settings, settings.left) if settings.left else found[0]
    right = _named(settings, settings.right) if settings.right else found[1]
    if left is None:
        raise _no_camera(path)
    return left, right


def _named(settings: CameraFile, name: str) -> Path:
    path = settings.path.parent / name
    if not (is_video(path) or images_in(path)):
        raise DataError(f"{settings.path}: expected images or a video called {name}, found none; check the name")
    return path


def _no_camera(path: Path) -> DataError:
    names = ", ".join(pair[0] for pair in PAIRS)
    return DataError(
        f"{path}: expected images, one video, or a folder or video called {names}, found none; name it as left in"
        f" {NAME}"
    )


def _found(path: Path) -> tuple[Path | None, Path | None]:
    if path.is_file() or images_in(path):
        return path, None
    named = {item.stem if is_video(item) else item.name: item for item in _media(path)}
    for left, right in PAIRS:
        if left in named:
            return named[left], named.get(right)
    return (next(iter(named.values())), None) if len(named) == 1 else (None, None)


def _media(folder: Path) -> list[Path]:
    """Video files, and folders with images, in a folder; the folder itself where it holds images."""
    if images_in(folder):
        return [folder]
    return [item for item in sorted(folder.iterdir()) if is_video(item) or images_in(item)]


def open_eye(path: Path, rate: float | None) -> Eye:
    """Open a folder of images or a video file.

    Args:
        path: of it.
        rate: images a second, where no `times.txt` says more; None to take a video's own times.

    Raises:
        DataError: there are no images, or no times.
    """
    images = open_video(path) if path.suffix.lower() in SUFFIXES else _image_folder(path)
    times = _known_times(path, images, rate)
    if times is None:
        raise DataError(
            f"{path}: expected the times of {len(images)} images, found no times.txt; give --fps, or fps in {NAME}"
        )
    return Eye(images, times)


def _image_folder(folder: Path) -> ImageSequence:
    files = images_in(folder)
    if not files:
        raise DataError(f"{folder}: expected images or a video, found none; check the name")
    return ImageSequence(folder.absolute().name, files, None)


def _known_times(path: Path, images: ImageSequence | Video, rate: float | None) -> Array | None:
    """Of a file beside the images, else of a rate, else of a video; else None."""
    places = [path / "times.txt", path.parent / "times.txt"] if path.is_dir() else [path.with_suffix(".txt")]
    file = next((place for place in places if place.is_file()), None)
    if file is not None:
        return read_times(file, len(images))
    if rate is not None:
        return np.arange(len(images)) / rate
    return images.timestamps
