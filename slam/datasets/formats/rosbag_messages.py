"""Decodes the messages of cameras in ROS: images to grey values, CameraInfo to calibrations.

Why not the package `rosbags-image`: docs/decisions/ros_messages.md.
"""

import re
import zlib
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.datasets.distortion_models import DISTORTION_MODELS, FISHEYE_MODELS, CameraModel
from slam.datasets.grey_levels import FULL_RANGE, GreyRange, measure_grey_range
from slam.datasets.rectification import Size

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

# Encodings of sensor_msgs/image_encodings.hpp and of common drivers, in lower case: type of a value, values per pixel,
# OpenCV's conversion to grey or None. A Bayer pattern is named by its first two pixels in ROS. Planar formats
# (NV12, NV21, NV24, I420, YV12) begin with the grey image; their colours follow it and are not read.
ENCODINGS = {
    **dict.fromkeys(("mono8", "8uc1"), (np.uint8, 1, None)),
    **dict.fromkeys(("nv12", "nv21", "nv24", "i420", "yv12", "yuv420"), (np.uint8, 1, None)),
    **dict.fromkeys(("mono16", "16uc1", "mono12", "mono14"), (np.uint16, 1, None)),
    **dict.fromkeys(("bgr8", "8uc3"), (np.uint8, 3, cv2.COLOR_BGR2GRAY)),
    **dict.fromkeys(("bgra8", "8uc4"), (np.uint8, 4, cv2.COLOR_BGRA2GRAY)),
    **dict.fromkeys(("bgr16", "16uc3"), (np.uint16, 3, cv2.COLOR_BGR2GRAY)),
    **dict.fromkeys(("bgra16", "16uc4"), (np.uint16, 4, cv2.COLOR_BGRA2GRAY)),
    "rgb8": (np.uint8, 3, cv2.COLOR_RGB2GRAY),
    "rgba8": (np.uint8, 4, cv2.COLOR_RGBA2GRAY),
    "rgb16": (np.uint16, 3, cv2.COLOR_RGB2GRAY),
    "rgba16": (np.uint16, 4, cv2.COLOR_RGBA2GRAY),
    "bayer_rggb8": (np.uint8, 1, cv2.COLOR_BayerRGGB2GRAY),
    "bayer_bggr8": (np.uint8, 1, cv2.COLOR_BayerBGGR2GRAY),
    "bayer_gbrg8": (np.uint8, 1, cv2.COLOR_BayerGBRG2GRAY),
    "bayer_grbg8": (np.uint8, 1, cv2.COLOR_BayerGRBG2GRAY),
    "bayer_rggb16": (np.uint16, 1, cv2.COLOR_BayerRGGB2GRAY),
    "bayer_bggr16": (np.uint16, 1, cv2.COLOR_BayerBGGR2GRAY),
    "bayer_gbrg16": (np.uint16, 1, cv2.COLOR_BayerGBRG2GRAY),
    "bayer_grbg16": (np.uint16, 1, cv2.COLOR_BayerGRBG2GRAY),
    **dict.fromkeys(("yuv422", "uyvy"), (np.uint8, 2, cv2.COLOR_YUV2GRAY_UYVY)),
    **dict.fromkeys(("yuv422_yuy2", "yuyv", "yuy2"), (np.uint8, 2, cv2.COLOR_YUV2GRAY_YUY2)),
}
# Conversions to RGB in the place of those to grey; None where the values are RGB.
_TO_RGB = {
    cv2.COLOR_BGR2GRAY: cv2.COLOR_BGR2RGB,
    cv2.COLOR_BGRA2GRAY: cv2.COLOR_BGRA2RGB,
    cv2.COLOR_RGB2GRAY: None,
    cv2.COLOR_RGBA2GRAY: cv2.COLOR_RGBA2RGB,
    cv2.COLOR_BayerRGGB2GRAY: cv2.COLOR_BayerRGGB2RGB,
    cv2.COLOR_BayerBGGR2GRAY: cv2.COLOR_BayerBGGR2RGB,
    cv2.COLOR_BayerGBRG2GRAY: cv2.COLOR_BayerGBRG2RGB,
    cv2.COLOR_BayerGRBG2GRAY: cv2.COLOR_BayerGRBG2RGB,
    cv2.COLOR_YUV2GRAY_UYVY: cv2.COLOR_YUV2RGB_UYVY,
    cv2.COLOR_YUV2GRAY_YUY2: cv2.COLOR_YUV2RGB_YUY2,
}
_JPEG, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
PNG, _PNG_DEPTH_AT = b"\x89PNG\r\n\x1a\n", 24  # signature, and where the header holds the bits of a value
_MAX_SIZE_DIFFERENCE_PX = 1  # of a binned image from the divided size: drivers round up or down


