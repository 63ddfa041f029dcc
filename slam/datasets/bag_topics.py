"""Which topics of a bag are the cameras, and which calibration belongs to which."""

from dataclasses import dataclass

from slam.datasets.bag_file import Bag
from slam.datasets.ros_messages import Calibration
from slam.errors import DataError


@dataclass(frozen=True)
class Topics:
    """Which topics are the cameras.

    Attributes:
        left: images of the left camera, or of the only one.
        right: of the right one, or None.
    """

    left: str
    right: str | None = None


def choose_topics(bag: Bag, named: tuple[str, ...]) -> Topics:
    """The cameras that were named, else the only one, else the pair that names or calibration make plain.

    Raises:
        DataError: there are no images, or nothing says which topics to take.
    """
    if named:
        return Topics(*named)
    topics = _usable(tuple(bag.images))
    if len(topics) == 1:
        return Topics(topics[0])
    rectified = tuple(topic for topic in topics if "rect" in topic)
    for some in (rectified, topics):
        pairs = [pair for left in some if (pair := _pair_of(left, some)) is not None]
        if len(pairs) == 1:
            return pairs[0]
    found = ", ".join(f"{topic} ({count})" for topic, count in bag.images.items()) or "no images"
    raise DataError(
        f"{bag.path}: expected one camera or a left and a right one, found {found}; choose with --image-topic"
    )


def _usable(topics: tuple[str, ...]) -> tuple[str, ...]:
    """Topics without images of depth, and without compressed copies of others."""
    light = (topic for topic in topics if "depth" not in topic.lower())
    return tuple(topic for topic in light if topic.rsplit("/", 1)[0] not in topics)


def _pair_of(left: str, topics: tuple[str, ...]) -> Topics | None:
    """The pair whose names differ in nothing but left and right, or 0 and 1."""
    for one, other in (("left", "right"), ("infra1", "infra2"), ("cam0", "cam1"), ("camera0", "camera1")):
        right = left.replace(one, other)
        if right != left and right in topics:
            return Topics(left, right)
    return None


def info_of(bag: Bag, topic: str) -> Calibration | None:
    """Calibration in the image topic's own namespace: /left/image_raw and /left/camera_info."""
    namespace = topic.rsplit("/", 1)[0]
    while namespace:
        if f"{namespace}/camera_info" in bag.calibrations:
            return bag.calibrations[f"{namespace}/camera_info"]
        namespace = namespace.rsplit("/", 1)[0]
    only = list(bag.calibrations.values())
    return only[0] if len(only) == 1 else bag.calibrations.get("/camera_info")
