"""Reads ROS 1 bags, ROS 2 bags and MCAP files with the pure-Python library `rosbags` (the extra `ros`)."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.datasets.formats.rosbag_messages import (
    CAMERA_INFO_TYPE,
    IMAGE_TYPES,
    CameraInfo,
    decode_image,
    read_camera_info,
    read_timestamp,
)
from slam.datasets.video import SequentialReader
from slam.errors import DataError, RevisitError

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

BAG_SUFFIXES = frozenset((".bag", ".mcap", ".db3"))


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a file by its suffix, or the folder of a ROS 2 bag."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() and any(BAG_SUFFIXES & set(item.suffixes) for item in path.iterdir())
    return path.suffix in BAG_SUFFIXES and path.is_file()


@dataclass(frozen=True)
class Bag:
    """The camera topics of a bag.

    Attributes:
        path: file or folder of the bag.
        image_counts: number of messages of each image topic.
        camera_infos: usable calibration of each CameraInfo topic.
        rejected: topics and faults of unusable calibrations, for error messages.
    """

    path: Path
    image_counts: dict[str, int]
    camera_infos: dict[str, CameraInfo]
    rejected: tuple[str, ...] = ()


def read_bag(path: Path) -> Bag:
    """Find the camera topics of a bag.

    Raises:
        DataError: the bag is missing or damaged, or the extra is not installed.
    """
    with _open_reader(path) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections if c.msgtype in IMAGE_TYPES and c.msgcount}
        infos = [c for c in reader.connections if c.msgtype == CAMERA_INFO_TYPE and c.msgcount]
        messages = {connection.topic: _first_message(reader, connection) for connection in infos}
    camera_infos, rejected = {}, []
    for topic, message in messages.items():
        try:
            camera_infos[topic] = read_camera_info(message)
        except ValueError as error:
            rejected.append(f"{topic} ({error})")
    return Bag(path, dict(sorted(counts.items())), camera_infos, tuple(rejected))


@dataclass(frozen=True)
class BagImages:
    """The images of one topic; each is read on demand.

    Attributes:
        path: file or folder of the bag.
        topic: image topic.
        timestamps: (N,) seconds, from the message headers, or times of arrival if the headers have none.
    """

    path: Path
    topic: str
    timestamps: Array
    _reader: SequentialReader

    def __len__(self) -> int:
        return len(self.timestamps)

    def __getitem__(self, index: int) -> Image:
        """Read image (H, W) uint8, grey.

        Raises:
            IndexError: there is no such image.
            DataError: the image cannot be read.
        """
        return self._reader.read(index, len(self), self.where, "bag")

    def where(self, index: int) -> str:
        """Bag, topic and index of a message, for error messages."""
        return f"{self.path}, {self.topic}, message {index}"


def open_topic(path: Path, topic: str) -> BagImages:
    """Read the times of all images of a topic.

    Raises:
        DataError: the bag has no such images, or is damaged.
    """
    received, stamps = [], []
    with _open_reader(path) as reader:
        connections = _connections_of(reader, path, topic)
        for connection, time, data in reader.messages(connections=connections):
            received.append(time)
            stamps.append(read_timestamp(reader.deserialize(data, connection.msgtype)))
    if not received:
        raise DataError(f"{path}, {topic}: expected images, found no message; choose another with --image-topic")
    arrived, times = np.array(received, np.int64), np.array(stamps)
    if not times.any():  # the driver has not filled in the headers
        times = arrived / 1e9
    return BagImages(path, topic, times, SequentialReader(lambda index: _decode_from(path, topic, arrived, index)))


def _decode_from(path: Path, topic: str, arrived: NDArray[np.int64], start: int) -> Iterator[Image]:
    """Decode the images of a topic from an index on."""
    with _open_reader(path) as reader:
        # The library seeks by time: skip the messages that arrived in the same nanosecond before the wanted one.
        skip = start - int(np.searchsorted(arrived, arrived[start]))
        messages = reader.messages(connections=_connections_of(reader, path, topic), start=int(arrived[start]))
        with closing(messages):
            for number, (connection, _, data) in enumerate(messages):
                if number >= skip:
                    yield _decode(reader.deserialize(data, connection.msgtype), f"{path}, {topic}")


def _decode(message: Any, where: str) -> Image:
    try:
        return decode_image(message)
    except ValueError as error:
        raise DataError(f"{where}: {error}; record it in another encoding") from None


def _connections_of(reader: Any, path: Path, topic: str) -> list[Any]:
    connections = [c for c in reader.connections if c.topic == topic and c.msgtype in IMAGE_TYPES]
    if not connections:
        found = ", ".join(sorted({c.topic for c in reader.connections if c.msgtype in IMAGE_TYPES})) or "none"
        raise DataError(f"{path}: expected images of the topic {topic}, found {found}; choose with --image-topic")
    return connections


def _first_message(reader: Any, connection: Any) -> Any:
    with closing(reader.messages(connections=[connection])) as messages:
        _, _, data = next(messages)
    return reader.deserialize(data, connection.msgtype)


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
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except RevisitError:
        raise
    except MemoryError:  # the library allocates the size in a message header, which may be damaged
        raise DataError(f"{path}: expected a readable bag, found sizes beyond the memory; copy it again") from None
    except Exception as error:  # the library does not validate its input: a damaged bag can raise any exception
        found = " ".join(str(error).split())[:200] or type(error).__name__
        raise DataError(f"{path}: expected a readable bag, found: {found}; record or copy it again") from error
