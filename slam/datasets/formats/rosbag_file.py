"""Reads ROS 1 bags, ROS 2 bags and MCAP files with the pure-Python library `rosbags` (the extra `ros`).

Finds camera topics and reads their messages by index, in the order of their time stamps.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from types import MappingProxyType
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from slam.datasets.depth_units import MILLIMETRES, Depth
from slam.datasets.formats.rosbag_depth import check_depth, decode_depth, depth_scale
from slam.datasets.formats.rosbag_messages import (
    CameraInfo,
    check_image,
    decode_colour,
    decode_image,
    read_camera_info,
    read_timestamp,
)
from slam.datasets.grey_levels import FULL_RANGE, GreyRange
from slam.datasets.time_sync import order_timestamps
from slam.datasets.video import SequentialReader
from slam.errors import DataError, RevisitError

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
Indices = NDArray[np.int64]
Pixels = TypeVar("Pixels", bound=NDArray[Any])

BAG_SUFFIXES = frozenset((".bag", ".mcap", ".db3"))
UNFINISHED_SUFFIX = ".active"  # of a ROS 1 bag that is being recorded, or whose recorder was killed
IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"
_VIDEO_WORDS = ("Packet", "CompressedVideo")  # in the types of streams from which no single image can be decoded

# What the library says about a recording that was cut off or cannot be read as it is, and what brings it back.
_REMEDIES = {
    "not indexed": "type: rosbag reindex {path}",
    "index looks damaged": "type: rosbag reindex {path}",
    "profile is not ros2": "convert it to a ROS 1 bag or a ROS 2 bag",
    "metadata": "type: ros2 bag reindex {path}",
    "malformed": "type: sqlite3 {path} .recover | sqlite3 recovered.db3",
}
_MCAP_REMEDY = "type: mcap recover {path} -o recovered.mcap, or copy it again"
_REMEDY = "record or copy it again"


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a file by its suffix, or the folder of a ROS 2 bag."""
    if path.is_dir():
        suffixes = [set(item.suffixes) for item in path.iterdir()]
        is_storage = [bool(BAG_SUFFIXES & found) for found in suffixes]
        # Without metadata.yaml, which a killed recorder does not write, nothing else may be in the folder.
        return any(is_storage) and ((path / "metadata.yaml").is_file() or all(is_storage))
    return path.is_file() and (path.suffix in BAG_SUFFIXES or path.suffixes[-2:] == [".bag", UNFINISHED_SUFFIX])


@dataclass(frozen=True)
class Bag:
    """The camera topics of a bag.

    Attributes:
        path: file or folder of the bag.
        image_counts: number of messages of each image topic.
        camera_infos: first usable calibration of each CameraInfo topic.
        rejected: fault of each CameraInfo topic that has no usable calibration.
        videos: topics of video streams, which cannot be read.
        remarks: for each CameraInfo topic, how many messages before the usable one were passed over and why.
    """

    path: Path
    image_counts: dict[str, int]
    camera_infos: dict[str, CameraInfo]
    rejected: dict[str, str] = field(default_factory=dict)
    videos: tuple[str, ...] = ()
    remarks: dict[str, str] = field(default_factory=dict)


def read_bag(path: Path) -> Bag:
    """Find the camera topics of a bag.

    Raises:
        DataError: the bag is missing or damaged, or the extra is not installed.
    """
    with _open_reader(path) as reader:
        topics = sorted({c.topic for c in reader.connections if c.msgtype in IMAGE_TYPES})
        counts = {topic: sum(c.msgcount for c in reader.connections if c.topic == topic) for topic in topics}
        videos = sorted({f"{c.topic} ({c.msgtype})" for c in reader.connections if c.msgtype.endswith(_VIDEO_WORDS)})
        bag = Bag(path, {topic: count for topic, count in counts.items() if count}, {}, videos=tuple(videos))
        for topic in sorted({c.topic for c in reader.connections if c.msgtype == CAMERA_INFO_TYPE and c.msgcount}):
            _find_usable_info(reader, topic, bag)
    return bag


