"""Bags as drivers and recorders leave them: times, calibrations and images with faults are put right or named."""

import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.registry import open_dataset, open_for_odometry, open_images
from slam.datasets.formats.rosbag_file import is_bag
from slam.errors import DataError

from ..bags import (
    BASELINE,
    CX,
    CY,
    FX,
    SIZE,
    START,
    Info,
    Messages,
    compressed,
    encoded,
    number_of,
    picture,
    raw_image,
)
from ..layouts import BagStyle, taken, write_bag

LEFT, RIGHT = "/stereo/left/image_raw", "/stereo/right/image_raw"
STEPS = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]


def one_camera(stamps: list[float], info: Info | None = None) -> Messages:
    messages = Messages().images("/cam/image_raw", stamps)
    return messages.add("/cam/camera_info", (info or Info()).message(), START)


def a_pair(left: Info, right: Info) -> Messages:
    messages = Messages().images(LEFT, STEPS).images(RIGHT, STEPS)
    messages.add("/stereo/left/camera_info", left.message(), START)
    return messages.add("/stereo/right/camera_info", right.message(), START)


NAN = float("nan")
ORDERS: dict[str, tuple[list[float], list[int], str]] = {
    "in order": (STEPS, [0, 1, 2, 3, 4, 5], ""),
    "the first has no time": ([NAN, 0.1, 0.2, 0.3, 0.4, 0.5], [1, 2, 3, 4, 5], "without a time stamp left out: 1"),
    "two exchanged": ([0.0, 0.1, 0.3, 0.2, 0.4, 0.5], [0, 1, 3, 2, 4, 5], "later than .* sorted: 1, .* image 3"),
    "one twice": ([0.0, 0.1, 0.1, 0.3, 0.4, 0.5], [0, 1, 3, 4, 5], "left out as copies: 1, .* image 2"),
    "one late by seconds": ([2.0, 3.0, 4.0, 0.5, 5.0, 6.0], [3, 0, 1, 2, 4, 5], "sorted: 1, .* image 3"),
    "a clock that was set after the start": ([-1e9, 0.1, 0.2, 0.3, 0.4, 0.5], [1, 2, 3, 4, 5], "days away .* out: 1"),
}


@pytest.mark.parametrize("case", ORDERS)
def test_images_are_in_the_order_of_their_time_stamps(tmp_path: Path, case: str) -> None:
    stamps, order, remark = ORDERS[case]
    dataset = open_dataset(one_camera(stamps).write(tmp_path / "drive.bag"))
    assert [number_of(frame.left) for frame in dataset] == order
    np.testing.assert_allclose(dataset.timestamps, [START + stamps[k] for k in order], rtol=0, atol=1e-6)
    assert number_of(dataset[2].left) == order[2]  # by index too
    if remark:
        assert re.search(remark, " ".join(dataset.remarks))
    else:
        assert dataset.remarks == ()


@pytest.mark.parametrize(
    ("stamps", "remark"),
    [
        ([NAN] * 6, "the images have no time stamps: the times of receipt are used"),
        ([0.0, 0.0, 0.0, 1.0, 1.0, 1.0], "only 2 of 6 time stamps are different: the times of receipt are used"),
        ([5.0, 6.0, 7.0, 5.1, 6.1, 7.1], "set back by 1.9 s at image 3: the times of receipt are used"),
    ],
)
def test_times_of_receipt_stand_in_for_stamps_that_tell_no_order(
    tmp_path: Path, stamps: list[float], remark: str
) -> None:
    dataset = open_dataset(one_camera(stamps).write(tmp_path / "drive.bag"))
    np.testing.assert_allclose(dataset.timestamps, START + 0.01 + 0.1 * np.arange(6), rtol=0, atol=1e-6)
    assert [number_of(frame.left) for frame in dataset] == list(range(6))
    assert remark in dataset.remarks[0]


