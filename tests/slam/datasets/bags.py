"""Writes bags message by message, as drivers and recorders leave them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS1_NOETIC)
START = 1_600_000_000.0  # s
SIZE = (64, 48)
FX, CX, CY, BASELINE = 60.0, 31.0, 23.0, 0.4


def picture(number: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Image (H, W) uint8 whose upper left corner holds its number."""
    image = cv2.resize(np.random.default_rng(number).integers(40, 200, (6, 8), dtype=np.uint8), size)
    image[:8, :8] = number
    return image


def number_of(image: np.ndarray) -> int:
    return int(image[2, 2])


def header(stamp: float) -> Any:
    nanoseconds = round(stamp * 1e9)
    time = STORE.types["builtin_interfaces/msg/Time"](nanoseconds // 10**9, nanoseconds % 10**9)
    return STORE.types["std_msgs/msg/Header"](0, time, "camera")


def raw_image(values: np.ndarray, stamp: float, encoding: str = "mono8") -> Any:
    """An Image message of values (H, W) or (H, W, channels)."""
    height, width = values.shape[:2]
    data = np.frombuffer(np.ascontiguousarray(values).tobytes(), np.uint8)
    return STORE.types["sensor_msgs/msg/Image"](
        header(stamp), height, width, encoding, 0, len(data) // height, data
    )  # fmt: skip


def compressed(data: bytes, stamp: float, description: str = "jpeg") -> Any:
    values = np.frombuffer(data, np.uint8)
    return STORE.types["sensor_msgs/msg/CompressedImage"](header(stamp), description, values)


def encoded(image: np.ndarray, suffix: str = ".jpg") -> bytes:
    return bytes(cv2.imencode(suffix, image)[1].tobytes())


@dataclass(frozen=True)
class Info:
    """A CameraInfo message; P is that of a rectified camera `offset` metres right of the left one."""

    fx: float = FX
    size: tuple[int, int] = SIZE
    centre: tuple[float, float] = (CX, CY)
    offset: float = 0.0
    model: str = "plumb_bob"
    D: Sequence[float] = (0.0,) * 5
    binning: tuple[int, int] = (0, 0)
    roi: tuple[int, int, int, int] = (0, 0, 0, 0)  # x, y, height, width, as in the message
    has_projection: bool = True

    def message(self, stamp: float = START) -> Any:
        K = np.array([[self.fx, 0, self.centre[0]], [0, self.fx, self.centre[1]], [0, 0, float(self.fx > 0)]])
        P = np.hstack([K, [[-self.fx * self.offset], [0], [0]]])
        P *= self.has_projection
        roi = STORE.types["sensor_msgs/msg/RegionOfInterest"](*self.roi, False)
        arrays = [np.asarray(a, np.float64).ravel() for a in (self.D, K, np.eye(3), P)]
        kind = STORE.types["sensor_msgs/msg/CameraInfo"]
        return kind(header(stamp), self.size[1], self.size[0], self.model, *arrays, *self.binning, roi)


@dataclass
class Messages:
    """Messages of a bag: topic, time of receipt and message."""

    rows: list[tuple[str, float, Any]] = field(default_factory=list)

    def add(self, topic: str, message: Any, received: float | None = None) -> "Messages":
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        self.rows.append((topic, stamp + 0.01 if received is None else received, message))
        return self

    def images(self, topic: str, stamps: Sequence[float], shift: float = 0.01) -> "Messages":
        """Add numbered grey images with stamps after START, which arrive 0.1 s apart; NaN is for stamp 0."""
        for number, stamp in enumerate(stamps):
            message = raw_image(picture(number), START + stamp if np.isfinite(stamp) else 0.0)
            self.add(topic, message, START + 0.1 * number + shift)
        return self

    def write(self, path: Path) -> Path:
        path.parent.mkdir(parents=True, exist_ok=True)
        with Writer(path) as writer:
            kinds = {topic: message.__msgtype__ for topic, _, message in self.rows}
            topics = {topic: writer.add_connection(topic, kind, typestore=STORE) for topic, kind in kinds.items()}
            for topic, received, message in sorted(self.rows, key=lambda row: row[1]):
                data = STORE.serialize_ros1(message, message.__msgtype__)
                writer.write(topics[topic], round(received * 1e9), data)
        return path