def _find_usable_info(reader: Any, topic: str, bag: Bag) -> None:
    """Enter the first usable CameraInfo of a topic into a bag: drivers publish zeros until they are calibrated."""
    fault, passed = "", 0
    connections = [c for c in reader.connections if c.topic == topic and c.msgtype == CAMERA_INFO_TYPE]
    with closing(reader.messages(connections=connections)) as messages:
        for connection, _, data in messages:
            try:
                bag.camera_infos[topic] = read_camera_info(reader.deserialize(data, connection.msgtype))
                break
            except ValueError as error:
                fault, passed = fault or str(error), passed + 1
    if topic not in bag.camera_infos:
        bag.rejected[topic] = fault
    elif passed:
        bag.remarks[topic] = f"{topic}: CameraInfo passed over before the first usable one: {passed} ({fault})"


@dataclass(frozen=True)
class BagImages(Generic[Pixels]):
    """The images of one topic in the order of their time stamps; each is read on demand.

    Attributes:
        path: file or folder of the bag.
        topic: image topic.
        timestamps: (N,) seconds, increasing: from the message headers, or times of arrival if the headers have none.
        numbers: (N,) of the messages in the order of their arrival.
        remarks: which messages were left out and what was assumed.
        units_per_m: scale of the values of depth images.
    """

    path: Path
    topic: str
    timestamps: Array
    numbers: Indices
    remarks: tuple[str, ...]
    _reader: SequentialReader[Pixels]
    units_per_m: float = 1.0
    _colour_reader: SequentialReader[Image] | None = None

    def __len__(self) -> int:
        return len(self.timestamps)

    def __getitem__(self, index: int) -> Pixels:
        """Read image (H, W): uint8, grey, or float32, depth in metres, NaN where there is none.

        Raises:
            IndexError: there is no such image.
            DataError: the image cannot be read.
        """
        return self._reader.read(index, len(self), self.where, "bag")

    def read_color(self, index: int) -> Image | None:
        """Read image (H, W, 3), RGB; None if it is grey.

        Raises:
            IndexError: there is no such image.
            DataError: the image cannot be read.
        """
        if self._colour_reader is None:
            return None
        image = self._colour_reader.read(index, len(self), self.where, "bag")
        return image if image.size else None

    def where(self, index: int) -> str:
        """Bag, topic and number of a message, for error messages."""
        return f"{self.path}, {self.topic}, message {self.numbers[index]}"


@dataclass
class _Listing:
    """What is known about the messages of a topic before their images are decoded.

    Attributes:
        arrived: times of arrival, nanoseconds.
        stamps: times in the headers, seconds.
        faults: by message number, why an image cannot be decoded.
        grey_range: values of all images; None if they have 8 bits.
        check: checks the image of a message and returns its values, if they have a range.
    """

    check: Callable[[Any], GreyRange | None] = check_image
    arrived: list[int] = field(default_factory=list)
    stamps: list[float] = field(default_factory=list)
    faults: dict[int, str] = field(default_factory=dict)
    grey_range: GreyRange | None = None

    def add(self, arrived: int, message: Any) -> None:
        """Add a message."""
        number = len(self.arrived)
        self.arrived.append(arrived)
        self.stamps.append(read_timestamp(message))
        try:
            found = self.check(message)
        except ValueError as error:
            self.faults[number] = str(error)
        else:
            self.grey_range = join_ranges(self.grey_range, found)

    def usable(self, where: str) -> tuple[Indices, tuple[str, ...]]:
        """Numbers of the messages that can be decoded, and a remark about the others.

        Raises:
            DataError: none can be.
        """
        numbers = np.array([n for n in range(len(self.arrived)) if n not in self.faults], np.int64)
        if not len(numbers):
            first = next(iter(self.faults.values()))
            raise DataError(f"{where}, message 0 and all others: {first}; record it in another encoding")
        if not self.faults:
            return numbers, ()
        number, fault = next(iter(self.faults.items()))
        others = f" and {len(self.faults) - 1} others" if len(self.faults) > 1 else ""
        return numbers, (f"{where}, message {number}{others}: {fault}; left out, record again to have every image",)


def join_ranges(first: GreyRange | None, second: GreyRange | None) -> GreyRange | None:
    """Range of two sets of images, of which either may have 8 bits."""
    return first.join(second) if first is not None and second is not None else first or second


@dataclass
class _InfoListing:
    """The CameraInfo messages of a topic.

    Attributes:
        used: the one that is used for all images.
        count: number of messages.
        others: numbers of the messages that describe another camera; those that cannot be used are not among them.
    """

    used: CameraInfo
    count: int = 0
    others: list[int] = field(default_factory=list)

    def add(self, _: int, message: Any) -> None:
        """Add a message."""
        try:
            if not read_camera_info(message).is_as(self.used):
                self.others.append(self.count)
        except ValueError:
            pass
        self.count += 1

    def describe(self, topic: str) -> list[str]:
        """A remark about messages that describe another camera."""
        what = "differ from the one that is used for all images, the first is message"
        split = "split the recording there"
        return [f"{topic}: {len(self.others)} CameraInfo {what} {self.others[0]}; {split}"] if self.others else []


