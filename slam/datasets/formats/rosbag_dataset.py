"""Datasets in ROS bags: image topics become camera streams, CameraInfo or a calibration file the rectification.

The topics of one camera or a pair are chosen by their names, the CameraInfo of each by its namespace.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from odometry import se3
from odometry.camera import StereoCamera
from slam.datasets.calibration_yaml import find_calibration
from slam.datasets.camera_toml import CAMERA_TOML, CameraToml
from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.custom_camera import rectification_of
from slam.datasets.formats.depth_images import DEPTH_UNUSED, DepthStream
from slam.datasets.formats.recording import (
    LEFT_ALONE,
    CameraStream,
    ImageDataset,
    LeftImages,
    RawRecording,
    RectifiedDataset,
    UncalibratedImages,
    build_dataset,
    read_ground_truth,
)
from slam.datasets.formats.rosbag_file import Bag, open_depth_topic, open_topics, read_bag, read_frame_id
from slam.datasets.formats.rosbag_messages import CameraInfo
from slam.datasets.formats.rosbag_topics import (
    CameraTopics,
    choose_depth,
    choose_topics,
    depth_topics,
    find_camera_info,
    find_info_topic,
    image_topic,
    is_rectified,
    is_registered,
    registered_topic,
)
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


def open_bag(spec: DatasetSpec) -> RectifiedDataset:
    """Open a bag and check everything but the images themselves.

    The calibration comes from a `camera.toml` beside the bag where there is one, else from the bag's CameraInfo, else
    from a YAML file beside the bag. A YAML file that names topics of the bag comes before CameraInfo.

    Raises:
        DataError: the bag is missing or damaged, the cameras cannot be chosen, or their calibration is unusable.
    """
    bag = read_bag(spec.path)
    settings = _find_settings(bag)
    topics = choose_topics(bag, _requested_topics(spec, bag, settings))
    if spec.left_only:
        topics = CameraTopics(topics.left)
    if settings is not None and settings.path.name != CAMERA_TOML and not _is_preferred(settings, bag, topics):
        settings = None
    is_pair = topics.right is not None and _is_pair(bag, topics, settings)
    used = topics if is_pair else CameraTopics(topics.left)
    left, *others = open_topics(bag.path, used.names, _used_infos(bag, used) if settings is None else {})
    depth, trouble = (None, ()) if spec.left_only or others else _open_depth(bag, used.left, settings)
    recording = RawRecording(
        spec.path.stem,
        CameraStream(left, left.timestamps),
        CameraStream(others[0], others[0].timestamps) if others else None,
        depth=depth,
        remarks=(
            *_remarks_of_choice(bag, topics, used),
            *(_remarks_of_infos(bag, used) if settings is None else settings.remarks),
            *left.remarks,
            *(others[0].remarks if others else ()),
            *trouble,
        ),
    )
    if settings is None:
        return build_dataset(recording, lambda size: _rectify(bag, used, size))
    truth = None if settings.ground_truth is None else read_ground_truth(settings.ground_truth, recording.left)
    return build_dataset(replace(recording, ground_truth=truth), rectification_of(settings, spec.left_only))


def open_bag_images(spec: DatasetSpec) -> ImageDataset:
    """Open the left camera's images; they are undistorted if the bag or a file beside it has a calibration.

    Raises:
        DataError: there are no images, or the bag is damaged.
    """
    bag = read_bag(spec.path)
    settings = _find_settings(bag)
    topics = choose_topics(bag, _requested_topics(spec, bag, settings))
    if settings is not None or find_camera_info(bag, topics.left) is not None:
        return LeftImages.of(open_bag(replace(spec, topics=(topics.left,), left_only=True)))
    (images,) = open_topics(bag.path, (topics.left,))
    return UncalibratedImages(spec.path.stem, images, images.timestamps, remarks=images.remarks)


def _open_depth(bag: Bag, colour: str, settings: CameraToml | None) -> tuple[DepthStream | None, tuple[str, ...]]:
    """Depth images of the camera of a topic; None where there are none, with a remark where they cannot be used.

    Raises:
        DataError: the calibration names a topic that is not in the bag, or the bag is damaged.
    """
    topics = depth_topics(bag.image_counts)
    if settings is not None and settings.depth is not None:
        registered = [topic for topic in topics if image_topic(topic) == image_topic(settings.depth)]
        if not registered:
            found = ", ".join(topics) or "none"
            raise DataError(f"{settings.path}: expected a depth topic {settings.depth}, found {found}; check depth")
    else:
        registered = [topic for topic in topics if is_registered(topic, colour)] or _of_one_frame(bag, topics, colour)
    if not registered:
        remedy = f"record {registered_topic(topics[0], colour)}" if topics else ""
        trouble = [f"{topic} is not registered to {colour}: {DEPTH_UNUSED}; {remedy}" for topic in topics[:1]]
        return None, tuple(trouble)
    topic = choose_depth(registered, colour)
    try:
        images = open_depth_topic(bag.path, topic, None if settings is None else settings.depth_scale)
    except DataError as error:
        return None, (f"{error}; {DEPTH_UNUSED}",)
    return DepthStream(images, images.timestamps, images.remarks), ()


def _of_one_frame(bag: Bag, topics: list[str], colour: str) -> list[str]:
    """Depth topics whose messages are in the frame of the colour images: OpenNI registered them when it recorded."""
    frame = read_frame_id(bag.path, colour) if topics else ""
    return [topic for topic in topics if frame and read_frame_id(bag.path, topic) == frame]


def _find_settings(bag: Bag) -> CameraToml | None:
    """Read the calibration in the folder of a bag or beside it; None if there is none."""
    inside = find_calibration(bag.path) if bag.path.is_dir() else None
    return inside or find_calibration(bag.path.parent)


def _is_preferred(settings: CameraToml, bag: Bag, topics: CameraTopics) -> bool:
    """Whether a YAML file, which may be of another recording in the same folder, comes before CameraInfo."""
    return bool(_topics_in(bag, settings)) or find_camera_info(bag, topics.left) is None


def _topics_in(bag: Bag, settings: CameraToml) -> tuple[str, ...]:
    """Topics of the bag that a calibration names, in its order; empty if one of them is not in the bag."""
    found = [next((t for t in bag.image_counts if image_topic(t) == image_topic(n)), "") for n in settings.topics]
    return tuple(found) if all(found) else ()


def _requested_topics(spec: DatasetSpec, bag: Bag, settings: CameraToml | None) -> tuple[str, ...]:
    """Topics that the command or else the calibration names; empty if neither does."""
    if spec.topics or settings is None:
        return spec.topics
    return tuple(topic for topic in (settings.left, settings.right) if topic) or _topics_in(bag, settings)


def _remarks_of_choice(bag: Bag, topics: CameraTopics, used: CameraTopics) -> tuple[str, ...]:
    if topics == used:
        return ()
    faults = "".join(f"; {topic}: {fault}" for topic, fault in bag.rejected.items())
    trouble = f"neither CameraInfo (P of both cameras) nor {CAMERA_TOML} has a baseline"
    return (f"{trouble}: {LEFT_ALONE}{faults}",)


def _remarks_of_infos(bag: Bag, used: CameraTopics) -> tuple[str, ...]:
    """Which CameraInfo were passed over, and those that were taken from a namespace above."""
    remarks = []
    for topic in used.names:
        info = find_info_topic(bag, topic)
        if info is None:
            continue
        remarks += [bag.remarks[info]] if info in bag.remarks else []
        if image_topic(topic).rpartition("/")[0].startswith(info.rpartition("/")[0] + "/"):
            remarks.append(f"{info} is taken for {topic}")
    return tuple(remarks)


def _used_infos(bag: Bag, used: CameraTopics) -> dict[str, CameraInfo]:
    topics = [find_info_topic(bag, topic) for topic in used.names]
    return {topic: bag.camera_infos[topic] for topic in topics if topic in bag.camera_infos}


def _is_pair(bag: Bag, topics: CameraTopics, settings: CameraToml | None) -> bool:
    if settings is not None:
        return settings.is_pair
    left = find_camera_info(bag, topics.left)
    right = None if topics.right is None else find_camera_info(bag, topics.right)
    if right is not None and left is not None and left.offset_right_m > right.offset_right_m:
        raise DataError(
            f"{bag.path}: expected the left camera, then the right one, found {topics.left} to the right of"
            f" {topics.right} by CameraInfo; swap them with --image-topic, or correct the sign of P[3],"
            " which is -fx times the baseline"
        )
    # Without P, the left camera is not rectified, and the baseline of the right one is to a camera that is not there.
    return left is not None and left.has_rectification and right is not None and right.offset_right_m != 0


def _rectify(bag: Bag, topics: CameraTopics, size: Size) -> Rectification:
    left = _require_camera_info(bag, topics.left, size)
    right = None if topics.right is None else _require_camera_info(bag, topics.right, size)
    try:
        if not left.has_rectification:
            return rectify_parallel(left.model, size)
        baseline = NOMINAL_BASELINE_M if right is None else right.offset_right_m - left.offset_right_m
        fx, fy, cx, cy = map(float, left.P[[0, 1, 0, 1], [0, 1, 2, 2]])
        camera = StereoCamera(fx, fy, cx, cy, baseline, *size)
    except ValueError as error:
        raise DataError(f"{bag.path}: CameraInfo of {topics.left}: {error}; calibrate again") from None
    left_map = _image_map(topics.left, left, camera)
    right_map = left_map if right is None else _image_map(str(topics.right), right, camera)
    R_camera_view = np.eye(3) if isinstance(left_map, IdentityMap) else left.R_view_camera.T
    return Rectification(camera, left_map, right_map, se3.pose(R_camera_view, np.zeros(3)))


def _image_map(topic: str, info: CameraInfo, camera: StereoCamera) -> ImageMap:
    """Map of the images of a topic; the identity if its name says that they are rectified already (image_rect)."""
    is_rotated = not np.allclose(info.R_view_camera, np.eye(3), atol=1e-6)
    differs = not info.model.is_pinhole or is_rotated or not np.allclose(info.model.K, camera.K, atol=1e-3)
    if is_rectified(topic) or not differs:
        return IdentityMap()
    return UndistortMap(info.model.undistort_maps(info.R_view_camera, camera.K, (camera.width, camera.height)))


def _require_camera_info(bag: Bag, topic: str, size: Size) -> CameraInfo:
    """Find the CameraInfo of a topic, for its images of a size (width, height)."""
    info = find_camera_info(bag, topic)
    if info is None:
        found = [*bag.camera_infos, *(f"{other} ({fault})" for other, fault in bag.rejected.items())]
        others = f"{', '.join(found)} of other cameras" if bag.camera_infos else ", ".join(found) or "none"
        raise DataError(
            f"{bag.path}: expected a CameraInfo for {topic}, found {others}; write {CAMERA_TOML} beside the bag"
        )
    try:
        return info.of_images(size)
    except ValueError as error:
        raise DataError(f"{bag.path}: CameraInfo of {topic}: {error}") from None
