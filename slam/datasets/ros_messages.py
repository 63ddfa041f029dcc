"""Messages of cameras in ROS 1 and ROS 2: images to grey values, and calibrations."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.datasets.lens import MODELS, Lens

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

# Encodings (sensor_msgs/image_encodings.hpp): type of a value, values a pixel, OpenCV's conversion to grey if any.
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
CALIBRATION_TYPE = "sensor_msgs/msg/CameraInfo"


def stamp(message: Any) -> float:
    """When the camera says that it saw this, seconds."""
    time = message.header.stamp
    return float(time.sec) + 1e-9 * float(time.nanosec)


def grey(message: Any) -> Image:
    """Grey values (H, W) uint8 of an Image or a CompressedImage.

    Raises:
        ValueError: an encoding that is not known, or other data than it needs.
    """
    try:
        return _image(message) if hasattr(message, "encoding") else _compressed(message)
    except cv2.error as error:  # sizes that a conversion cannot work on
        raise ValueError(f"expected an image that can be converted, found {error.err}") from None


def _compressed(message: Any) -> Image:
    image = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_GRAYSCALE) if len(message.data) else None
    if image is None:
        raise ValueError(f"expected a compressed image, found {len(message.data)} bytes of {message.format!r}")
    return np.asarray(image, np.uint8)


def _image(message: Any) -> Image:
    if message.encoding not in ENCODINGS:
        raise ValueError(f"expected one of the encodings {', '.join(ENCODINGS)}, found {message.encoding!r}")
    kind, channels, conversion = ENCODINGS[message.encoding]
    values = _values(message, np.dtype(kind), channels)
    if kind is np.uint16:
        return (values[..., 0] >> 8).astype(np.uint8)
    return np.ascontiguousarray(values[..., 0] if conversion is None else cv2.cvtColor(values, conversion))


def _values(message: Any, kind: "np.dtype[Any]", channels: int) -> NDArray[Any]:
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
class Calibration:
    """A CameraInfo.

    Attributes:
        lens: intrinsics and distortion of the raw image.
        R_view_camera: (3, 3) rotation from the camera to the rectified view.
        P: (3, 4) projection of the rectified view; its last column places the right camera. Zeros where there is none.
        size: width and height.
    """

    lens: Lens
    R_view_camera: Array
    P: Array
    size: tuple[int, int]

    @property
    def rectified(self) -> bool:
        """Whether it says what the rectified view is."""
        return bool(self.P[0, 0] > 0 and self.P[1, 1] > 0)

    @property
    def to_right(self) -> float:
        """How far to the right of the left camera of its pair, metres: 0 for the left one, or one that is alone."""
        return float(-self.P[0, 3] / self.P[0, 0]) if self.rectified else 0.0


def calibration(message: Any) -> Calibration:
    """Calibration of a CameraInfo.

    Raises:
        ValueError: values that no camera has.
    """
    # ROS 1 writes the names of the matrices large, ROS 2 small
    K, D, R, P = (np.asarray(getattr(message, n, getattr(message, n.lower(), None)), np.float64) for n in "KDRP")
    R = R.reshape(3, 3) if np.any(R) else np.eye(3)
    model, coefficients = _distortion(str(message.distortion_model), tuple(D.tolist()))
    lens = Lens(float(K[0]), float(K[4]), float(K[2]), float(K[5]), model, coefficients)
    if not np.isfinite(R).all() or np.abs(R @ R.T - np.eye(3)).max() > 1e-2 or not np.isfinite(P).all():
        raise ValueError("expected a rotation R and finite numbers P in CameraInfo")
    return Calibration(lens, R, P.reshape(3, 4), (int(message.width), int(message.height)))


def _distortion(model: str, coefficients: tuple[float, ...]) -> tuple[str, tuple[float, ...]]:
    if not any(coefficients) and model not in ("equidistant", "fisheye"):
        return "none", ()
    if model not in MODELS:
        raise ValueError(f"expected one of the distortion models {', '.join(MODELS)}, found {model!r}")
    return model, coefficients