def test_places_know_what_was_left_out(tmp_path: Path) -> None:
    path = Messages().images("/cam/image_raw", [0.0, 0.1, 0.1, 0.3]).write(tmp_path / "drive.bag")
    images = open_images(DatasetSpec(path))
    assert [number_of(images[k]) for k in range(3)] == [0, 1, 3]
    assert "left out as copies: 1" in images.remarks[0]


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
@pytest.mark.parametrize("damage", ["cut", "empty", "other bytes", "without its end"])
def test_a_damaged_compressed_image_is_left_out_and_named(tmp_path: Path, suffix: str, damage: str) -> None:
    whole = encoded(picture(3), suffix)
    if damage == "without its end" and suffix == ".webp":
        pytest.skip("the decoder itself tells")
    cut = {"cut": whole[:40], "empty": b"", "other bytes": b"no image at all", "without its end": whole[:-20]}
    messages = Messages().add("/cam/camera_info", Info().message(), START)
    for number in range(6):
        data = encoded(picture(number), suffix) if number != 3 else cut[damage]
        messages.add("/cam/image_raw/compressed", compressed(data, START + 0.1 * number, suffix[1:]))
    dataset = open_dataset(messages.write(tmp_path / "drive.bag"))
    assert [round(number_of(frame.left)) for frame in dataset] == pytest.approx([0, 1, 2, 4, 5], abs=4)
    assert len(dataset) == 5
    assert "/cam/image_raw/compressed, message 3: expected a compressed image, found" in dataset.remarks[0]
    assert "left out" in dataset.remarks[0]


def test_a_raw_image_that_is_cut_is_left_out_and_named(tmp_path: Path) -> None:
    messages = one_camera(STEPS)
    row = messages.rows[2]
    row[2].data = row[2].data[:-9]
    dataset = open_dataset(messages.write(tmp_path / "drive.bag"))
    assert [number_of(frame.left) for frame in dataset] == [0, 1, 3, 4, 5]
    assert "/cam/image_raw, message 2: expected 48 rows of 64 bytes" in dataset.remarks[0]


def test_where_no_image_can_be_decoded_the_encoding_is_named(tmp_path: Path) -> None:
    messages = Messages().add("/cam/image", raw_image(np.zeros((48, 64), np.float32), START, "32FC1"))
    with pytest.raises(DataError, match=r"/cam/image, message 0 and all others: expected one of .*found '32FC1'"):
        open_images(DatasetSpec(messages.write(tmp_path / "drive.bag")))


def test_a_lost_left_image_takes_its_right_one_with_it(tmp_path: Path) -> None:
    messages = a_pair(Info(), Info(offset=BASELINE))
    messages.rows[2][2].data = messages.rows[2][2].data[:1]
    dataset = open_dataset(messages.write(tmp_path / "drive.bag"))
    assert [number_of(frame.left) for frame in dataset] == [0, 1, 3, 4, 5]
    assert all(np.array_equal(frame.left, frame.right) for frame in dataset)
    assert any("1 images without a partner" in remark for remark in dataset.remarks)


def deep(values: np.ndarray, low: int, high: int) -> np.ndarray:
    """Grey values 0 to 255 as values between two others."""
    return np.rint(low + values.astype(float) * (high - low) / 255).astype(np.uint16)


