"""Decodes camera messages of ROS 1 and ROS 2: images to grey values, CameraInfo to calibrations.

Why not the package `rosbags-image`: docs/decisions/ros_messages.md.
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.datasets.distortion_models import DISTORTION_MODELS, FISHEYE_MODELS, CameraModel

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

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

IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
CAMERA_INFO_TYPE = "sensor_msgs/msg/CameraInfo"


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