def open_topics(
    path: Path, topics: tuple[str, ...], infos: Mapping[str, CameraInfo] = MappingProxyType({})
) -> list[BagImages[Image]]:
    """Read the times of all images of some topics; images of 16 bits get the same scale in all of them.

    Args:
        path: file or folder of the bag.
        topics: image topics.
        infos: by topic of CameraInfo, the message that is used; the first camera's remarks tell if others differ.

    Raises:
        DataError: the bag has no such images, none can be decoded, or the bag is damaged.
    """
    listings = {topic: _Listing() for topic in topics}
    info_listings = {topic: _InfoListing(info) for topic, info in infos.items()}
    with _open_reader(path) as reader:
        connections = [c for topic in topics for c in _connections_of(reader, path, topic)]
        connections += [c for c in reader.connections if c.topic in infos and c.msgtype == CAMERA_INFO_TYPE]
        for connection, time, data in reader.messages(connections=connections):
            listing = listings.get(connection.topic) or info_listings[connection.topic]
            listing.add(time, reader.deserialize(data, connection.msgtype))
    grey_range = reduce(join_ranges, [listing.grey_range for listing in listings.values()], None)
    first, *others = [_grey_images_of(path, topic, listings[topic], grey_range) for topic in topics]
    changes = [remark for topic, infos_of in info_listings.items() for remark in infos_of.describe(topic)]
    return [replace(first, remarks=(*changes, *first.remarks)), *others]


def _grey_images_of(path: Path, topic: str, listing: _Listing, grey_range: GreyRange | None) -> BagImages[Image]:
    images = _images_of(path, topic, listing, lambda message: decode_image(message, grey_range or FULL_RANGE))
    scale = [f"{topic}: {grey_range.remark}"] if grey_range is not None and grey_range.remark else []
    arrived = np.array(listing.arrived, np.int64)
    colour = _Messages(path, topic, arrived, images.numbers, _decode_colour_or_nothing)
    return replace(images, remarks=(*images.remarks, *scale), _colour_reader=SequentialReader(colour.decode_from))


def _decode_colour_or_nothing(message: Any) -> Image:
    """RGB image of a message; of a grey one an image without pixels, as None would be the end of the bag."""
    colour = decode_colour(message)
    return np.empty((0, 0, 3), np.uint8) if colour is None else colour


def open_depth_topic(path: Path, topic: str, units_per_m: float | None) -> BagImages[Depth]:
    """Read the times of the depth images of a topic.

    Args:
        path: file or folder of the bag.
        topic: topic of depth images.
        units_per_m: scale of their values; None for that of ROS, millimetres in whole numbers and metres in floats.

    Raises:
        DataError: the bag has no such images, none can be decoded, or the bag is damaged.
    """
    listing, scale = _Listing(check=check_depth), units_per_m or MILLIMETRES
    with _open_reader(path) as reader:
        for connection, time, data in reader.messages(connections=_connections_of(reader, path, topic)):
            message = reader.deserialize(data, connection.msgtype)
            if not listing.arrived and units_per_m is None:
                scale = depth_scale(message)
            listing.add(time, message)
    return replace(_images_of(path, topic, listing, lambda m: decode_depth(m, scale)), units_per_m=scale)


def read_frame_id(path: Path, topic: str) -> str:
    """Name of the frame in which the images of a topic are, by its first message.

    Raises:
        DataError: the bag has no such images, or is damaged.
    """
    with (
        _open_reader(path) as reader,
        closing(reader.messages(connections=_connections_of(reader, path, topic))) as all,
    ):
        return next((str(reader.deserialize(data, c.msgtype).header.frame_id) for c, _, data in all), "")


