"""Image messages become the right grey values, whatever their padding and byte order; CameraInfo becomes a camera."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from slam.datasets.formats.rosbag_messages import (
    ENCODINGS,
    decode_colour,
    decode_image,
    read_camera_info,
    read_timestamp,
)


def message(values: np.ndarray, encoding: str, padding: int = 0, is_bigendian: int = 0) -> SimpleNamespace:
    rows = values.reshape(len(values), -1).view(np.uint8)
    padded = np.hstack([rows, np.full((len(rows), padding), 77, np.uint8)])
    return SimpleNamespace(
        encoding=encoding, height=len(values), width=values.shape[1], step=padded.shape[1],
        is_bigendian=is_bigendian, data=padded.ravel(),
    )  # fmt: skip


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_padding_of_rows_changes_nothing(encoding: str) -> None:
    kind, channels, _ = ENCODINGS[encoding]
    values = np.random.default_rng(0).integers(0, np.iinfo(kind).max, (12, 16, channels)).astype(kind)
    expected = decode_image(message(values, encoding))
    for padding in (1, 4, 16):
        np.testing.assert_array_equal(decode_image(message(values, encoding, padding)), expected)


@pytest.mark.parametrize(("encoding", "order"), [("rgb8", (0, 1, 2)), ("bgr8", (2, 1, 0)), ("8UC3", (2, 1, 0))])
def test_colours_are_weighted_in_the_order_of_their_channels(encoding: str, order: tuple[int, ...]) -> None:
    red_green_blue = np.random.default_rng(1).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    values = np.ascontiguousarray(red_green_blue[..., list(order)])
    expected = red_green_blue @ np.array([0.299, 0.587, 0.114])
    assert np.abs(decode_image(message(values, encoding)) - expected).max() <= 1.0


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_the_grey_values_of_the_colours_are_the_grey_image(encoding: str) -> None:
    kind, channels, conversion = ENCODINGS[encoding]
    smooth = cv2.resize(np.random.default_rng(2).integers(40, 200, (3, 4, channels)).astype(np.uint8), (64, 48))
    values = smooth.reshape(48, 64, channels).astype(kind) * (257 if kind is np.uint16 else 1)
    colour = decode_colour(message(values, encoding))
    if conversion is None:
        assert colour is None
        return
    assert colour is not None
    assert colour.shape == (48, 64, 3)
    grey = decode_image(message(values, encoding)).astype(float)
    if kind is np.uint8 and channels == 2:  # of YUV, whose black is 16 and whose white is 235
        grey = (grey - 16) * 255 / 219
    is_clipped = (colour == 0).any(axis=2) | (colour == 255).any(axis=2)
    assert not is_clipped.all()
    off = np.abs(colour @ np.array([0.299, 0.587, 0.114]) - grey)[2:-2, 2:-2]
    assert off[~is_clipped[2:-2, 2:-2]].max() <= 3


def test_red_green_and_blue_are_in_this_order() -> None:
    red = np.zeros((6, 8, 3), np.uint8)
    red[..., 0] = 200
    for values, encoding in ((red, "rgb8"), (red[..., ::-1], "bgr8")):
        np.testing.assert_array_equal(decode_colour(message(np.ascontiguousarray(values), encoding)), red)
    data = cv2.imencode(".png", red[..., ::-1])[1]
    np.testing.assert_array_equal(decode_colour(SimpleNamespace(data=data, format="rgb8; png compressed bgr8")), red)
    grey = SimpleNamespace(data=cv2.imencode(".png", red[..., 0])[1], format="mono8; png compressed ")
    assert decode_colour(grey) is None


def test_sixteen_bits_keep_the_high_byte_in_either_byte_order() -> None:
    values = np.random.default_rng(2).integers(0, 2**16, (5, 7, 1)).astype(np.uint16)
    for is_bigendian, kind in ((0, "<u2"), (1, ">u2")):
        decoded = decode_image(message(values.astype(kind), "mono16", 2, is_bigendian))
        np.testing.assert_array_equal(decoded, values[..., 0] >> 8)


@pytest.mark.parametrize(("bits", "kind"), [(8, np.uint8), (16, np.uint16)])
@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_a_uniform_colour_survives_every_bayer_pattern(pattern: str, bits: int, kind: type) -> None:
    colour = {"r": 200, "g": 100, "b": 50}
    tile = np.array([[colour[c] for c in pattern[:2]], [colour[c] for c in pattern[2:]]]).astype(kind) << (bits - 8)
    grey = decode_image(message(np.tile(tile, (8, 8))[..., None], f"bayer_{pattern}{bits}"))
    expected = 0.299 * 200 + 0.587 * 100 + 0.114 * 50
    assert np.abs(grey[2:-2, 2:-2] - expected).max() <= 1.0


def test_a_compressed_bayer_pattern_is_one_too() -> None:
    tile = np.array([[200, 100], [100, 50]], np.uint8)
    data = np.frombuffer(cv2.imencode(".png", np.tile(tile, (8, 8)))[1].tobytes(), np.uint8)
    grey = decode_image(SimpleNamespace(format="bayer_rggb8; png compressed bayer_rggb8", data=data))
    assert np.abs(grey[2:-2, 2:-2] - 124.2).max() <= 1.0


@pytest.mark.parametrize("encoding", ["nv12", "NV21", "i420", "yuv420"])
def test_planar_formats_begin_with_the_grey_image(encoding: str) -> None:
    grey = np.random.default_rng(4).integers(0, 256, (12, 16), dtype=np.uint8)
    planar = message(grey, encoding, padding=4)
    planar.data = np.concatenate([planar.data, np.full(6 * 20, 128, np.uint8)])  # the colours at half the size
    np.testing.assert_array_equal(decode_image(planar), grey)


@pytest.mark.parametrize(
    ("encoding", "channel"),
    [("yuyv", 0), ("YUYV", 0), ("yuy2", 0), ("yuv422_yuy2", 0), ("uyvy", 1), ("yuv422", 1)],
)
def test_the_grey_values_of_packed_colour_differences_are_the_image(encoding: str, channel: int) -> None:
    values = np.random.default_rng(5).integers(0, 256, (12, 16, 2), dtype=np.uint8)
    np.testing.assert_array_equal(decode_image(message(values, encoding)), values[..., channel])


@pytest.mark.parametrize(("encoding", "red"), [("rgba8", 0), ("bgra8", 2), ("rgb16", 0), ("bgra16", 2), ("8UC4", 2)])
def test_a_fourth_channel_and_sixteen_bits_change_no_colour(encoding: str, red: int) -> None:
    kind = np.uint16 if encoding.endswith("16") else np.uint8
    values = np.zeros((4, 6, 3 if encoding.startswith("rgb1") else 4), kind)
    values[..., red] = np.iinfo(kind).max
    assert np.abs(decode_image(message(values, encoding)) - 0.299 * 255).max() <= 1.0


def test_a_compressed_image_is_that_image() -> None:
    image = np.random.default_rng(3).integers(0, 256, (9, 11), dtype=np.uint8)
    data = np.frombuffer(cv2.imencode(".png", image)[1].tobytes(), np.uint8)
    np.testing.assert_array_equal(decode_image(SimpleNamespace(format="png", data=data)), image)


def test_data_that_do_not_fill_the_image_are_refused() -> None:
    short = message(np.zeros((4, 6, 1), np.uint8), "mono8")
    short.data = short.data[:-1]
    with pytest.raises(ValueError, match="expected 4 rows of 6 bytes for 6 x 4 mono8, found steps of 6 in 23 bytes"):
        decode_image(short)


def info(**changes: object) -> SimpleNamespace:
    fields = {
        "k": [400.0, 0, 320, 0, 410.0, 240, 0, 0, 1], "d": [0.0] * 5, "r": np.eye(3).ravel().tolist(),
        "p": [380.0, 0, 315, -76.0, 0, 380.0, 235, 0, 0, 0, 1, 0], "distortion_model": "plumb_bob",
        "width": 640, "height": 480,
    }  # fmt: skip
    return SimpleNamespace(**(fields | changes))


def test_camera_info_gives_intrinsics_and_the_position_of_the_right_camera() -> None:
    found = read_camera_info(info())
    assert (found.model.fx, found.model.fy, found.model.cx, found.model.cy) == (400.0, 410.0, 320.0, 240.0)
    assert found.model.is_pinhole
    assert found.has_rectification
    assert found.offset_right_m == pytest.approx(0.2)
    assert found.size == (640, 480)


def test_camera_info_without_a_projection_is_of_a_single_camera() -> None:
    found = read_camera_info(info(p=[0.0] * 12, r=[0.0] * 9))
    assert not found.has_rectification
    assert found.offset_right_m == 0.0
    np.testing.assert_array_equal(found.R_view_camera, np.eye(3))


def test_the_field_names_of_ros_1_are_understood() -> None:
    small = vars(info())
    large = SimpleNamespace(**{name.upper() if len(name) == 1 else name: value for name, value in small.items()})
    np.testing.assert_array_equal(read_camera_info(large).P, read_camera_info(info()).P)


def test_zeros_that_fill_up_the_coefficients_are_taken_off() -> None:
    found = read_camera_info(info(d=[0.1, -0.2, 0.01, 0.02, 0.0], distortion_model="equidistant")).model
    assert found.coefficients == (0.1, -0.2, 0.01, 0.02)
    assert read_camera_info(info(d=[0.1, -0.2, 0.01, 0.02, 0.3, 0.0, 0.0])).model.coefficients[4:] == (0.3,)
    with pytest.raises(ValueError, match="expected 4 coefficients of equidistant, found 5"):
        read_camera_info(info(d=[0.1] * 5, distortion_model="equidistant"))


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"r": [2.0, 0, 0, 0, 1, 0, 0, 0, 1]}, "expected a rotation R"),
        ({"p": [float("nan")] * 12}, "finite numbers P"),
        ({"d": [0.1] * 4, "distortion_model": "omni"}, "found 'omni'"),
        ({"k": [0.0] * 9}, "positive focal lengths"),
    ],
)
def test_impossible_camera_info_is_refused(changes: dict[str, object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        read_camera_info(info(**changes))


def test_a_time_stamp_has_seconds_and_nanoseconds() -> None:
    header = SimpleNamespace(stamp=SimpleNamespace(sec=12, nanosec=500_000_000))
    assert read_timestamp(SimpleNamespace(header=header)) == 12.5
