"""Depth in bags: the registered topic is found, decoded in all encodings, and put beside the colour of its time."""

import struct
from pathlib import Path

import numpy as np
import pytest

from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.registry import open_dataset, open_for_odometry, open_images
from slam.datasets.formats.rosbag_depth import decode_depth
from slam.datasets.formats.rosbag_topics import choose_depth, depth_topics, is_registered, registered_topic
from slam.datasets.rectification import DEPTH_CAMERA_BASELINE_M
from slam.errors import DataError

from ..bags import CX, CY, FX, SIZE, START, Info, Messages, compressed, encoded, number_of, raw_image

COLOUR, ALIGNED, UNALIGNED = (
    "/camera/color/image_raw",
    "/camera/aligned_depth_to_color/image_raw",
    "/camera/depth/image_rect_raw",
)
COUNT = 5


def metres(number: int) -> np.ndarray:
    """Depth (H, W) that grows with the number and to the right; a hole in the first column."""
    depth = np.tile(1.0 + number + np.arange(SIZE[0]) / 100, (SIZE[1], 1))
    depth[:, 0] = 0.0
    return depth


def true_depth(number: int) -> np.ndarray:
    depth = metres(number)
    depth[:, 0] = np.nan
    return depth


def whole(number: int) -> np.ndarray:
    return np.rint(metres(number) * 1000).astype(np.uint16)


def quantized(number: int, stamp: float) -> object:
    """Floats as compressed_depth_image_transport stores them, with its usual parameters: up to 10 m, 100 at 1 m."""
    a = 100.0 * (100.0 + 1.0)
    b = 1.0 - a / 10.0
    depth = metres(number)
    values = np.zeros(depth.shape, np.uint16)
    values[depth > 0] = np.rint(a / depth[depth > 0] + b).astype(np.uint16)
    data = struct.pack("<iff", 0, a, b) + encoded(values, ".png")
    return compressed(data, stamp, "32FC1; compressedDepth png")


def message(encoding: str, number: int, stamp: float) -> object:
    if encoding == "16UC1":
        return raw_image(whole(number), stamp, "16UC1")
    if encoding == "32FC1":
        return raw_image(np.where(metres(number) > 0, metres(number), np.nan).astype(np.float32), stamp, "32FC1")
    if encoding == "png":
        return compressed(encoded(whole(number), ".png"), stamp, "16UC1; png compressed ")
    if encoding == "compressedDepth":
        return compressed(
            struct.pack("<iff", 0, 0, 0) + encoded(whole(number), ".png"), stamp, "16UC1; compressedDepth"
        )
    return quantized(number, stamp)


def write(path: Path, topics: dict[str, str], late_s: float = 0.004, colour: str = COLOUR) -> Path:
    """A bag of colour images and of depth topics, each with an encoding."""
    messages = Messages().images(colour, [k * 0.1 for k in range(COUNT)])
    messages.add(f"{colour.rpartition('/')[0]}/camera_info", Info().message(), START)
    for topic, encoding in topics.items():
        for k in range(COUNT):
            stamp = START + k * 0.1 + late_s
            messages.add(topic, message(encoding, k, stamp), stamp + 0.02)
    return messages.write(path)


@pytest.mark.parametrize(
    ("encoding", "topic", "tolerance"),
    [
        ("16UC1", ALIGNED, 1e-6),
        ("32FC1", ALIGNED, 1e-6),
        ("png", f"{ALIGNED}/compressed", 1e-6),
        ("compressedDepth", f"{ALIGNED}/compressedDepth", 1e-6),
        ("quantized", f"{ALIGNED}/compressedDepth", 0.5 * 6.64**2 / 10100 * 1.1),  # half a step of inverse depth
    ],
)
def test_registered_depth_in_every_encoding(tmp_path: Path, encoding: str, topic: str, tolerance: float) -> None:
    drive = open_for_odometry(DatasetSpec(write(tmp_path / "drive.bag", {topic: encoding})), mono=False)
    assert (drive.has_depth, drive.has_right, len(drive), drive.remarks) == (True, False, COUNT, ())
    assert drive.camera.baseline == DEPTH_CAMERA_BASELINE_M
    for k in (0, 1, 2, 4, 3):  # forwards, and then back
        frame = drive[k]
        assert number_of(frame.left) == k
        assert frame.depth is not None
        np.testing.assert_allclose(frame.depth, true_depth(k), atol=tolerance + 5e-4)


