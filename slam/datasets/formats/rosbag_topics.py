"""Which topics of a bag are the left and the right camera, and which CameraInfo and depth belong to an image topic.

Drivers of depth cameras move the depth into the colour image on demand and publish that as a topic of its own. Depth of
another topic is in the image of the depth camera, many pixels beside the colour.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import takewhile

from slam.datasets.formats.rosbag_file import Bag
from slam.datasets.formats.rosbag_messages import CameraInfo
from slam.errors import DataError

# Last parts of a topic that name how the images of the topic before it are transported.
_TRANSPORTS = ("compressed", "compressedDepth", "theora", "ffmpeg", "zstd")
# Words of a topic's last part that do not say which camera it is of.
_PLAIN_WORDS = frozenset(("image", "images", "img", "raw", "compressed", "camera", "cam", "info", "calibration"))
_PROCESSING_WORDS = frozenset(
    ("rect", "rectified", "mono", "color", "colour", "gray", "grey", "rgb", "bgr", "bayer", "undistorted")
)
# Words of topics with registered depth, and of the topics of the images that it is registered to: of RealSense (whose
# depth is in the left infrared image from the start), of Azure Kinect and Orbbec, and of OpenNI.
_REGISTERED = (
    ("aligned_depth_to_color", ("color",)),
    ("aligned_depth_to_infra1", ("infra1",)),
    ("depth/image_rect_raw", ("infra1",)),
    ("depth_to_rgb", ("rgb",)),
    ("depth_to_color", ("color", "rgb")),
    ("depth_registered", ("rgb", "color")),
)


@dataclass(frozen=True)
class CameraTopics:
    """The image topics of one camera or a pair.

    Attributes:
        left: topic of the left camera, or of the only camera.
        right: topic of the right camera, or None.
    """

    left: str
    right: str | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The one topic or both."""
        return (self.left,) if self.right is None else (self.left, self.right)


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
    rectified = tuple(topic for topic in topics if is_rectified(topic))
    for candidates in (rectified, topics):
        pairs = [pair for left in candidates if (pair := _pair_of(left, candidates)) is not None]
        if len(pairs) == 1:
            return pairs[0]
    found = ", ".join(f"{topic} ({count})" for topic, count in bag.image_counts.items()) or "no images"
    if not bag.image_counts and bag.videos:
        raise DataError(
            f"{bag.path}: expected images, found video streams alone: {', '.join(bag.videos)}; type: ros2 run"
            " image_transport republish, and record the images"
        )
    raise DataError(
        f"{bag.path}: expected one camera or a left and a right one, found {found}; choose with --image-topic"
    )


def image_topic(topic: str) -> str:
    """The topic of the images themselves: /left/image_raw for /left/image_raw/compressed."""
    before, _, last = topic.rpartition("/")
    return before if before and last in _TRANSPORTS else topic


def is_rectified(topic: str) -> bool:
    """Whether the last part of a topic says that the images are rectified: image_rect, image_rect_color."""
    last = image_topic(topic).rsplit("/", 1)[-1]
    return bool({"rect", "rectified"} & set(re.split(r"[_\W]+", last.lower())))


def _usable(topics: tuple[str, ...]) -> tuple[str, ...]:
    """Topics without depth images and without compressed copies of other topics."""
    grey = (topic for topic in topics if "depth" not in topic.lower())
    return tuple(topic for topic in grey if topic.rsplit("/", 1)[0] not in topics)


def _pair_of(left: str, topics: tuple[str, ...]) -> CameraTopics | None:
    """The pair of topics whose names differ only in left and right, or in 0 and 1; None if there is none."""
    for left_word, right_word in (
        ("left", "right"),
        ("infra1", "infra2"),
        ("Infrared_1", "Infrared_2"),
        ("cam0", "cam1"),
        ("camera0", "camera1"),
    ):
        right = left.replace(left_word, right_word)
        if right != left and right in topics:
            return CameraTopics(left, right)
    return None


