"""Drives in ROS bags: which topics are the cameras, and what is known of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import StereoCamera
from slam.datasets.assembly import Eye, Recording, assemble, read_true_way
from slam.datasets.bag_file import Bag, open_topic, read_bag
from slam.datasets.bag_topics import Topics, choose_topics, info_of
from slam.datasets.camera_drive import CameraDrive
from slam.datasets.camera_file import NAME, CameraFile, read_camera_file
from slam.datasets.left_images import ImageRecording, RawImages, left_images
from slam.datasets.rectification import (
    NOMINAL_BASELINE,
    AsItIs,
    Rectification,
    Size,
    Straightened,
    View,
    rectify_alike,
)
from slam.datasets.ros_messages import Calibration
from slam.datasets.source import Source
from slam.datasets.stamped import check_increasing
from slam.errors import DataError

Array = NDArray[np.float64]


def open_bag(source: Source) -> CameraDrive:
    """Open a bag and check everything but the images themselves.

    Calibration comes from a `camera.toml` beside the bag where there is one, else from the bag's CameraInfo.

    Raises:
        DataError: one line that names the file, what was expected and found, and the remedy.
    """
    bag, settings = read_bag(source.path), _settings(source.path)
    topics = choose_topics(bag, wanted(source, settings))
    left = open_eye(bag.path, topics.left)
    right = None if topics.right is None else open_eye(bag.path, topics.right)
    remarks: tuple[str, ...] = ()
    if right is not None and not _is_pair(bag, topics, settings):
        right, remarks = None, ("neither CameraInfo nor camera.toml has a baseline: the left camera alone is used",)
    if settings is None:
        return assemble(
            Recording(source.path.stem, left, right, None, remarks), lambda size: _rectify(bag, topics, size)
        )
    truth = None if settings.ground_truth is None else read_true_way(settings.ground_truth, left)
    return assemble(Recording(source.path.stem, left, right, truth, remarks), settings.rectification)


def left_of_bag(source: Source) -> ImageRecording:
    """What the left camera saw, straightened where the bag or a `camera.toml` says how.

    Raises:
        DataError: there are no images, or the bag is damaged.
    """
    bag, settings = read_bag(source.path), _settings(source.path)
    topics = choose_topics(bag, wanted(source, settings))
    if settings is not None or info_of(bag, topics.left) is not None:
        return left_images(open_bag(replace(source, topics=(topics.left,))))
    eye = open_eye(bag.path, topics.left)
    return RawImages(source.path.stem, eye.images, eye.times)


def _settings(path: Path) -> CameraFile | None:
    """What stands in a `camera.toml` in the folder of a bag or beside it."""
    file = next((file for file in (path / NAME, path.parent / NAME) if file.is_file()), None)
    return None if file is None else read_camera_file(file)


def wanted(source: Source, settings: CameraFile | None) -> tuple[str, ...]:
    """Topics that somebody has named."""
    if source.topics or settings is None:
        return source.topics
    return tuple(topic for topic in (settings.left, settings.right) if topic)


def open_eye(path: Path, topic: str) -> Eye:
    """Open the images of a topic.

    Raises:
        DataError: they cannot be read, or their times do not increase.
    """
    images = open_topic(path, topic)
    check_increasing(Path(f"{path}, {topic}"), images.timestamps)
    return Eye(images, images.timestamps)


def _is_pair(bag: Bag, topics: Topics, settings: CameraFile | None) -> bool:
    if settings is not None:
        return settings.is_pair
    left, right = info_of(bag, topics.left), None if topics.right is None else info_of(bag, topics.right)
    if right is not None and left is not None and left.to_right > right.to_right:
        raise DataError(
            f"{bag.path}: expected the left camera, then the right one, found {topics.left} to the right of"
            f" {topics.right} by CameraInfo; swap them with --image-topic"
        )
    return right is not None and right.to_right != 0


def _rectify(bag: Bag, topics: Topics, size: Size) -> Rectification:
    left, right = _calibration(bag, topics.left), None if topics.right is None else info_of(bag, topics.right)
    try:
        _check_size(left, size)
        if not left.rectified:
            return rectify_alike(left.lens, size)
        paired = right is not None and right.to_right != 0
        baseline = right.to_right - left.to_right if right is not None and paired else NOMINAL_BASELINE
        fx, fy, cx, cy = map(float, left.P[[0, 1, 0, 1], [0, 1, 2, 2]])
        camera = StereoCamera(fx, fy, cx, cy, baseline, *size)
    except ValueError as error:
        raise DataError(f"{bag.path}: CameraInfo of {topics.left}: {error}; are left and right swapped?") from None
    view = _view(topics.left, left, camera)
    other = _view(topics.right, right, camera) if topics.right and right is not None else view
    R_camera_view = np.eye(3) if isinstance(view, AsItIs) else left.R_view_camera.T
    return Rectification(camera, view, other, se3.pose(R_camera_view, np.zeros(3)))


def _view(topic: str, info: Calibration, camera: StereoCamera) -> View:
    """What becomes of the images of a topic: nothing where its name says that it was done already."""
    turned = not np.allclose(info.R_view_camera, np.eye(3), atol=1e-6)
    changed = not info.lens.straight or turned or not np.allclose(info.lens.K, camera.K, atol=1e-3)
    if "rect" in topic or not changed:
        return AsItIs()
    return Straightened(info.lens.maps(info.R_view_camera, camera.K, (camera.width, camera.height)))


def _check_size(info: Calibration, size: Size) -> None:
    if info.size != size and info.size != (0, 0):
        raise ValueError(f"expected images of {info.size[0]} x {info.size[1]}, found {size[0]} x {size[1]}")


def _calibration(bag: Bag, topic: str) -> Calibration:
    info = info_of(bag, topic)
    if info is None:
        found = ", ".join([*bag.calibrations, *bag.refused]) or "none"
        raise DataError(f"{bag.path}: expected a CameraInfo for {topic}, found {found}; write {NAME} beside the bag")
    return info