def test_depth_goes_through_the_map_of_the_colour(tmp_path: Path) -> None:
    messages = (
        Messages().images(COLOUR, [0.0, 0.1]).add("/camera/color/camera_info", Info(D=(-0.3, 0.1, 0, 0, 0)).message())
    )
    for k in range(2):
        column = np.tile(np.arange(1000, 1000 + SIZE[0], dtype=np.uint16), (SIZE[1], 1))
        messages.add(ALIGNED, raw_image(column, START + 0.1 * k, "16UC1"))
    depth = open_dataset(messages.write(tmp_path / "drive.bag"))[0].depth
    assert depth is not None
    columns, rows = depth * 1000 - 1000, np.arange(SIZE[1])[:, None]
    x, y = (np.arange(SIZE[0]) - CX) / FX, (rows - CY) / FX
    r2 = x**2 + y**2
    expected = CX + FX * x * (1 - 0.3 * r2 + 0.1 * r2**2)
    assert np.nanmax(np.abs(columns - expected)) < 0.6
    assert np.nanmax(np.abs(columns - np.arange(SIZE[0]))) > 2  # the control: the distortion is not small


def test_depth_that_is_not_registered_is_named_with_the_topic_to_record(tmp_path: Path) -> None:
    messages = Messages().images(COLOUR, [0.0, 0.1]).add("/camera/color/camera_info", Info().message())
    for k in range(2):
        other = raw_image(whole(k), START + 0.1 * k, "16UC1")
        other.header.frame_id = "camera_depth_optical_frame"
        messages.add(UNALIGNED, other)
    path = messages.write(tmp_path / "drive.bag")
    drive = open_dataset(path)
    assert (drive.has_depth, drive[0].depth) == (False, None)
    assert drive.remarks == (f"{UNALIGNED} is not registered to {COLOUR}: the depth is not used; record {ALIGNED}",)
    with pytest.raises(DataError, match=f"found left ones only .{UNALIGNED} is not registered"):
        open_for_odometry(DatasetSpec(path), mono=False)


def test_depth_in_the_frame_of_the_colour_is_registered(tmp_path: Path) -> None:
    """In the bags of TUM RGB-D the depth topic is /camera/depth/image, and its frame that of the colour camera."""
    path = write(tmp_path / "drive.bag", {"/camera/depth/image": "32FC1"}, colour="/camera/rgb/image_color")
    depth = open_dataset(path)[2].depth
    assert depth is not None
    np.testing.assert_allclose(depth, true_depth(2), atol=1e-6)


def test_one_camera_and_its_places_need_no_depth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "drive.bag", {ALIGNED: "16UC1"})

    def fail(*_: object) -> None:
        raise AssertionError("depth was decoded")

    monkeypatch.setattr("slam.datasets.formats.rosbag_dataset.open_depth_topic", fail)
    assert open_for_odometry(DatasetSpec(path), mono=True)[1].depth is None
    assert number_of(open_images(DatasetSpec(path))[1]) == 1
    with pytest.raises(AssertionError):
        open_dataset(path)


def test_damaged_depth_leaves_one_camera(tmp_path: Path) -> None:
    messages = Messages().images(COLOUR, [0.0, 0.1]).add("/camera/color/camera_info", Info().message())
    for k in range(2):
        messages.add(ALIGNED, raw_image(np.zeros((*SIZE[::-1], 3), np.uint8), START + 0.1 * k, "rgb8"))
    drive = open_dataset(messages.write(tmp_path / "drive.bag"))
    assert not drive.has_depth
    (remark,) = drive.remarks
    assert "expected depth in one of the encodings 16uc1, mono16, 32fc1, found 'rgb8'" in remark
    assert remark.endswith("the depth is not used")


