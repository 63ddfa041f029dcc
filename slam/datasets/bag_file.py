"""ROS 1 bags, ROS 2 bags and MCAP files, through the pure-Python library `rosbags` (the extra `ros`)."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam.datasets.cursors import Cursors
from slam.datasets.ros_messages import CALIBRATION_TYPE, IMAGE_TYPES, Calibration, calibration, grey, stamp
from slam.errors import DataError, RevisitError

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

SUFFIXES = frozenset((".bag", ".mcap", ".db3"))


def is_bag(path: Path) -> bool:
    """Whether a path is a bag: a file by its name, or the folder of a ROS 2 bag."""
    if path.is_dir():
        return (path / "metadata.yaml").is_file() and any(SUFFIXES & set(item.suffixes) for item in path.iterdir())
    return path.suffix in SUFFIXES and path.is_file()


@dataclass(frozen=True)
class Bag:
    """What cameras a bag has.

    Attributes:
        path: of the file or folder.
        images: topics of images, and how many messages each has.
        calibrations: by topic.
        refused: what is wrong with other calibrations, each with its topic.
    """

    path: Path
    images: dict[str, int]
    calibrations: dict[str, Calibration]
    refused: tuple[str, ...] = ()


def read_bag(path: Path) -> Bag:
    """Find the cameras of a bag.

    Raises:
        DataError: the bag is missing or damaged, or the extra is not installed.
    """
    with _reading(path) as reader:
        images = {c.topic: c.msgcount for c in reader.connections if c.msgtype in IMAGE_TYPES and c.msgcount}
        infos = [c for c in reader.connections if c.msgtype == CALIBRATION_TYPE and c.msgcount]
        messages = {connection.topic: _first(reader, connection) for connection in infos}
    calibrations, refused = {}, []
    for topic, message in messages.items():
        try:
            calibrations[topic] = calibration(message)
        except ValueError as error:
            refused.append(f"{topic} ({error})")
    return Bag(path, dict(sorted(images.items())), calibrations, tuple(refused))


@dataclass(frozen=True)
class BagImages:
    """Images of one topic; each is read when asked for.

    Attributes:
        path: of the bag.
        topic: of the images.
        timestamps: (N,) seconds, by the cameras' own clock where they have one.
    """

    path: Path
    topic: str
    timestamps: Array
    _cursors: Cursors

    def __len__(self) -> int:
        return len(self.timestamps)

    def __getitem__(self, index: int) -> Image:
        """Read image (H, W) uint8, grey.

        Raises:
            IndexError: no such image.
            DataError: it cannot be read.
        """
        return self._cursors.image(index, len(self), self.where, "bag")

    def where(self, index: int) -> str:
        """The bag, the topic and the message's number in it."""
        return f"{self.path}, {self.topic}, message {index}"


def open_topic(path: Path, topic: str) -> BagImages:
    """Read when the images of a topic were taken.

    Raises:
        DataError: the bag has no such images, or is damaged.
    """
    received, stamps = [], []
    with _reading(path) as reader:
        connections = _of_topic(reader, path, topic)
        for connection, time, data in reader.messages(connections=connections):
            received.append(time)
            stamps.append(stamp(reader.deserialize(data, connection.msgtype)))
    if not received:
        raise DataError(f"{path}, {topic}: expected images, found no message; choose another with --image-topic")
    arrived, times = np.array(received, np.int64), np.array(stamps)
    if not times.any():  # a camera without a clock
        times = arrived / 1e9
    return BagImages(path, topic, times, Cursors(lambda index: _images(path, topic, arrived, index)))


def _images(path: Path, topic: str, arrived: NDArray[np.int64], start: int) -> Iterator[Image]:
    """Images of a topic from one on."""
    with _reading(path) as reader:
        before = start - int(np.searchsorted(arrived, arrived[start]))  # that arrived in the same nanosecond
        messages = reader.messages(connections=_of_topic(reader, path, topic), start=int(arrived[start]))
        with closing(messages):
            for number, (connection, _, data) in enumerate(messages):
                if number >= before:
                    yield _grey(reader.deserialize(data, connection.msgtype), f"{path}, {topic}")


def _grey(message: Any, where: str) -> Image:
    try:
        return grey(message)
    except ValueError as error:
        raise DataError(f"{where}: {error}; record it in another encoding") from None


def _of_topic(reader: Any, path: Path, topic: str) -> list[Any]:
    connections = [c for c in reader.connections if c.topic == topic and c.msgtype in IMAGE_TYPES]
    if not connections:
        found = ", ".join(sorted({c.topic for c in reader.connections if c.msgtype in IMAGE_TYPES})) or "none"
        raise DataError(f"{path}: expected images of the topic {topic}, found {found}; choose with --image-topic")
    return connections


def _first(reader: Any, connection: Any) -> Any:
    with closing(reader.messages(connections=[connection])) as messages:
        _, _, data = next(messages)
    return reader.deserialize(data, connection.msgtype)


@contextmanager
def _reading(path: Path) -> Iterator[Any]:
    """An open reader; whatever goes wrong while it is used has to do with the file."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise DataError(
            f"{path}: expected the library rosbags, by which bags are read, found none; type: python -m pip install"
            " 'revisit-slam[ros]'"
        ) from None
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except RevisitError:
        raise
    except MemoryError:  # the library asks for as much as a damaged size says, and would never fill it
        raise DataError(f"{path}: expected a readable bag, found sizes that no memory holds; copy it again") from None
    except Exception as error:  # the library trusts what it reads: a damaged bag can make it raise anything
        found = " ".join(str(error).split())[:200] or type(error).__name__
        raise DataError(f"{path}: expected a readable bag, found: {found}; record or copy it again") from error