def _images_of(path: Path, topic: str, listing: _Listing, decode: Callable[[Any], Pixels]) -> BagImages[Pixels]:
    if not listing.arrived:
        raise DataError(f"{path}, {topic}: expected images, found no message; choose another with --image-topic")
    arrived = np.array(listing.arrived, np.int64)
    numbers, damaged = listing.usable(f"{path}, {topic}")
    order = order_timestamps(np.array(listing.stamps), arrived / 1e9)
    is_usable = np.isin(order.rows, numbers)
    numbers, times = order.rows[is_usable], order.seconds[is_usable]
    if not len(numbers):
        raise DataError(f"{path}, {topic}: expected images with usable time stamps, found none; record it again")
    remarks = (*damaged, *(f"{topic}: {remark}" for remark in order.remarks))
    messages = _Messages(path, topic, arrived, numbers, decode)
    return BagImages(path, topic, times, numbers, remarks, SequentialReader(messages.decode_from))


@dataclass(frozen=True)
class _Messages(Generic[Pixels]):
    """The messages of one topic, to be decoded.

    Attributes:
        path, topic: bag and topic.
        arrived: (M,) times of arrival of all messages, nanoseconds, in the bag's order.
        numbers: (N,) of the messages in the order of their images.
        decode: decodes a message.
    """

    path: Path
    topic: str
    arrived: NDArray[np.int64]
    numbers: Indices
    decode: Callable[[Any], Pixels]

    def decode_from(self, start: int) -> Iterator[Pixels]:
        """Decode the images from an index on. Messages that come before their turn wait until then."""
        wanted, index, waiting = set(self.numbers[start:].tolist()), start, dict[int, Any]()
        for number, message in self._read_from(int(self.numbers[start:].min())):
            if number in wanted:
                waiting[number] = message
            while index < len(self.numbers) and int(self.numbers[index]) in waiting:
                yield self._decode(index, waiting.pop(int(self.numbers[index])))
                index += 1

    def _read_from(self, first: int) -> Iterator[tuple[int, Any]]:
        """Numbers and messages of the topic from a number on."""
        with _open_reader(self.path) as reader:
            # The library seeks by time: skip the messages that arrived in the same nanosecond before the wanted one.
            before = int(np.searchsorted(self.arrived, self.arrived[first]))
            connections = _connections_of(reader, self.path, self.topic)
            with closing(reader.messages(connections=connections, start=int(self.arrived[first]))) as messages:
                for number, (connection, _, data) in enumerate(messages, start=before):
                    if number >= first:
                        yield number, reader.deserialize(data, connection.msgtype)

    def _decode(self, index: int, message: Any) -> Pixels:
        try:
            return self.decode(message)
        except ValueError as error:
            where = f"{self.path}, {self.topic}, message {self.numbers[index]}"
            raise DataError(f"{where}: {error}; record it again, or in another encoding") from None


def _connections_of(reader: Any, path: Path, topic: str) -> list[Any]:
    connections = [c for c in reader.connections if c.topic == topic and c.msgtype in IMAGE_TYPES]
    if not connections:
        found = ", ".join(sorted({c.topic for c in reader.connections if c.msgtype in IMAGE_TYPES})) or "none"
        raise DataError(f"{path}: expected images of the topic {topic}, found {found}; choose with --image-topic")
    return connections


@contextmanager
def _open_reader(path: Path) -> Iterator[Any]:
    """Open a reader. Every error while it is open is reported as a fault of the file, in one line."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise DataError(
            f"{path}: expected the library rosbags, which reads bags, found none; type: python -m pip install"
            " 'revisit-slam[ros]'"
        ) from None
    if path.suffix == UNFINISHED_SUFFIX:
        raise DataError(
            f"{path}: expected a finished bag, found one whose recorder is running or was killed; type: rosbag reindex"
            f" {path}, and rename it to {path.stem}"
        )
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except RevisitError:
        raise
    except MemoryError:  # the library allocates the size in a message header, which may be damaged
        raise DataError(f"{path}: expected a readable bag, found sizes beyond the memory; copy it again") from None
    except Exception as error:  # the library does not validate its input: a damaged bag can raise any exception
        found = " ".join(str(error).split())[:200].rstrip(".") or type(error).__name__
        raise DataError(f"{path}: expected a readable bag, found: {found}; {_remedy(path, found)}") from error


def _remedy(path: Path, found: str) -> str:
    """What to type after the library has found a fault in a bag."""
    mcap = next(path.glob("*.mcap"), None) if path.is_dir() else path if path.suffix == ".mcap" else None
    for words, remedy in _REMEDIES.items():
        if words in found.lower():
            return remedy.format(path=path)
    return _REMEDY if mcap is None or "seems to be empty" in found else _MCAP_REMEDY.format(path=mcap)
