"""Chooses the camera topics of a bag, and the CameraInfo of each."""

from dataclasses import dataclass

from slam.datasets.bag_file import Bag
from slam.datasets.ros_messages import CameraInfo
from slam.errors import DataError


@dataclass(frozen=True)
class CameraTopics:
    """The image topics of one camera or a pair.

    Attributes:
        left: topic of the left camera, or of the only camera.
        right: topic of the right camera, or None.
    """

    left: str
    right: str | None = None


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
    """CameraTopics without images of depth, and without compressed copies of others."""
    light = (topic for topic in topics if "depth" not in topic.lower())
    return tuple(topic for topic in light if topic.rsplit("/", 1)[0] not in topics)


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
