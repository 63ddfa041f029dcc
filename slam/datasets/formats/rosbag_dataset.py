"""Datasets in ROS bags: image topics become camera streams, CameraInfo or a `camera.toml` the rectification.

The topics of one camera or a pair are chosen by their names, the CameraInfo of each by its namespace.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import StereoCamera
from slam.datasets.camera_toml import CAMERA_TOML, CameraToml, read_camera_toml
from slam.datasets.dataset import DatasetSpec
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
from slam.datasets.formats.rosbag_file import Bag, CameraInfo, open_topic, read_bag
from slam.datasets.formats.timestamped_lists import check_increasing
from slam.datasets.rectification import (
    NOMINAL_BASELINE_M,
    IdentityMap,
    ImageMap,
    Rectification,
    Size,
    UndistortMap,
    rectify_parallel,
)
from slam.errors import DataError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CameraTopics:
    """The image topics of one camera or a pair.

    Attributes:
        left: topic of the left camera, or of the only camera.
        right: topic of the right camera, or None.
    """

    left: str
    right: str | None = None


def open_bag(spec: DatasetSpec) -> RectifiedDataset:
    """Open a bag and check everything but the images themselves.

    The calibration comes from a `camera.toml` beside the bag where there is one, else from the bag's CameraInfo.

    Raises:
        DataError: the bag is missing or damaged, the cameras cannot be chosen, or their calibration is unusable.
    """
    bag, settings = read_bag(spec.path), _find_settings(spec.path)
    topics = choose_topics(bag, _requested_topics(spec, settings))
    if spec.left_only:
        topics = CameraTopics(topics.left)
    left = open_stream(bag.path, topics.left)
    right = None if topics.right is None else open_stream(bag.path, topics.right)
    remarks: tuple[str, ...] = ()
    if right is not None and not _is_pair(bag, topics, settings):
        right, remarks = None, ("neither CameraInfo nor camera.toml has a baseline: the left camera alone is used",)
    recording = RawRecording(spec.path.stem, left, right, remarks=remarks)
    if settings is None:
        return build_dataset(recording, lambda size: _rectify(bag, topics, size))
    truth = None if settings.ground_truth is None else read_ground_truth(settings.ground_truth, left)
    return build_dataset(replace(recording, ground_truth=truth), settings.rectification)


def open_bag_images(spec: DatasetSpec) -> ImageDataset:
    """Open the left camera's images; they are undistorted if the bag or a `camera.toml` has a calibration.

    Raises:
        DataError: there are no images, or the bag is damaged.
    """
    bag, settings = read_bag(spec.path), _find_settings(spec.path)
    topics = choose_topics(bag, _requested_topics(spec, settings))
    if settings is not None or find_camera_info(bag, topics.left) is not None:
        return LeftImages.of(open_bag(replace(spec, topics=(topics.left,))))
    stream = open_stream(bag.path, topics.left)
    return UncalibratedImages(spec.path.stem, stream.images, stream.timestamps)


def _find_settings(path: Path) -> CameraToml | None:
    """Read the `camera.toml` in the folder of a bag or beside it; None if there is none."""
    file = next((file for file in (path / CAMERA_TOML, path.parent / CAMERA_TOML) if file.is_file()), None)
    return None if file is None else read_camera_toml(file)


def _requested_topics(spec: DatasetSpec, settings: CameraToml | None) -> tuple[str, ...]:
    """Topics that the command or else the `camera.toml` names; empty if neither does."""
    if spec.topics or settings is None:
        return spec.topics
    return tuple(topic for topic in (settings.left, settings.right) if topic)


def open_stream(path: Path, topic: str) -> CameraStream:
    """Open the images of a topic with their times.

    Raises:
        DataError: the images cannot be read, or their times do not increase.
    """
    images = open_topic(path, topic)
    check_increasing(Path(f"{path}, {topic}"), images.timestamps)
    return CameraStream(images, images.timestamps)


def _is_pair(bag: Bag, topics: CameraTopics, settings: CameraToml | None) -> bool:
    if settings is not None:
        return settings.is_pair
    left = find_camera_info(bag, topics.left)
    right = None if topics.right is None else find_camera_info(bag, topics.right)
    if right is not None and left is not None and left.offset_right_m > right.offset_right_m:
        raise DataError(
            f"{bag.path}: expected the left camera, then the right one, found {topics.left} to the right of"
            f" {topics.right} by CameraInfo; swap them with --image-topic"
        )
    return right is not None and right.offset_right_m != 0


def _rectify(bag: Bag, topics: CameraTopics, size: Size) -> Rectification:
    left = _require_camera_info(bag, topics.left)
    right = None if topics.right is None else find_camera_info(bag, topics.right)
    try:
        _check_size(left, size)
        if not left.has_rectification:
            return rectify_parallel(left.model, size)
        is_pair = right is not None and right.offset_right_m != 0
        baseline = right.offset_right_m - left.offset_right_m if right is not None and is_pair else NOMINAL_BASELINE_M
        fx, fy, cx, cy = map(float, left.P[[0, 1, 0, 1], [0, 1, 2, 2]])
        camera = StereoCamera(fx, fy, cx, cy, baseline, *size)
    except ValueError as error:
        raise DataError(f"{bag.path}: CameraInfo of {topics.left}: {error}; are left and right swapped?") from None
    left_map = _image_map(topics.left, left, camera)
    right_map = _image_map(topics.right, right, camera) if topics.right and right is not None else left_map
    R_camera_view = np.eye(3) if isinstance(left_map, IdentityMap) else left.R_view_camera.T
    return Rectification(camera, left_map, right_map, se3.pose(R_camera_view, np.zeros(3)))


def _image_map(topic: str, info: CameraInfo, camera: StereoCamera) -> ImageMap:
    """Map of the images of a topic; the identity if its name says that they are rectified already (image_rect)."""
    is_rotated = not np.allclose(info.R_view_camera, np.eye(3), atol=1e-6)
    differs = not info.model.is_pinhole or is_rotated or not np.allclose(info.model.K, camera.K, atol=1e-3)
    if "rect" in topic or not differs:
        return IdentityMap()
    return UndistortMap(info.model.undistort_maps(info.R_view_camera, camera.K, (camera.width, camera.height)))


def _check_size(info: CameraInfo, size: Size) -> None:
    if info.size != size and info.size != (0, 0):
        raise ValueError(f"expected images of {info.size[0]} x {info.size[1]}, found {size[0]} x {size[1]}")


def _require_camera_info(bag: Bag, topic: str) -> CameraInfo:
    info = find_camera_info(bag, topic)
    if info is None:
        found = ", ".join([*bag.camera_infos, *bag.rejected]) or "none"
        raise DataError(
            f"{bag.path}: expected a CameraInfo for {topic}, found {found}; write {CAMERA_TOML} beside the bag"
        )
    return info


def choose_topics(bag: Bag, requested: tuple[str, ...]) -> CameraTopics:
    """Return the requested topics, else the only camera, else the only pair by the usual names.

    Raises:
        DataError: there are no images, or the choice is ambiguous.
    """
    if requested:
        return CameraTopics(*requested)
    topics = _usable(tuple(bag.image_counts))
    if len(topics) == 1:
        return CameraTopics(topics[0])
    rectified = tuple(topic for topic in topics if "rect" in topic)
    for candidates in (rectified, topics):
        pairs = [pair for left in candidates if (pair := _pair_of(left, candidates)) is not None]
        if len(pairs) == 1:
            return pairs[0]
    found = ", ".join(f"{topic} ({count})" for topic, count in bag.image_counts.items()) or "no images"
    raise DataError(
        f"{bag.path}: expected one camera or a left and a right one, found {found}; choose with --image-topic"
    )


def _usable(topics: tuple[str, ...]) -> tuple[str, ...]:
    """Topics without depth images and without compressed copies of other topics."""
    grey = (topic for topic in topics if "depth" not in topic.lower())
    return tuple(topic for topic in grey if topic.rsplit("/", 1)[0] not in topics)


def _pair_of(left: str, topics: tuple[str, ...]) -> CameraTopics | None:
    """The pair of topics whose names differ only in left and right, or in 0 and 1; None if there is none."""
    for left_word, right_word in (("left", "right"), ("infra1", "infra2"), ("cam0", "cam1"), ("camera0", "camera1")):
        right = left.replace(left_word, right_word)
        if right != left and right in topics:
            return CameraTopics(left, right)
    return None


def find_camera_info(bag: Bag, topic: str) -> CameraInfo | None:
    """Find the CameraInfo in the namespace of an image topic: /left/camera_info for /left/image_raw; else None."""
    namespace = topic.rsplit("/", 1)[0]
    while namespace:
        if f"{namespace}/camera_info" in bag.camera_infos:
            return bag.camera_infos[f"{namespace}/camera_info"]
        namespace = namespace.rsplit("/", 1)[0]
    only = list(bag.camera_infos.values())
    return only[0] if len(only) == 1 else bag.camera_infos.get("/camera_info")