@pytest.mark.parametrize(("low", "high"), [(0, 1023), (0, 4095), (0, 16383), (0, 65535), (7000, 8020), (29000, 31000)])
@pytest.mark.parametrize("suffix", ["", ".png"])
def test_sixteen_bits_are_scaled_by_the_range_of_the_sensor(tmp_path: Path, low: int, high: int, suffix: str) -> None:
    pictures = [np.tile(np.arange(0, 256, 4, dtype=np.uint8), (48, 1)) // (1 + k) for k in range(3)]
    messages = Messages()
    for number, grey in enumerate(pictures):
        values, stamp = deep(grey, low, high), START + 0.1 * number
        message = compressed(encoded(values, suffix), stamp, "mono16; png compressed") if suffix else None
        messages.add("/cam/image", message or raw_image(values, stamp, "mono16"))
    images = open_images(DatasetSpec(messages.write(tmp_path / "drive.bag")))
    is_stretched = (low, high) in ((7000, 8020), (29000, 31000))
    for number, grey in enumerate(pictures):  # one scale: the brightness of images is kept
        np.testing.assert_allclose(images[number].astype(float), grey, atol=6 if is_stretched else 1)


def test_both_cameras_of_a_pair_have_one_scale(tmp_path: Path) -> None:
    messages = a_pair(Info(), Info(offset=BASELINE))
    messages.rows = [row for row in messages.rows if "image" not in row[0]]
    for number in range(3):
        messages.add(LEFT, raw_image(deep(picture(number), 0, 4095), START + 0.1 * number, "mono16"))
        messages.add(RIGHT, raw_image(deep(picture(number), 0, 16383), START + 0.1 * number, "mono16"))
    frame = open_dataset(messages.write(tmp_path / "drive.bag"))[1]
    assert frame.right is not None
    assert np.abs(frame.right.astype(float) - 4.0 * frame.left).max() <= 4


@pytest.mark.parametrize(
    ("info", "topic", "found"),
    [
        ("/camera/depth/camera_info", "/camera/color/image_raw", r"/camera/depth/camera_info of other cameras"),
        ("/stereo/left/camera_info", "/stereo/right/image_raw", r"/stereo/left/camera_info of other cameras"),
        ("/cam/camera_info_right", "/cam/image_left", r"/cam/camera_info_right of other cameras"),
        ("/cam/depth_info", "/cam/image_raw", r"/cam/depth_info of other cameras"),
    ],
)
def test_the_calibration_of_another_camera_is_not_used(tmp_path: Path, info: str, topic: str, found: str) -> None:
    messages = Messages().images(topic, STEPS).add(info, Info().message(), START)
    path = messages.write(tmp_path / "drive.bag")
    with pytest.raises(DataError, match=rf"expected a CameraInfo for {topic}, found {found}; write camera.toml"):
        open_dataset(path)
    assert len(open_images(DatasetSpec(path))) == 6


@pytest.mark.parametrize(
    ("info", "topics"),
    [
        ("/rig/camera_info", ("/rig/front/image_raw", "/rig/rear/image_raw")),
        ("/rig/depth_camera_info", ("/rig/front/image_raw",)),
        ("/cam/camera_info", ("/cam/image_front", "/cam/image_rear")),
    ],
)
def test_a_calibration_that_may_be_of_several_cameras_is_of_none(
    tmp_path: Path, info: str, topics: tuple[str, ...]
) -> None:
    messages = Messages().add(info, Info().message(), START)
    for topic in topics:
        messages.images(topic, STEPS)
    with pytest.raises(DataError, match=rf"expected a CameraInfo for {topics[0]}, found {info} of other cameras"):
        open_dataset(DatasetSpec(messages.write(tmp_path / "drive.bag"), topics=topics[:1]))


@pytest.mark.parametrize(
    ("info", "topic"),
    [
        ("/cam/camera_info", "/cam/image_raw"),
        ("/cam/camera_info", "/cam/image_rect_color/compressed"),
        ("/cam/camera_info_left", "/cam/image_left"),
        ("/cam/left_camera_info", "/cam/left_image_raw"),
        ("/camera_info", "/camera"),
        ("/device_0/sensor_1/Color_0/info/camera_info", "/device_0/sensor_1/Color_0/image/data"),
        ("/cam/image/camera_info", "/cam/image"),
        ("/cam/camera_info", "/cam/front/image_raw"),
    ],
)
def test_the_calibration_of_the_camera_is_found_by_its_name(tmp_path: Path, info: str, topic: str) -> None:
    messages = Messages().add(info, Info().message(), START)
    for number in range(3):
        stamp = START + 0.1 * number
        is_packed = topic.endswith("compressed")
        picked = compressed(encoded(picture(number)), stamp) if is_packed else raw_image(picture(number), stamp)
        messages.add(topic, picked)
    dataset = open_dataset(messages.write(tmp_path / "drive.bag"))
    assert dataset.camera.fx == FX
    assert any("is taken for" in remark for remark in dataset.remarks) == (topic == "/cam/front/image_raw")


def test_the_first_usable_camera_info_counts(tmp_path: Path) -> None:
    messages = Messages().images("/cam/image_raw", STEPS)
    for number, fx in enumerate((0.0, 0.0, FX, 2 * FX)):
        messages.add("/cam/camera_info", Info(fx=fx).message(), START + 0.1 * number)
    dataset = open_dataset(messages.write(tmp_path / "drive.bag"))
    assert dataset.camera.fx == FX
    assert "passed over before the first usable one: 2 (expected positive focal lengths" in dataset.remarks[0]


def test_a_camera_info_that_changes_is_named_with_its_message(tmp_path: Path) -> None:
    messages = Messages().images("/cam/image_raw", STEPS)
    for number, fx in enumerate((FX, FX, FX, 2 * FX, 0.0, 2 * FX)):
        messages.add("/cam/camera_info", Info(fx=fx).message(), START + 0.1 * number)
    dataset = open_dataset(messages.write(tmp_path / "drive.bag"))
    assert dataset.camera.fx == FX
    assert dataset.remarks == (
        "/cam/camera_info: 2 CameraInfo differ from the one that is used for all images, the first is message 3; split"
        " the recording there",
    )


def test_a_camera_info_that_does_not_change_is_not_worth_a_word(tmp_path: Path) -> None:
    messages = Messages().images("/cam/image_raw", STEPS)
    for number in range(6):
        messages.add("/cam/camera_info", Info().message(), START + 0.1 * number)
    assert open_dataset(messages.write(tmp_path / "drive.bag")).remarks == ()


@pytest.mark.parametrize(
    ("info", "camera"),
    [
        (Info(2 * FX, (128, 96), (62.0, 46.0), binning=(2, 2)), (FX, CX, CY)),
        (Info(FX, (64, 88), (CX, CY + 40), roi=(0, 40, 48, 64)), (FX, CX, CY)),
        (Info(2 * FX, (148, 116), (82.0, 66.0), binning=(2, 2), roi=(20, 20, 96, 128)), (FX, CX, CY)),
        (Info(binning=(1, 1)), (FX, CX, CY)),
    ],
)
def test_binning_and_region_of_interest_are_applied(
    tmp_path: Path, info: Info, camera: tuple[float, float, float]
) -> None:
    right = Info(info.fx, info.size, info.centre, BASELINE, binning=info.binning, roi=info.roi)
    dataset = open_dataset(a_pair(info, right).write(tmp_path / "drive.bag"))
    found = dataset.camera
    assert (found.fx, found.cx, found.cy) == pytest.approx(camera)
    assert found.baseline == pytest.approx(BASELINE)
    assert (found.width, found.height) == SIZE


def test_binning_that_is_not_stated_is_named_as_the_cause(tmp_path: Path) -> None:
    path = one_camera(STEPS, Info(2 * FX, (128, 96))).write(tmp_path / "drive.bag")
    with pytest.raises(DataError, match=r"images of 128 x 96, found 64 x 48: were they binned, cropped or resized\?"):
        open_dataset(path)
    path = one_camera(STEPS, Info(2 * FX, (128, 96), binning=(4, 4))).write(tmp_path / "other.bag")
    with pytest.raises(DataError, match=r"of 128 x 96, or of 32 x 24 by its binning and roi, found 64 x 48"):
        open_dataset(path)


D14 = (-0.3, 0.08, 0.002, -0.001, 0.01, 0.02, -0.01, 0.001, 0.002, 0.001, -0.002, 0.001, 0.02, -0.01)


@pytest.mark.parametrize("model", ["plumb_bob", "rational_polynomial"])
@pytest.mark.parametrize("count", [4, 5, 8, 12, 14])
def test_every_count_of_coefficients_straightens_as_opencv_does(tmp_path: Path, model: str, count: int) -> None:
    info = Info(model=model, D=D14[:count])
    frame = open_dataset(one_camera(STEPS, info).write(tmp_path / "drive.bag"))[0]
    K = np.array([[FX, 0, CX], [0, FX, CY], [0, 0, 1]])
    expected = cv2.undistort(picture(0), K, np.array(D14[:count]))
    assert np.abs(frame.left.astype(float) - expected).mean() < 1.0
    assert np.abs(frame.left.astype(float) - picture(0)).mean() > 2.0


@pytest.mark.parametrize(
    ("topic", "is_straightened"),
    [
        ("/direct_front/left/image_raw", True),
        ("/correct/image", True),
        ("/cam/image_direct", True),
        ("/cam/image_rect", False),
        ("/cam/image_rect_color", False),
        ("/cam/image_rectified", False),
        ("/cam/image_rect_raw", False),
    ],
)
def test_rect_is_a_word_of_the_last_part_of_a_topic(tmp_path: Path, topic: str, is_straightened: bool) -> None:
    messages = Messages().images(topic, STEPS)
    messages.add(f"{topic.rpartition('/')[0]}/camera_info", Info(D=(-0.3, 0.1, 0, 0, 0)).message(), START)
    frame = open_dataset(messages.write(tmp_path / "drive.bag"))[0]
    assert np.array_equal(frame.left, picture(0)) != is_straightened


def test_one_camera_is_opened_without_a_word_about_the_right_one(tmp_path: Path) -> None:
    path = a_pair(Info(), Info(fx=0.0)).write(tmp_path / "drive.bag")
    dataset = open_dataset(DatasetSpec(path, left_only=True))
    assert not dataset.has_right
    assert dataset.remarks == ()
    both = open_dataset(path)
    assert not both.has_right
    assert "/stereo/right/camera_info: expected positive focal lengths" in both.remarks[0]


def test_a_baseline_to_a_camera_that_is_not_rectified_is_none(tmp_path: Path) -> None:
    path = a_pair(Info(has_projection=False), Info(offset=BASELINE)).write(tmp_path / "drive.bag")
    dataset = open_dataset(path)
    assert not dataset.has_right
    assert "neither CameraInfo (P of both cameras) nor camera.toml has a baseline" in dataset.remarks[0]
    with pytest.raises(
        DataError, match=r"found left ones only \(neither CameraInfo \(P of .*; use one camera with --mo"
    ):
        open_for_odometry(DatasetSpec(path), mono=False)


def spoil(path: Path, kind: str) -> Path:
    data = path.read_bytes()
    if kind == "not indexed":
        at = data.index(b"index_pos=") + len(b"index_pos=")
        data = data[:at] + bytes(8) + data[at + 8 :]
    elif kind in ("cut", "cut at its end"):
        data = data[: len(data) // 2] if kind == "cut" else data[:-8]
    target = path.with_name(f"{path.name}.active" if kind == "active" else path.name)
    target.write_bytes(data)
    return target


@pytest.mark.parametrize(
    ("storage", "kind", "remedy"),
    [
        ("ros1", "not indexed", r"not indexed.*type: rosbag reindex .*drive\.bag$"),
        ("ros1", "cut", r"type: rosbag reindex .*drive\.bag$"),
        (
            "ros1",
            "active",
            r"was killed; type: rosbag reindex .*\.active, and rename it to drive",
        ),
        ("mcap", "cut", r"type: mcap recover .*\.mcap -o recovered\.mcap"),
        ("mcap", "cut at its end", r"type: mcap recover .*\.mcap -o recovered\.mcap"),
        ("sqlite3", "cut", r"type: sqlite3 .*\.db3 \.recover \| sqlite3 recovered\.db3"),
    ],
)
def test_a_recording_that_was_cut_off_names_what_recovers_it(
    tmp_path: Path, storage: str, kind: str, remedy: str
) -> None:
    written = write_bag(tmp_path, taken("ideal", 3), BagStyle(storage))
    file = written if written.is_file() else next(f for f in written.iterdir() if f.suffix in (".mcap", ".db3"))
    path = spoil(file, kind)
    assert is_bag(path)
    with pytest.raises(DataError, match=remedy):
        open_dataset(path)


def test_a_folder_whose_recorder_was_killed_is_indexed_again(tmp_path: Path) -> None:
    folder = write_bag(tmp_path, taken("ideal", 3), BagStyle("sqlite3"))
    (folder / "metadata.yaml").unlink()
    assert is_bag(folder)
    with pytest.raises(DataError, match=rf"type: ros2 bag reindex {folder}"):
        open_dataset(folder)
    (folder / "camera.toml").touch()
    assert not is_bag(folder)  # a bag may lie in a folder of other things
