"""Folders and videos as people have them: stray pictures, odd names, half a pair, layouts of other data sets."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.image_sequence import are_seconds, sort_by_name
from slam.datasets.formats.registry import detect_format, open_dataset, open_for_odometry, open_images
from slam.datasets.video import VIDEO_SUFFIXES
from slam.diagnostics.dataset_checks import inspect_dataset
from slam.diagnostics.findings import Use
from slam.errors import DataError

from ..layouts import RATE, Taken, camera_toml, taken, write_euroc, write_folders, write_tum_rgbd, write_video

IDEAL = "fx = 260\nfy = 260\ncx = 160\ncy = 118\n"


@pytest.fixture(scope="module")
def rough() -> Taken:
    return taken("radtan")


@pytest.fixture(scope="module")
def ideal() -> Taken:
    return taken("ideal")


def usable(path: Path) -> tuple[str, ...]:
    return inspect_dataset(DatasetSpec(path), lambda done, total: None).possible_uses


def write_names(folder: Path, drive: Taken, names: list[str]) -> Path:
    """The left images under these names, in the order of the names."""
    folder.mkdir(parents=True)
    for name, (left, _) in zip(names, drive.pairs, strict=True):
        assert cv2.imwrite(str(folder / name), left)
    return folder


def assert_left_images(path: Path, drive: Taken, blur: float = 0.0) -> None:
    images = open_images(DatasetSpec(path, fps=RATE))
    assert len(images) == len(drive.pairs)
    for index, (left, _) in enumerate(drive.pairs):
        assert np.abs(images[index].astype(float) - left).mean() <= blur


# The left camera alone.


def turn_around(root: Path) -> None:
    text = (root / "mav0/cam0/sensor.yaml").read_text(), (root / "mav0/cam1/sensor.yaml").read_text()
    (root / "mav0/cam0/sensor.yaml").write_text(text[1])
    (root / "mav0/cam1/sensor.yaml").write_text(text[0])


RIGHT: dict[str, Callable[[Path], object]] = {
    "to the left": turn_around,
    "not described": lambda r: (r / "mav0/cam1/sensor.yaml").unlink(),
    "described by no YAML": lambda r: (r / "mav0/cam1/sensor.yaml").write_text("a: ["),
    "without its images": lambda r: shutil.rmtree(r / "mav0/cam1/data"),
    "of another time": lambda r: (r / "mav0/cam1/data.csv").write_text("1,a.png\n2,b.png\n"),
    "short": lambda r: (r / "mav0/cam1/data.csv").write_text("#t,f\n"),
}


@pytest.mark.parametrize("fault", RIGHT)
def test_the_left_camera_of_euroc_is_read_whatever_the_right_one_is(tmp_path: Path, rough: Taken, fault: str) -> None:
    root = write_euroc(tmp_path / "MH", rough)
    RIGHT[fault](root)
    with pytest.raises(DataError, match=r"cam1|sensor.yaml"):
        open_for_odometry(DatasetSpec(root), mono=False)
    mono, images = open_for_odometry(DatasetSpec(root), mono=True), open_images(DatasetSpec(root))
    assert (len(mono), len(images), mono.has_right) == (5, 5, False)
    np.testing.assert_array_equal(mono[2].left, images[2])
    assert usable(root) == (Use.MONO, Use.PLACES)


def test_left_images_are_those_of_a_run_with_both_cameras(tmp_path: Path, rough: Taken) -> None:
    root = write_euroc(tmp_path / "MH", rough)
    both, one = open_dataset(root), open_for_odometry(DatasetSpec(root), mono=True)
    assert both.camera == one.camera
    np.testing.assert_array_equal(both[3].left, one[3].left)


@pytest.mark.parametrize("fault", ["a right image is missing", "right images are damaged", "right camera to the left"])
def test_the_left_folder_is_read_whatever_the_right_one_is(tmp_path: Path, rough: Taken, fault: str) -> None:
    root = write_folders(tmp_path / "mine", rough, fps=RATE)
    if fault == "a right image is missing":
        (root / "right/9.png").unlink()
    elif fault == "right images are damaged":
        (root / "right/9.png").write_bytes(b"")
    else:
        text = (root / "camera.toml").read_text()
        (root / "camera.toml").write_text(re.sub(r"T_left_right.*", "T_left_right = [[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]", text))  # fmt: skip  # noqa: E501
    assert usable(root) == (Use.MONO, Use.PLACES)
    assert len(open_for_odometry(DatasetSpec(root), mono=True)) == len(open_images(DatasetSpec(root))) == 5


# Stray pictures and names.


@pytest.mark.parametrize("names", [("left", "right"), ("cam0", "cam1"), ("image_left", "image_right")])
def test_a_picture_beside_two_folders_decides_nothing(tmp_path: Path, ideal: Taken, names: tuple[str, str]) -> None:
    root = write_folders(tmp_path / "mine", ideal, names)
    (root / "camera.toml").write_text(IDEAL + "baseline = 0.3\nfps = 20\n")
    cv2.imwrite(str(root / "preview.png"), np.zeros((50, 50), np.uint8))
    drive = open_for_odometry(DatasetSpec(root), mono=False)
    assert (len(drive), drive.has_right) == (5, True)
    (root / "camera.toml").unlink()
    assert_left_images(root, ideal)


def test_a_picture_beside_one_folder_or_one_video_decides_nothing(tmp_path: Path, ideal: Taken) -> None:
    write_names(tmp_path / "a" / "frames", ideal, [f"{k}.png" for k in range(5)])
    write_video(tmp_path / "b" / "drive.avi", [left for left, _ in ideal.pairs])
    for root in (tmp_path / "a", tmp_path / "b"):
        cv2.imwrite(str(root / "preview.png"), np.zeros((50, 50), np.uint8))
        assert_left_images(root, ideal, blur=6.0)


def test_left_and_right_images_in_one_folder_are_named(tmp_path: Path, ideal: Taken) -> None:
    names = [("{}_left", "{}_right"), ("Left{}", "Right{}"), ("l_{}", "r_{}"), ("cam0_{}", "cam1_{}"), ("{}-L", "{}-R")]
    names += [("leftimg{:04d}", "rightimg{:04d}"), ("camLeft{}", "camRight{}")]
    for number, (first, second) in enumerate(names):
        root = tmp_path / str(number)
        root.mkdir()
        for k, (left, right) in enumerate(ideal.pairs):
            cv2.imwrite(str(root / f"{first.format(k)}.png"), left)
            cv2.imwrite(str(root / f"{second.format(k)}.png"), right)
        with pytest.raises(DataError, match=r"found those of two, such as .*; move them into two folders called left"):
            open_images(DatasetSpec(root))
        (root / "camera.toml").write_text(IDEAL + "fps = 20\n")
        assert usable(root) == ()


@pytest.mark.parametrize(
    "names",
    [
        ["1700000000.05", "1700000000.1", "1700000000.1637", "1700000000.25", "1700000001.0"],
        ["1.05", "1.4", "1.5", "2", "10.25"],
        ["left_1700000000.05", "left_1700000000.1", "left_1700000000.25", "left_1700000000.3", "left_1700000000.35"],
        ["1.9", "1.10", "1.11", "2.1", "2.20"],  # numbers of a part and of an image in it
        ["1.000000005", "1.000000010", "1.000000100", "1.500000000", "2.000000000"],
        ["9", "10", "11", "100", "1000"],
        ["scan1_9", "scan1_10", "scan2_1", "scan10_1", "scan10_2"],
    ],
)
def test_names_are_sorted_as_seconds_or_as_numbers(tmp_path: Path, ideal: Taken, names: list[str]) -> None:
    folder = write_names(tmp_path / "mine", ideal, [f"{name}.png" for name in names])
    assert [file.stem for file in sort_by_name(folder.iterdir())] == names
    assert_left_images(folder, ideal)


def test_names_with_two_numbers_are_not_seconds() -> None:
    assert not are_seconds(["1.9", "1.10"])
    assert not are_seconds(["1.2.3", "1.2.4"])
    assert not are_seconds(["a1.5", "b1.6"])
    assert are_seconds(["1.50", "1.05"])


@pytest.mark.parametrize(("form", "unit"), [("{:.6f}", "seconds"), ("{:.0f}", "nanoseconds")])
def test_names_that_are_dates_are_times(tmp_path: Path, ideal: Taken, form: str, unit: str) -> None:
    scale = 1.0 if unit == "seconds" else 1e9
    names = [f"{form.format(time * scale)}.png" for time in ideal.times]
    folder = write_names(tmp_path / "mine", ideal, names)
    (folder / "camera.toml").write_text(IDEAL)
    drive = open_for_odometry(DatasetSpec(folder), mono=True)
    np.testing.assert_allclose(drive.timestamps, ideal.times, atol=1e-6)
    assert drive.remarks == (f"mine: the times are read from the names, as {unit}; --fps gives others",)
    np.testing.assert_allclose(open_for_odometry(DatasetSpec(folder, fps=2), mono=True).timestamps, np.arange(5) / 2)


@pytest.mark.parametrize("suffix", [".webp", ".jp2", ".pnm", ".jpeg", ".TIF"])
def test_images_of_many_kinds_are_read(tmp_path: Path, ideal: Taken, suffix: str) -> None:
    assert_left_images(write_names(tmp_path / "mine", ideal, [f"{k}{suffix}" for k in range(5)]), ideal, blur=9.0)


def test_files_that_are_not_read_are_named_with_the_remedy(tmp_path: Path) -> None:
    for name in ("1.heic", "2.heic", "cam.insv"):
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(DataError, match=r"but 2.heic, cam.insv; check the path; .* converted to png, .* to mp4"):
        detect_format(DatasetSpec(tmp_path))


# Videos.


@pytest.mark.parametrize("suffix", [".MTS", ".ts", ".3gp", ".m4v", ".webm", ".flv", ".m2ts", ".mkv", ".mjpeg"])
def test_videos_of_many_suffixes_are_read(tmp_path: Path, ideal: Taken, suffix: str) -> None:
    codec = {".webm": "VP80", ".flv": "FLV1", ".mjpeg": "MJPG"}.get(suffix, "mp4v")
    path = write_video(tmp_path / f"cam{suffix}", [left for left, _ in ideal.pairs], codec)
    for source in (path, tmp_path):
        assert_left_images(source, ideal, blur=9.0)


def test_camcorder_and_raspberry_suffixes_are_known() -> None:
    assert {".mts", ".ts", ".h264", ".264", ".hevc", ".3gp", ".m4v", ".webm", ".mp4", ".avi"} <= VIDEO_SUFFIXES


def test_the_rate_of_a_bare_stream_is_said_to_be_assumed(tmp_path: Path, ideal: Taken) -> None:
    path = write_video(tmp_path / "cam.mjpeg", [left for left, _ in ideal.pairs])
    (tmp_path / "camera.toml").write_text(IDEAL)
    drive = open_for_odometry(DatasetSpec(path), mono=True)
    assert drive.remarks == ("cam.mjpeg holds no times: 25 images a second are assumed; give --fps",)
    assert open_for_odometry(DatasetSpec(path, fps=10), mono=True).remarks == ()


@pytest.mark.parametrize("name", ["2024-05-01T12:30:05.mp4", "walk 100%d #1?.mp4", "http:a.mp4", "é.mp4"])
def test_a_video_may_have_any_name(tmp_path: Path, ideal: Taken, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    write_video(tmp_path / "a.mp4", [left for left, _ in ideal.pairs], "mp4v").rename(tmp_path / name)
    monkeypatch.chdir(tmp_path)
    assert_left_images(Path(name), ideal, blur=6.0)


def write_pair(root: Path, left: list[np.ndarray], right: list[np.ndarray], rates: tuple[float, float]) -> Path:
    write_video(root / "left.avi", left, rate=rates[0])
    write_video(root / "right.avi", right, rate=rates[1])
    (root / "camera.toml").write_text(IDEAL + "baseline = 0.3\n")
    return root


@pytest.mark.parametrize("fps", [None, 20.0])
def test_a_pair_of_videos_of_unequal_length_without_a_gap_is_refused(
    tmp_path: Path, ideal: Taken, fps: float | None
) -> None:
    left, right = ([pair[side] for pair in ideal.pairs] for side in (0, 1))
    root = write_pair(tmp_path, left, right[:2] + right[3:], (RATE, RATE))
    with pytest.raises(DataError, match=r"right.avi: expected 5 images as in left.avi, found 4, and no gap in the"):
        open_for_odometry(DatasetSpec(root, fps=fps), mono=False)
    assert len(open_for_odometry(DatasetSpec(root, fps=fps), mono=True)) == 5
    assert usable(root) == (Use.MONO, Use.PLACES)


def test_a_pair_of_videos_of_unequal_rate_is_paired_by_time(tmp_path: Path, ideal: Taken) -> None:
    left, right = ([pair[side] for pair in ideal.pairs] for side in (0, 1))
    drive = open_dataset(write_pair(tmp_path, left, right[::2], (RATE, RATE / 2)))
    assert drive.remarks == ("2 images without a partner in the other camera are left out",)
    for index, frame in enumerate(drive):
        assert np.abs(frame.left.astype(float) - left[2 * index]).mean() < 6.0
        assert np.abs(frame.right.astype(float) - right[2 * index]).mean() < 6.0


@pytest.mark.parametrize("name", ["v11_pair_fps", "v13_pair_mp4"])
def test_a_gap_in_the_right_video_is_a_gap_in_the_pairs(test_data: Path, name: str) -> None:
    drive = open_dataset(test_data / "field_cases" / name)
    assert drive.remarks == ("1 images without a partner in the other camera are left out",)
    np.testing.assert_allclose(drive.timestamps, np.delete(np.arange(15) / 10, 4), atol=1e-6)


def test_the_rate_of_the_user_is_that_of_a_pair_of_videos(tmp_path: Path, ideal: Taken) -> None:
    left, right = ([pair[side] for pair in ideal.pairs] for side in (0, 1))
    root = write_pair(tmp_path, left, right, (RATE, RATE))
    np.testing.assert_allclose(open_dataset(DatasetSpec(root, fps=4)).timestamps, np.arange(5) / 4, atol=1e-3)


# Layouts of other data sets.


def write_numbered(root: Path, left: list[int], right: list[int]) -> Path:
    """Two folders of images whose grey value is their number."""
    for side, numbers in (("left", left), ("right", right)):
        (root / side).mkdir(parents=True)
        for number in numbers:
            cv2.imwrite(str(root / side / f"{side}_{number:04d}.png"), np.full((48, 64), number, np.uint8))
    (root / "camera.toml").write_text("fx = 50\nfy = 50\ncx = 32\ncy = 24\nbaseline = 0.1\nfps = 10\n")
    return root


def without(*numbers: int) -> list[int]:
    return [number for number in range(1, 41) if number not in numbers]


@pytest.mark.parametrize(("left", "right"), [((30,), (36,)), ((), (36,))])
def test_two_folders_are_paired_by_the_numbers_in_their_names(
    tmp_path: Path, left: tuple[int, ...], right: tuple[int, ...]
) -> None:
    drive = open_dataset(write_numbered(tmp_path, without(*left), without(*right)))
    first = "right/right_0030.png" if left else "left/left_0036.png"
    assert drive.remarks == (
        f"images are paired by the numbers in their names; {first} is the first without a partner",
        f"{len(left) + len(right)} images without a partner in the other camera are left out",
    )
    kept = without(*left, *right)
    assert [(frame.left[0, 0], frame.right[0, 0]) for frame in drive] == [(number, number) for number in kept]
    np.testing.assert_allclose(drive.timestamps, (np.array(kept) - 1) / 10)


def test_numbers_that_pair_the_images_differently_from_their_order_are_refused(tmp_path: Path) -> None:
    root = write_numbered(tmp_path, [1, 2, 4, 5], [1, 2, 3, 5])
    with pytest.raises(DataError, match=r"right: expected an image of the number of left/left_0004.png, found right_0"):
        open_dataset(root)


def test_a_list_of_times_for_both_cameras_needs_the_same_numbers_in_both(tmp_path: Path) -> None:
    root = write_numbered(tmp_path, without(30), without(36))
    (root / "times.txt").write_text("".join(f"{0.1 * index}\n" for index in range(39)))
    with pytest.raises(DataError, match=r"expected an image of the number of left/left_0031.png, found right_0030.png"):
        open_dataset(root)


def test_cameras_that_count_from_different_numbers_are_paired_by_order(tmp_path: Path) -> None:
    drive = open_dataset(write_numbered(tmp_path, [1, 3, 5, 9], [2, 4, 6, 10]))
    assert [(frame.left[0, 0], frame.right[0, 0]) for frame in drive] == [(1, 2), (3, 4), (5, 6), (9, 10)]
    assert drive.remarks == ()


def write_kitti_raw(root: Path, drive: Taken, cameras: tuple[str, ...] = ("00", "01")) -> Path:
    """The raw data of KITTI: a calibration above the drive, one line of timestamps.txt for each image."""
    date = root / "2011_09_30"
    for side, camera in enumerate(cameras):
        folder = date / "2011_09_30_drive_0018_sync" / f"image_{camera}"
        (folder / "data").mkdir(parents=True)
        stamps = [f"2011-09-30 12:40:25.{round(k / RATE * 1e9):09d}\n" for k in range(len(drive.pairs))]
        (folder / "timestamps.txt").write_text("".join(stamps))
        for k, pair in enumerate(drive.pairs):
            cv2.imwrite(str(folder / "data" / f"{k:010d}.png"), pair[side % 2])
    lines = [f"P_rect_{c}: 260 0 160 {-78 * (k % 2)} 0 260 118 0 0 0 1 0" for k, c in enumerate(cameras)]
    (date / "calib_cam_to_cam.txt").write_text("\n".join(["calib_time: 09-Jan-2012 13:57:47", *lines, ""]))
    return root


@pytest.mark.parametrize("cameras", [("00", "01"), ("02", "03")])
@pytest.mark.parametrize("place", [".", "2011_09_30", "2011_09_30/2011_09_30_drive_0018_sync"])
def test_kitti_raw(tmp_path: Path, ideal: Taken, cameras: tuple[str, str], place: str) -> None:
    drive = open_dataset(write_kitti_raw(tmp_path, ideal, cameras) / place)
    assert (drive.name, len(drive), drive.has_right, drive.remarks) == ("2011_09_30_drive_0018_sync", 5, True, ())
    assert drive.camera.baseline == pytest.approx(0.3)
    assert drive.timestamps[0] == 1317386425.0
    np.testing.assert_allclose(np.diff(drive.timestamps), 1 / RATE, atol=1e-6)
    np.testing.assert_array_equal(drive[3].right, ideal.pairs[3][1])
    np.testing.assert_array_equal(open_images(DatasetSpec(tmp_path))[3], ideal.pairs[3][0])


def test_kitti_raw_is_paired_and_timed_by_its_numbers(tmp_path: Path, ideal: Taken) -> None:
    root = write_kitti_raw(tmp_path, ideal)
    folder = root / "2011_09_30/2011_09_30_drive_0018_sync"
    (folder / "image_00/data/0000000000.png").unlink()
    (folder / "image_01/data/0000000002.png").unlink()
    drive = open_dataset(root)
    assert drive.remarks == ("2 images without a partner in the other camera are left out",)
    np.testing.assert_allclose(drive.timestamps - 1317386425.0, np.array([1, 3, 4]) / RATE, atol=1e-6)
    np.testing.assert_array_equal(drive[1].left, ideal.pairs[3][0])
    np.testing.assert_array_equal(drive[1].right, ideal.pairs[3][1])


RAW_FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "no calibration": (
        lambda r: (r / "2011_09_30/calib_cam_to_cam.txt").unlink(),
        r"expected calib_cam_to_cam.txt \(KITTI\) or calibration/perspective.txt \(KITTI-360\)",
    ),
    "no right projection": (
        lambda r: (r / "2011_09_30/calib_cam_to_cam.txt").write_text("P_rect_00: 260 0 160 0 0 260 118 0 0 0 1 0\n"),
        r"calib_cam_to_cam.txt: expected a line 'P_rect_01: 12 numbers', found none",
    ),
    "too few times": (
        lambda r: (r / "2011_09_30/2011_09_30_drive_0018_sync/image_00/timestamps.txt").write_text("2011-09-30\n"),
        r"timestamps.txt: expected a time in line 5, for image 4, found 1 lines",
    ),
    "a time of words": (
        lambda r: (r / "2011_09_30/2011_09_30_drive_0018_sync/image_00/timestamps.txt").write_text("noon\n" * 5),
        r"timestamps.txt, line 1: expected a time such as 2011-09-30 .*, found 'noon'",
    ),
    "times that stand": (
        lambda r: (r / "2011_09_30/2011_09_30_drive_0018_sync/image_00/timestamps.txt").write_text("2011-09-30\n" * 5),
        r"timestamps.txt, line 2: expected increasing times, found 2011-09-30",
    ),
    "unrectified images": (
        lambda r: (r / "2011_09_30/2011_09_30_drive_0018_sync").rename(r / "2011_09_30/2011_09_30_drive_0018_extract"),
        r"_extract: expected rectified images, found raw ones; download the drive as synced\+rectified",
    ),
    "several drives": (
        lambda r: shutil.copytree(r / "2011_09_30/2011_09_30_drive_0018_sync", r / "2011_09_30/other_sync"),
        r"expected one drive, found 2011_09_30_drive_0018_sync, other_sync; choose one with --sequence",
    ),
}


@pytest.mark.parametrize("fault", RAW_FAULTS)
def test_faults_of_kitti_raw(tmp_path: Path, ideal: Taken, fault: str) -> None:
    spoil, message = RAW_FAULTS[fault]
    root = write_kitti_raw(tmp_path, ideal)
    spoil(root)
    with pytest.raises(DataError, match=message):
        open_for_odometry(DatasetSpec(root), mono=False)


def test_a_missing_right_folder_of_kitti_raw_leaves_one_camera(tmp_path: Path, ideal: Taken) -> None:
    root = write_kitti_raw(tmp_path, ideal)
    (root / "2011_09_30/2011_09_30_drive_0018_sync/image_01/data/0000000001.png").rename(
        root / "2011_09_30/2011_09_30_drive_0018_sync/image_01/data/one.png"
    )
    assert usable(root) == (Use.MONO, Use.PLACES)
    shutil.rmtree(root / "2011_09_30/2011_09_30_drive_0018_sync/image_01")
    assert usable(root) == (Use.MONO, Use.PLACES)
    assert len(open_for_odometry(DatasetSpec(root), mono=True)) == 5


def test_kitti_360(tmp_path: Path, ideal: Taken) -> None:
    source = write_kitti_raw(tmp_path / "raw", ideal) / "2011_09_30"
    root, drive_name = tmp_path / "KITTI-360", "2013_05_28_drive_0000_sync"
    (root / "calibration").mkdir(parents=True)
    (source / "calib_cam_to_cam.txt").rename(root / "calibration/perspective.txt")
    for camera in ("00", "01"):
        images = root / "data_2d_raw" / drive_name / f"image_{camera}"
        images.mkdir(parents=True)
        (source / f"2011_09_30_drive_0018_sync/image_{camera}/data").rename(images / "data_rect")
    drive = open_dataset(root, drive_name)
    assert (drive.name, len(drive), drive.has_right) == (drive_name, 5, True)
    np.testing.assert_allclose(drive.timestamps, np.arange(5) / 10)
    assert drive.remarks == ("image_00: no timestamps.txt: 10 images a second are assumed",)
    np.testing.assert_array_equal(drive[3].right, ideal.pairs[3][1])


def test_openloris_is_tum_with_another_name_of_the_list(tmp_path: Path, ideal: Taken) -> None:
    root = write_tum_rgbd(tmp_path / "cafe1-1", ideal)
    (root / "rgb").rename(root / "color")
    (root / "color.txt").write_text((root / "rgb.txt").read_text().replace(" rgb/", " color/"))
    (root / "rgb.txt").unlink()
    assert_left_images(root, ideal)
    with pytest.raises(DataError, match=r"camera.toml: expected the calibration.*of OpenLORIS .* in sensors.yaml"):
        open_dataset(root)
    (root / "camera.toml").write_text(IDEAL)
    drive = open_dataset(root)
    assert len(drive) == 5
    assert drive.ground_truth is not None
    assert "if its poses are those of the robot's base" in drive.remarks[0]


def test_tum_vi_takes_its_calibration_from_camera_toml(tmp_path: Path, rough: Taken) -> None:
    root = write_euroc(tmp_path / "room1", rough)
    (root / "mav0/state_groundtruth_estimate0").rename(root / "mav0/mocap0")
    truth = open_dataset(root).ground_truth
    assert truth is not None
    np.testing.assert_allclose(truth, rough.truth, atol=1e-5)
    for camera in ("cam0", "cam1"):
        (root / "mav0" / camera / "sensor.yaml").unlink()
    with pytest.raises(DataError, match=r"sensor.yaml: expected this file, .*room1/camera.toml \(of TUM-VI .*camchain"):
        open_dataset(root)
    (root / "camera.toml").write_text(camera_toml(rough.rig))
    drive = open_for_odometry(DatasetSpec(root), mono=False)
    np.testing.assert_array_equal(drive[2].right, rough.ideal.right(rough.pairs[2][1]))
    assert drive.ground_truth is None


def test_tum_vi_takes_its_calibration_from_the_camchain_in_dso(tmp_path: Path, rough: Taken) -> None:
    root, rig = write_euroc(tmp_path / "room1", rough), rough.rig
    lines = []
    for name, lens in (("cam0", rig.left), ("cam1", rig.right)):
        (root / "mav0" / name / "sensor.yaml").unlink()
        lines += [f"{name}:", "  camera_model: pinhole", f"  intrinsics: {[lens.fx, lens.fy, lens.cx, lens.cy]}"]
        lines += ["  distortion_model: radtan", f"  distortion_coeffs: {list(lens.coefficients)}"]
    lines += [f"  T_cn_cnm1: {np.linalg.inv(rig.T_left_right).tolist()}"]
    (root / "dso").mkdir()
    (root / "dso/camchain.yaml").write_text("\n".join(lines))
    drive = open_for_odometry(DatasetSpec(root), mono=False)
    np.testing.assert_array_equal(drive[2].right, rough.ideal.right(rough.pairs[2][1]))
    assert usable(root) == (Use.STEREO, Use.MONO, Use.PLACES)


LAYOUTS: dict[str, tuple[tuple[str, ...], str]] = {
    "TartanAir": (
        ("image_left/000000_left.png", "image_right/000000_right.png", "pose_left.txt"),
        "fx = 320, fy = 320",
    ),
    "TartanAir V2": (("image_lcam_front/000000_lcam_front.png", "image_rcam_front/0_rcam_front.png"), "cy = 320"),
    "4Seasons": (
        ("undistorted_images/cam0/1617.png", "undistorted_images/cam1/1617.png", "times.txt"),
        "name the folder",
    ),
}


@pytest.mark.parametrize("place", [".", ".."])
@pytest.mark.parametrize("name", LAYOUTS)
def test_the_layouts_of_other_data_sets_are_named_with_their_remedy(tmp_path: Path, name: str, place: str) -> None:
    files, remedy = LAYOUTS[name]
    for file in files:
        (tmp_path / "P000" / file).parent.mkdir(parents=True, exist_ok=True)
        if file.endswith(".png"):
            cv2.imwrite(str(tmp_path / "P000" / file), np.zeros((48, 64), np.uint8))
        else:
            (tmp_path / "P000" / file).write_text("1 2 3\n")
    with pytest.raises(DataError) as caught:
        open_dataset(tmp_path / "P000" / place)
    assert f"this is the layout of {name}: " in str(caught.value)
    assert remedy in str(caught.value)
    assert f"{tmp_path}/P000" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_remedy_for_tartanair_makes_it_readable(tmp_path: Path, ideal: Taken) -> None:
    root = tmp_path / "P000"
    for side, name in enumerate(("left", "right")):
        (root / f"image_{name}").mkdir(parents=True)
        for k, pair in enumerate(ideal.pairs):
            cv2.imwrite(str(root / f"image_{name}" / f"{k:06d}_{name}.png"), pair[side])
    (root / "pose_left.txt").write_text("0 0 0 0 0 0 1\n")
    (root / "camera.toml").write_text("fx = 320\nfy = 320\ncx = 160\ncy = 120\nbaseline = 0.25\nfps = 10\n")
    drive = open_for_odometry(DatasetSpec(root), mono=False)
    np.testing.assert_array_equal(drive[3].right, ideal.pairs[3][1])


# Pairs of 16 bits.


def make_deep(folder: Path, bits: int) -> None:
    """Turn images of 8 bits into images of 16 bits that use only the lowest."""
    for path in folder.glob("*.png"):
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        cv2.imwrite(str(path), grey.astype(np.uint16) << (bits - 8))


PAIRS = {
    "kitti": ("image_0", "image_1"),
    "kitti-raw": ("image_00", "image_01"),
    "euroc": ("cam0", "cam1"),
    "own-camera": ("left", "right"),
}


def write_layout(root: Path, name: str, drive: Taken, write_drive: Callable[..., Path]) -> Path:
    writers: dict[str, Callable[[], Path]] = {
        "kitti": lambda: write_drive(root),
        "kitti-raw": lambda: write_kitti_raw(root, drive),
        "euroc": lambda: write_euroc(root / "MH", drive),
        "own-camera": lambda: write_folders(root / "own", drive, fps=RATE),
    }
    return writers[name]()


@pytest.mark.parametrize(("name", "lost"), [*((name, False) for name in PAIRS), ("kitti-raw", True)])
def test_both_cameras_of_sixteen_bits_have_one_scale(
    tmp_path: Path, ideal: Taken, write_drive: Callable[..., Path], name: str, lost: bool
) -> None:
    root = write_layout(tmp_path, name, ideal, write_drive)
    before = open_dataset(root)[1]
    assert before.right is not None
    for camera, bits in zip(PAIRS[name], (10, 12), strict=True):
        for folder in [item for item in tmp_path.rglob("*") if camera in item.parts and item.is_dir()]:
            make_deep(folder, bits)
    if lost:
        max(tmp_path.rglob("image_01/data/*.png")).unlink()
    frame = open_dataset(root)[1]  # the scale is that of 12 bits, at which the left images are four times as dark
    assert frame.right is not None
    assert np.abs(frame.right.astype(float) - before.right).max() <= 1
    assert np.abs(frame.left.astype(float) - before.left / 4.0).max() <= 2
