"""Reads ROS 1 bags, ROS 2 bags and MCAP files with the pure-Python library `rosbags` (the extra `ros`).

Finds camera topics, reads their messages by index, and decodes them: images to grey values, CameraInfo to calibrations.
Why not the package `rosbags-image`: docs/decisions/ros_messages.md.
"""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.datasets.distortion_models import DISTORTION_MODELS, FISHEYE_MODELS, CameraModel
from slam.datasets.video import SequentialReader
from slam.errors import DataError, RevisitError

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

BAG_SUFFIXES = frozenset((".bag", ".mcap", ".db3"))
IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"
# Encodings of sensor_msgs/image_encodings.hpp: type of a value, values per pixel, OpenCV's conversion to grey or None.
# A Bayer pattern is named by its first two pixels in ROS.
ENCODINGS = {
    "mono8": (np.uint8, 1, None),
    "8UC1": (np.uint8, 1, None),
    "mono16": (np.uint16, 1, None),
    "16UC1": (np.uint16, 1, None),
    "bgr8": (np.uint8, 3, cv2.COLOR_BGR2GRAY),
    "8UC3": (np.uint8, 3, cv2.COLOR_BGR2GRAY),
    "rgb8": (np.uint8, 3, cv2.COLOR_RGB2GRAY),
    "bgra8": (np.uint8, 4, cv2.COLOR_BGRA2GRAY),
    "rgba8": (np.uint8, 4, cv2.COLOR_RGBA2GRAY),
    "bayer_rggb8": (np.uint8, 1, cv2.COLOR_BayerRGGB2GRAY),
    "bayer_bggr8": (np.uint8, 1, cv2.COLOR_BayerBGGR2GRAY),
    "bayer_gbrg8": (np.uint8, 1, cv2.COLOR_BayerGBRG2GRAY),
    "bayer_grbg8": (np.uint8, 1, cv2.COLOR_BayerGRBG2GRAY),
    "yuv422": (np.uint8, 2, cv2.COLOR_YUV2GRAY_UYVY),
    "uyvy": (np.uint8, 2, cv2.COLOR_YUV2GRAY_UYVY),
    "yuv422_yuy2": (np.uint8, 2, cv2.COLOR_YUV2GRAY_YUY2),
    "yuyv": (np.uint8, 2, cv2.COLOR_YUV2GRAY_YUY2),
}


@dataclass(frozen=True)
class CameraInfo:
    """Contents of a CameraInfo message.

    Attributes:
        model: intrinsics and distortion of the raw image.
        R_view_camera: (3, 3) rotation from the raw to the rectified camera.
        P: (3, 4) projection matrix of the rectified camera; the last column holds -fx times its offset to the right of
            the pair's left camera. Zeros if the camera is not rectified.
        size: width and height of the raw image, pixels; zeros if unknown.
    """

    model: CameraModel
    R_view_camera: Array
    P: Array
    size: tuple[int, int]

    @property
    def has_rectification(self) -> bool:
        """Whether the message defines a rectified camera."""
        return bool(self.P[0, 0] > 0 and self.P[1, 1] > 0)

    @property
    def offset_right_m(self) -> float:
        """Position to the right of the pair's left camera: 0 for the left or a single camera, else the baseline."""
        return float(-self.P[0, 3] / self.P[0, 0]) if self.has_rectification else 0.0


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


def read_camera_info(message: Any) -> CameraInfo:
    """Convert a CameraInfo message.

    Raises:
        ValueError: the message contains values that no camera has.
    """
    # The fields are called K, D, R, P in ROS 1 and k, d, r, p in ROS 2.
    K, D, R, P = (np.asarray(getattr(message, n, getattr(message, n.lower(), None)), np.float64) for n in "KDRP")
    R = R.reshape(3, 3) if np.any(R) else np.eye(3)
    model, coefficients = _parse_distortion(str(message.distortion_model), tuple(D.tolist()))
    camera_model = CameraModel(float(K[0]), float(K[4]), float(K[2]), float(K[5]), model, coefficients)
    if not np.isfinite(R).all() or np.abs(R @ R.T - np.eye(3)).max() > 1e-2 or not np.isfinite(P).all():
        raise ValueError("expected a rotation R and finite numbers P in CameraInfo")
    return CameraInfo(camera_model, R, P.reshape(3, 4), (int(message.width), int(message.height)))


def _parse_distortion(model: str, coefficients: tuple[float, ...]) -> tuple[str, tuple[float, ...]]:
    if not any(coefficients) and model not in FISHEYE_MODELS:
        return "none", ()
    if model not in DISTORTION_MODELS:
        raise ValueError(f"expected one of the distortion models {', '.join(DISTORTION_MODELS)}, found {model!r}")
    return model, coefficients


def read_timestamp(message: Any) -> float:
    """Time of exposure in a message's header, seconds."""
    time = message.header.stamp
    return float(time.sec) + 1e-9 * float(time.nanosec)


def decode_image(message: Any) -> Image:
    """Decode an Image or a CompressedImage message to grey values (H, W) uint8.

    Raises:
        ValueError: the encoding is not supported, or the data do not fit the encoding.
    """
    try:
        return _decode_raw(message) if hasattr(message, "encoding") else _decode_compressed(message)
    except cv2.error as error:  # raised for sizes that a conversion does not support, such as an odd width of YUV 4:2:2
        raise ValueError(f"expected an image that can be converted, found {error.err}") from None


def _decode_compressed(message: Any) -> Image:
    image = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_GRAYSCALE) if len(message.data) else None
    if image is None:
        raise ValueError(f"expected a compressed image, found {len(message.data)} bytes of {message.format!r}")
    return np.asarray(image, np.uint8)


def _decode_raw(message: Any) -> Image:
    if message.encoding not in ENCODINGS:
        raise ValueError(f"expected one of the encodings {', '.join(ENCODINGS)}, found {message.encoding!r}")
    kind, channels, conversion = ENCODINGS[message.encoding]
    values = _read_values(message, np.dtype(kind), channels)
    if kind is np.uint16:
        return (values[..., 0] >> 8).astype(np.uint8)
    return np.ascontiguousarray(values[..., 0] if conversion is None else cv2.cvtColor(values, conversion))


def _read_values(message: Any, kind: "np.dtype[Any]", channels: int) -> NDArray[Any]:
    """Values (H, W, channels) of an Image message, without the padding that its rows may have."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    row = width * channels * kind.itemsize
    data = np.frombuffer(message.data, np.uint8)
    if not (0 < row <= step and 0 < height * step <= len(data)):
        raise ValueError(
            f"expected {height} rows of {row} bytes for {width} x {height} {message.encoding}, found steps of {step} in"
            f" {len(data)} bytes"
        )
    rows = np.ascontiguousarray(data[: height * step].reshape(height, step)[:, :row])
    return rows.view(kind.newbyteorder(">" if message.is_bigendian else "<")).reshape(height, width, channels)