def test_camera_toml_names_topic_and_scale(tmp_path: Path) -> None:
    path = write(tmp_path / "drive.bag", {"/wrist/depth/special": "16UC1", ALIGNED: "16UC1"})
    numbers = f"fx = {FX}\nfy = {FX}\ncx = {CX}\ncy = {CY}\n"
    toml = tmp_path / "camera.toml"
    toml.write_text(f'{numbers}depth = "/wrist/depth/special"\ndepth_scale = 500\n')
    depth = open_dataset(path)[2].depth
    assert depth is not None
    np.testing.assert_allclose(depth, 2 * true_depth(2), rtol=1e-6)
    toml.write_text(f'{numbers}depth = "/wrist/depth/raw"\n')
    with pytest.raises(DataError, match=r"expected a depth topic /wrist/depth/raw, found .*special; check depth"):
        open_dataset(path)


@pytest.mark.parametrize(
    ("depth", "colour", "registered"),
    [
        (ALIGNED, COLOUR, True),
        (ALIGNED, "/camera/infra1/image_rect_raw", False),
        (UNALIGNED, "/camera/infra1/image_rect_raw", True),
        (UNALIGNED, COLOUR, False),
        ("/depth_to_rgb/image_raw", "/rgb/image_raw", True),
        ("/depth/image_raw", "/rgb/image_raw", False),
        ("/camera/depth_registered/image_raw", "/camera/rgb/image_color", True),
        ("/camera/depth/image_raw", "/camera/rgb/image_color", False),
    ],
)
def test_names_tell_what_depth_is_registered_to(depth: str, colour: str, registered: bool) -> None:
    assert is_registered(depth, colour) is registered
    if not registered and "infra" not in colour:
        assert is_registered(registered_topic(depth, colour), colour)


def test_of_several_topics_the_nearest_is_chosen() -> None:
    both = (f"/a{ALIGNED}", f"/b{ALIGNED}")
    assert choose_depth(both, f"/b{COLOUR}") == both[1]
    rectified = ("/camera/depth_registered/image_rect", "/camera/depth_registered/image_raw")
    assert choose_depth(rectified, "/camera/rgb/image_color") == rectified[1]
    assert choose_depth(rectified, "/camera/rgb/image_rect_color") == rectified[0]
    assert depth_topics([COLOUR, ALIGNED, f"{ALIGNED}/compressedDepth"]) == [ALIGNED]
    assert depth_topics([COLOUR, f"{ALIGNED}/compressedDepth"]) == [f"{ALIGNED}/compressedDepth"]


def test_a_depth_image_serves_two_colour_images_and_is_decoded_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    messages = Messages().images(COLOUR, [k * 0.06 for k in range(4)])
    messages.add("/camera/color/camera_info", Info().message(), START)
    for k, stamp in enumerate((0.03, 0.15)):
        messages.add(ALIGNED, raw_image(whole(k), START + stamp, "16UC1"))
    drive = open_dataset(messages.write(tmp_path / "drive.bag"))
    decoded: list[object] = []

    def decode(message: object, scale: float) -> np.ndarray:
        decoded.append(message)
        return decode_depth(message, scale)

    monkeypatch.setattr("slam.datasets.formats.rosbag_file.decode_depth", decode)
    for frame, number in zip(drive, (0, 0, 1, 1), strict=True):
        assert frame.depth is not None
        np.testing.assert_allclose(frame.depth, true_depth(number), atol=1e-6)
    assert len(decoded) == 2


def test_colour_of_a_bag_is_read_beside_its_grey_images(tmp_path: Path) -> None:
    colours = [np.random.default_rng(k).integers(0, 255, (*SIZE[::-1], 3), dtype=np.uint8) for k in range(3)]
    messages = Messages().add("/camera/color/camera_info", Info().message())
    for k, colour in enumerate(colours):
        messages.add(COLOUR, raw_image(colour, START + 0.1 * k, "rgb8"))
    drive = open_dataset(messages.write(tmp_path / "drive.bag"))
    for k in (0, 2, 1):
        np.testing.assert_array_equal(drive.read_color(k), colours[k])
        assert drive[k].left.ndim == 2
    grey = open_dataset(write(tmp_path / "grey.bag", {}))
    assert grey.read_color(1) is None
    assert grey.read_color(2) is None
