"""Decodes the depth images of ROS (REP 118), raw or as compressed_depth_image_transport stores them."""

import struct
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slam.datasets.depth_units import Depth, to_metres, usual_scale
from slam.datasets.formats.rosbag_messages import (
    PNG,
    compressed_error,
    decode_compressed_data,
    is_whole_png,
    read_values,
)

_TYPES = {"16uc1": np.uint16, "mono16": np.uint16, "32fc1": np.float32}
# Header of compressed_depth_image_transport's data: format, and two numbers by which floats become 16 bits.
_HEADER = struct.Struct("<iff")


def depth_scale(message: Any) -> float:
    """Units per metre of the depth in a message, by its encoding."""
    if hasattr(message, "encoding"):
        return usual_scale(np.empty(0, _TYPES.get(str(message.encoding).lower(), np.uint16)))
    return 1.0 if str(message.format).lower().startswith("32fc1") else usual_scale(None)


def check_depth(message: Any) -> None:
    """Check a depth image as far as that takes little time.

    Raises:
        ValueError: the image cannot be decoded, or its data are cut.
    """
    if hasattr(message, "encoding"):
        _raw_values(message)
    elif not is_whole_png(_png(message)):
        raise compressed_error(message)


def decode_depth(message: Any, units_per_m: float) -> Depth:
    """Decode an Image or a CompressedImage message to depth (H, W), metres; NaN where there is none.

    Raises:
        ValueError: the encoding is not one of depth, or the data do not fit the encoding.
    """
    if hasattr(message, "encoding"):
        return to_metres(_raw_values(message), units_per_m)
    data = _png(message)
    values = decode_compressed_data(data, cv2.IMREAD_UNCHANGED)
    if values is None:
        raise compressed_error(message)
    if str(message.format).lower().startswith("32fc1") and values.dtype == np.uint16:
        values = _dequantize(values, bytes(message.data)[: _HEADER.size])
    return to_metres(values, units_per_m)


def _raw_values(message: Any) -> NDArray[Any]:
    kind = _TYPES.get(str(message.encoding).lower())
    if kind is None:
        raise ValueError(f"expected depth in one of the encodings {', '.join(_TYPES)}, found {message.encoding!r}")
    return read_values(message, np.dtype(kind), 1)[..., 0].astype(kind)


def _png(message: Any) -> bytes:
    """The PNG file in a message, which compressed_depth_image_transport puts after its header."""
    data = bytes(message.data)
    file = data if data.startswith(PNG) else data[_HEADER.size :]
    if not file.startswith(PNG):
        raise ValueError(
            f"expected depth as PNG, found {len(data)} bytes of {message.format!r}; record it as PNG or raw"
        )
    return file


def _dequantize(values: NDArray[np.uint16], header: bytes) -> NDArray[np.float32]:
    """Depth of the inverse depths that compressed_depth_image_transport stores for floats: a / (value - b)."""
    if len(header) < _HEADER.size:
        raise ValueError("expected the header of compressed depth, found none; record it again")
    _, a, b = _HEADER.unpack(header)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        depth = (a / (values.astype(np.float32) - b)).astype(np.float32)
    depth[values == 0] = np.nan
    return depth
