"""Streams of one or two cameras from folders of images and from video files, with their times."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.datasets.camera_toml import CAMERA_TOML
from slam.datasets.formats.image_sequence import (
    ImageSequence,
    check_one_camera,
    find_numbers,
    list_images,
    read_times,
    times_from_names,
)
from slam.datasets.formats.recording import CameraStream
from slam.datasets.time_sync import find_clock_unit, short_name
from slam.datasets.video import VIDEO_SUFFIXES, Video, open_video
from slam.errors import DataError

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

# Steps of a video without a gap, relative to their median; relative difference of two equal rates.
_MAX_EVEN_STEP, _MAX_RATE_DIFFERENCE = 1.5, 1e-3
_MAX_ALONE = 0.1  # share of images without a partner by number; more are two recordings, or a copy that failed


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


def open_stream(path: Path, fps: float | None) -> CameraStream:
    """Open a folder of images or a video file with its times.

    Args:
        path: folder or video file.
        fps: images per second, where there is no `times.txt`; None to use a video's own times.

    Raises:
        DataError: there are no images, or their times are unknown.
    """
    images = open_camera_images(path)
    return _stream(path, images, find_times(path, images, fps))


def _stream(path: Path, images: ImageSequence | Video, times: ImageTimes) -> CameraStream:
    if times.seconds is None:
        raise DataError(
            f"{path}: expected the times of {len(images)} images, found no times.txt; give --fps, or fps in"
            f" {CAMERA_TOML}"
        )
    return CameraStream(images, times.seconds, times.remarks)


def open_camera_images(path: Path) -> ImageSequence | Video:
    """Open the images of one camera, in a folder or a video file.

    Raises:
        DataError: there are none, or those of two cameras, or the video is damaged.
    """
    if path.suffix.lower() in VIDEO_SUFFIXES and not path.is_dir():
        return open_video(path)
    files = list_images(path)
    if not files:
        raise DataError(f"{path}: expected images or a video, found none; check the name")
    check_one_camera(files)
    return ImageSequence(path.absolute().name, files, None)


def find_times(path: Path, images: ImageSequence | Video, fps: float | None) -> ImageTimes:
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


def open_pair(left: Path, right: Path, fps: float | None) -> tuple[CameraStream, CameraStream]:
    """Open two cameras whose images are paired by time, or by number if their counts agree.

    Raises:
        DataError: a camera cannot be read, or nothing says which images belong together.
    """
    images = open_camera_images(left), open_camera_images(right)
    times = find_times(left, images[0], fps), find_times(right, images[1], fps)
    if all(isinstance(video, Video) and video.has_times for video in images):
        times = _own_times(times, find_times(left, images[0], None), find_times(right, images[1], None))
        _check_gaps(left, right, times)
    elif isinstance(images[0], ImageSequence) and isinstance(images[1], ImageSequence):
        times = _times_by_number((images[0], images[1]), times)
    if not times[1].are_recorded and len(images[0]) != len(images[1]):
        # Without times of its own, one missing image would shift all later ones to the wrong partner.
        raise DataError(
            f"{right}: expected {len(images[0])} images as in {left.name}, found {len(images[1])}; copy it again, or"
            " use the left camera alone with --mono"
        )
    return _stream(left, images[0], times[0]), _stream(right, images[1], times[1])


def _times_by_number(
    images: tuple[ImageSequence, ImageSequence], times: tuple[ImageTimes, ImageTimes]
) -> tuple[ImageTimes, ImageTimes]:
    """Times that pair the images of equal numbers, where order alone would pair them and a few numbers differ.

    Raises:
        DataError: there are equally many images, but their order and their numbers pair them differently.
    """
    left, right = (find_numbers(sequence.files) for sequence in images)
    first, second = (time.seconds for time in times)
    if left is None or right is None or first is None or second is None or _are_same_steps(left, right):
        return times
    if times[1].are_recorded and not np.array_equal(first, second):
        return times  # each camera has its own times
    alone = np.setxor1d(left, right)
    if times[1].are_recorded or len(alone) > _MAX_ALONE * (len(left) + len(right)):
        _refuse_first_difference(images, left, right)
        return times
    files = {**dict(zip(right, images[1].files, strict=True)), **dict(zip(left, images[0].files, strict=True))}
    remark = f"images are paired by the numbers in their names; {short_name(files[alone[0]])} is the first without"
    start, step_s = min(left[0], right[0]), _median_step(first) / _median_step(left)
    return ImageTimes((left - start) * step_s, (f"{remark} a partner",)), ImageTimes((right - start) * step_s)


def _are_same_steps(left: Numbers, right: Numbers) -> bool:
    """Whether two cameras have the same numbers, or counted in their own ways so that order alone pairs them."""
    if np.array_equal(left, right):
        return True
    has_common = len(np.intersect1d(left, right)) > 0
    return not has_common and (
        find_clock_unit(left.astype(float)) is not None or np.array_equal(np.diff(left), np.diff(right))
    )


def _refuse_first_difference(images: tuple[ImageSequence, ImageSequence], left: Numbers, right: Numbers) -> None:
    """Raise DataError if there are equally many images, of which two in the same place have different numbers."""
    if len(left) != len(right):
        return
    at = int(np.argmax(left != right))
    one, other = images[0].files[at], images[1].files[at]
    raise DataError(
        f"{other.parent}: expected an image of the number of {short_name(one)}, found {other.name} in its place; copy"
        " the missing images, or remove those without a partner"
    )


def _own_times(
    counted: tuple[ImageTimes, ImageTimes], left: ImageTimes, right: ImageTimes
) -> tuple[ImageTimes, ImageTimes]:
    """Times of a pair of videos: the gaps are those of the videos, the rate is that of the user if there is one."""
    if counted[0].are_recorded or counted[0].seconds is None or left.seconds is None or right.seconds is None:
        return left, right
    factor = _median_step(counted[0].seconds) / _median_step(left.seconds)
    return replace(left, seconds=left.seconds * factor), replace(right, seconds=right.seconds * factor)


def _median_step(seconds: Array | Numbers) -> float:
    return float(np.median(np.diff(seconds))) if len(seconds) > 1 else 1.0


def _check_gaps(left: Path, right: Path, times: tuple[ImageTimes, ImageTimes]) -> None:
    """Raise DataError if one of two videos of the same rate has fewer images, but no gap where they are missing."""
    seconds = [time.seconds for time in times if time.seconds is not None]
    steps = [np.diff(each) for each in seconds]
    if len(seconds) < 2 or len(seconds[0]) == len(seconds[1]) or min(map(len, steps)) == 0:
        return
    medians = [_median_step(each) for each in seconds]
    are_even = all(step.max() < _MAX_EVEN_STEP * median for step, median in zip(steps, medians, strict=True))
    if are_even and abs(medians[0] / medians[1] - 1) < _MAX_RATE_DIFFERENCE:
        raise DataError(
            f"{right}: expected {len(seconds[0])} images as in {left.name}, found {len(seconds[1])}, and no gap in the"
            " times that shows which are missing; cut both videos to the same images, or use --mono"
        )