@dataclass(frozen=True)
class CameraInfo:
    """Contents of a CameraInfo message.

    Attributes:
        model: intrinsics and distortion of the raw image.
        R_view_camera: (3, 3) rotation from the raw to the rectified camera.
        P: (3, 4) projection matrix of the rectified camera; the last column holds -fx times its offset to the right of
            the pair's left camera. Zeros if the camera is not rectified.
        size: width and height of the raw image, pixels; zeros if unknown.
        binning: how many pixels of the sensor, along x and y, are one pixel of the image.
        roi_offset: column and row of the sensor at which the image begins.
        roi_size: width and height of the part of the sensor that the image shows; zeros for the whole sensor.
    """

    model: CameraModel
    R_view_camera: Array
    P: Array
    size: Size
    binning: Size = (1, 1)
    roi_offset: Size = (0, 0)
    roi_size: Size = (0, 0)

    @property
    def has_rectification(self) -> bool:
        """Whether the message defines a rectified camera."""
        return bool(self.P[0, 0] > 0 and self.P[1, 1] > 0)

    def is_as(self, other: "CameraInfo") -> bool:
        """Whether two messages describe the same camera."""
        ours, theirs = ((i.model, i.size, i.binning, i.roi_offset, i.roi_size) for i in (self, other))
        has_same_view = np.array_equal(self.R_view_camera, other.R_view_camera)
        return ours == theirs and has_same_view and np.array_equal(self.P, other.P)

    @property
    def offset_right_m(self) -> float:
        """Position to the right of the pair's left camera: 0 for the left or a single camera, else the baseline."""
        return float(-self.P[0, 3] / self.P[0, 0]) if self.has_rectification else 0.0

    def of_images(self, size: Size) -> "CameraInfo":
        """Return the calibration of images of a size (width, height): those of the sensor, binned and cropped.

        K and P are those of the whole sensor: the offset of the region is subtracted, then the binning divides
        (sensor_msgs/CameraInfo).

        Raises:
            ValueError: the images have another size.
        """
        if self.size in (size, (0, 0)):
            return self
        shown = self.roi_size if all(self.roi_size) else self.size
        binned = (shown[0] // self.binning[0], shown[1] // self.binning[1])
        if max(abs(binned[0] - size[0]), abs(binned[1] - size[1])) > _MAX_SIZE_DIFFERENCE_PX:
            raise ValueError(self._size_error(size, binned))
        S = np.diag([1 / self.binning[0], 1 / self.binning[1], 1.0]) @ np.array(
            [[1.0, 0.0, -self.roi_offset[0]], [0.0, 1.0, -self.roi_offset[1]], [0.0, 0.0, 1.0]]
        )
        K = S @ self.model.K
        model = replace(self.model, fx=K[0, 0], fy=K[1, 1], cx=K[0, 2], cy=K[1, 2])
        return CameraInfo(model, self.R_view_camera, S @ self.P if self.has_rectification else self.P, size)

    def _size_error(self, found: Size, binned: Size) -> str:
        by_fields = "" if binned == self.size else f", or of {binned[0]} x {binned[1]} by its binning and roi"
        return (
            f"expected images of {self.size[0]} x {self.size[1]}{by_fields}, found {found[0]} x {found[1]}: were they"
            " binned, cropped or resized? Set binning_x, binning_y and roi, or write camera.toml for these images"
        )


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
    binning = (max(int(getattr(message, "binning_x", 1)), 1), max(int(getattr(message, "binning_y", 1)), 1))
    info = CameraInfo(camera_model, R, P.reshape(3, 4), (int(message.width), int(message.height)), binning)
    roi = getattr(message, "roi", None)
    if roi is None:
        return info
    offset, size = (int(roi.x_offset), int(roi.y_offset)), (int(roi.width), int(roi.height))
    return replace(info, roi_offset=offset, roi_size=size)


def _parse_distortion(model: str, coefficients: tuple[float, ...]) -> tuple[str, tuple[float, ...]]:
    if not any(coefficients) and model not in FISHEYE_MODELS:
        return "none", ()
    if model not in DISTORTION_MODELS:
        raise ValueError(f"expected one of the distortion models {', '.join(DISTORTION_MODELS)}, found {model!r}")
    counts = DISTORTION_MODELS[model]
    if len(coefficients) in counts:
        return model, coefficients
    # Drivers fill D up with zeros, such as a fifth number of a fisheye lens.
    enough = next((n for n in counts if n < len(coefficients) and not any(coefficients[n:])), None)
    return model, coefficients[:enough]


def read_timestamp(message: Any) -> float:
    """Time of exposure in a message's header, seconds."""
    time = message.header.stamp
    return float(time.sec) + 1e-9 * float(time.nanosec)


def decode_image(message: Any, grey_range: GreyRange = FULL_RANGE) -> Image:
    """Decode an Image or a CompressedImage message to grey values (H, W) uint8.

    Args:
        message: of either type.
        grey_range: values of all images of the recording, if they have 16 bits.

    Raises:
        ValueError: the encoding is not supported, or the data do not fit the encoding.
    """
    try:
        grey = _decode_raw(message) if hasattr(message, "encoding") else _decode_compressed(message)
    except cv2.error as error:  # raised for sizes that a conversion does not support, such as an odd width of YUV 4:2:2
        raise ValueError(f"expected an image that can be converted, found {error.err}") from None
    return np.ascontiguousarray(grey if grey.dtype == np.uint8 else grey_range.to_8_bits(grey))


def decode_colour(message: Any) -> Image | None:
    """Decode an Image or a CompressedImage message to RGB (H, W, 3) uint8; None if it is grey or has planes of colour.

    Raises:
        ValueError: the encoding is not supported, or the data do not fit the encoding.
    """
    if not hasattr(message, "encoding"):
        values, conversion = _decode_compressed_colour(message)
    else:
        kind, channels, conversion = _encoding_of(message)
        values = read_values(message, np.dtype(kind), channels).astype(kind, copy=False)
    if conversion is None:
        return None
    try:
        to_rgb = _TO_RGB[conversion]
        colour = values if to_rgb is None else cv2.cvtColor(values, to_rgb)
    except cv2.error as error:
        raise ValueError(f"expected an image that can be converted, found {error.err}") from None
    return np.ascontiguousarray(colour if colour.dtype == np.uint8 else colour >> 8, np.uint8)


def _decode_compressed_colour(message: Any) -> tuple[NDArray[Any], int | None]:
    """Values of a CompressedImage and their conversion to grey; None if they are grey."""
    values = decode_compressed_data(bytes(message.data), cv2.IMREAD_ANYCOLOR)
    if values is None:
        raise compressed_error(message)
    return (values, cv2.COLOR_BGR2GRAY) if values.ndim == 3 else (values, _bayer_conversion(message))


def _bayer_conversion(message: Any) -> int | None:
    """Conversion to grey of a CompressedImage that holds the colour pattern itself: bayer_rggb8; png compressed ..."""
    pattern = re.search(r"compressed\s+(bayer_\w+)", str(message.format))
    return ENCODINGS.get(pattern[1], (None, 0, None))[2] if pattern else None


def check_image(message: Any) -> GreyRange | None:
    """Check an image as far as that takes little time, and return its values; None if it has 8 bits.

    Raises:
        ValueError: the image cannot be decoded, or its data are cut.
    """
    if not hasattr(message, "encoding"):
        return _check_compressed(message)
    kind, channels, _ = _encoding_of(message)
    values = read_values(message, np.dtype(kind), channels)
    return measure_grey_range(values) if kind is np.uint16 else None


def _check_compressed(message: Any) -> GreyRange | None:
    data = bytes(message.data)
    if data.startswith(_JPEG):
        # Decoders fill what a cut file lacks with grey and say nothing. An eighth of the size is decoded fast.
        is_whole = _JPEG_END in data and decode_compressed_data(data, cv2.IMREAD_REDUCED_GRAYSCALE_8) is not None
    elif data.startswith(PNG):
        is_whole = is_whole_png(data)
    else:
        is_whole = decode_compressed_data(data, cv2.IMREAD_GRAYSCALE) is not None
    if not is_whole:
        raise compressed_error(message)
    is_deep = data.startswith(PNG) and data[_PNG_DEPTH_AT] == 16
    return measure_grey_range(_decode_compressed(message)) if is_deep else None


def is_whole_png(data: bytes) -> bool:
    """Whether all chunks of a PNG file are there with the right checksums."""
    at = len(PNG)
    while at + 12 <= len(data):
        end = at + 8 + int.from_bytes(data[at : at + 4])
        kind = data[at + 4 : at + 8]
        if int.from_bytes(data[end : end + 4]) != zlib.crc32(data[at + 4 : end]):
            return False
        if kind == b"IEND":
            return True
        at = end + 4
    return False


def decode_compressed_data(data: bytes, flags: int) -> NDArray[Any] | None:
    """Decode the bytes of an image file with flags of OpenCV; None if they are damaged."""
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
    except cv2.error:  # raised for a header with a size that OpenCV refuses to allocate
        return None


def compressed_error(message: Any) -> ValueError:
    """Return the error of a CompressedImage message whose data cannot be decoded."""
    return ValueError(f"expected a compressed image, found {len(message.data)} damaged bytes of {message.format!r}")


def _decode_compressed(message: Any) -> NDArray[Any]:
    """Grey values (H, W), uint8 or uint16."""
    image = decode_compressed_data(bytes(message.data), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise compressed_error(message)
    conversion = _bayer_conversion(message)
    return image if conversion is None else cv2.cvtColor(image, conversion)


def _decode_raw(message: Any) -> NDArray[Any]:
    """Grey values (H, W), uint8 or uint16."""
    kind, channels, conversion = _encoding_of(message)
    values = read_values(message, np.dtype(kind), channels)
    if conversion is None:
        return values[..., 0]
    return cv2.cvtColor(values.astype(kind, copy=False), conversion)


def _encoding_of(message: Any) -> tuple[Any, int, int | None]:
    encoding = ENCODINGS.get(str(message.encoding).lower())
    if encoding is None:
        known = ", ".join(ENCODINGS)
        raise ValueError(f"expected one of the encodings {known}, found {message.encoding!r}")
    return encoding


def read_values(message: Any, kind: "np.dtype[Any]", channels: int) -> NDArray[Any]:
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