def find_camera_info(bag: Bag, topic: str) -> CameraInfo | None:
    """Find the CameraInfo of the camera that an image topic shows, as `find_info_topic` does; None if there is none."""
    found = find_info_topic(bag, topic)
    return None if found is None else bag.camera_infos[found]


def find_info_topic(bag: Bag, topic: str) -> str | None:
    """Find the topic of the CameraInfo of an image topic: /left/camera_info for /left/image_raw; None if not usable.

    It is in the namespace of the images, or in one above if all images below that are of one camera. A CameraInfo of
    another namespace is that of another camera.
    """
    image = image_topic(topic)
    namespace, _, name = image.rpartition("/")
    own = [
        *_infos_in(bag, image),
        *_infos_in(bag, f"{namespace.removesuffix('/image')}/info"),  # as librealsense records
        *(i for i in _infos_in(bag, namespace) if _words(name) - _PROCESSING_WORDS <= _info_words(i) <= _words(name)),
        *(i for i in _infos_in(bag, namespace) if not _info_words(i) and _is_one_camera(bag, namespace)),
    ]
    found = own[0] if own else _info_above(bag, image)
    return found if found in bag.camera_infos else None


def _info_above(bag: Bag, image: str) -> str | None:
    """The only CameraInfo of the closest namespace above that has any, unless it is of another camera."""
    namespace = image.rpartition("/")[0]
    while namespace:
        namespace = namespace.rpartition("/")[0]
        infos = _infos_in(bag, namespace)
        if infos:
            below = {image_topic(t).rpartition("/")[0] for t in bag.image_counts if t.startswith(f"{namespace}/")}
            is_own = len(infos) == len(below) == 1 and _info_words(infos[0]) <= _words(image)
            return infos[0] if is_own else None
    return None


def _infos_in(bag: Bag, namespace: str) -> list[str]:
    return [info for info in (*bag.camera_infos, *bag.rejected) if info.rpartition("/")[0] == namespace]


def _is_one_camera(bag: Bag, namespace: str) -> bool:
    """Whether all images of a namespace are of one camera, by the words of their names."""
    images = {image_topic(topic).rpartition("/") for topic in bag.image_counts}
    return len({_words(name) - _PROCESSING_WORDS for folder, _, name in images if folder == namespace}) == 1


def depth_topics(topics: Iterable[str]) -> list[str]:
    """Topics with depth images, by their names; of several copies of one topic, that without compression."""
    depth = {topic for topic in topics if "depth" in topic.lower()}
    return sorted(topic for topic in depth if image_topic(topic) == topic or image_topic(topic) not in depth)


def is_registered(topic: str, colour: str) -> bool:
    """Whether the name of a depth topic says that it is registered to the images of another topic."""
    return any(word in topic and any(other in colour for other in of) for word, of in _REGISTERED)


def choose_depth(registered: Sequence[str], colour: str) -> str:
    """Choose among several topics of registered depth: rectified or not as the colour, of its camera, the plainest."""

    def distance(topic: str) -> tuple[bool, int, int, str]:
        common = sum(1 for _ in takewhile(lambda both: both[0] == both[1], zip(topic, colour, strict=False)))
        return is_rectified(topic) != is_rectified(colour), -common, len(topic), topic

    return min(registered, key=distance)


def registered_topic(topic: str, colour: str) -> str:
    """Topic in which the driver of an unregistered depth topic publishes the depth that is registered to the colour."""
    namespace = re.split(r"/(?:depth|color|rgb)(?=/|_|$)", topic)[0]
    if "color/" in colour:
        return f"{namespace}/aligned_depth_to_color/image_raw"
    return f"{namespace}/depth_registered/image_raw" if namespace else "/depth_to_rgb/image_raw"


def _info_words(topic: str) -> frozenset[str]:
    return _words(topic.rsplit("/", 1)[-1])


def _words(name: str) -> frozenset[str]:
    """Words and numbers of a name that may say which camera it is of: left in image_left and in camera_info_left."""
    return frozenset(re.findall(r"[a-z]+|\d+", name.lower())) - _PLAIN_WORDS
