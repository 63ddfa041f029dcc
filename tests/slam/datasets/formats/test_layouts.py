"""A dataset written in any layout is read back with the same frames, times and poses."""

from collections.abc import Callable
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from slam.cli import app
from slam.datasets.dataset import Dataset, DatasetSpec
from slam.datasets.formats.registry import FORMATS, detect_format, open_dataset, open_images
from slam.datasets.formats.rosbag_file import Bag
from slam.datasets.formats.rosbag_topics import choose_topics
from slam.datasets.prefetch import prefetch
from slam.io.metrics import read_metrics, write_metrics
from slam.io.trajectory_files import write_kitti, write_tum

from ..layouts import (
    ENCODED,
    RATE,
    BagStyle,
    Taken,
    camera_toml,
    finely,
    taken,
    write_bag,
    write_euroc,
    write_folders,
    write_tum_rgbd,
    write_video,
)
from ..rig import RIGS


@pytest.fixture(scope="module")
def rough() -> Taken:
    """Five pairs of two bent lenses that look a little past one another."""
    return taken("radtan")


def assert_frames(drive: Dataset, expected: Taken, blur: float = 0.0) -> None:
    ideal = expected.ideal
    assert len(drive) == len(expected.pairs)
    np.testing.assert_allclose(np.diff(drive.timestamps), 1 / RATE, atol=1e-4)
    for frame, (left, right) in zip(drive, expected.pairs, strict=True):
        assert_alike(frame.left, ideal.left(left), blur)
        assert frame.right is not None
        assert_alike(frame.right, ideal.right(right), blur)
    assert astuple(drive.camera) == pytest.approx(astuple(ideal.camera))


def assert_alike(image: np.ndarray, expected: np.ndarray, blur: float) -> None:
    """Equal, or as near as a lossy codec comes, grey values."""
    assert image.dtype == np.uint8
    assert np.abs(image.astype(float) - expected).mean() <= blur


def test_euroc(tmp_path: Path, rough: Taken) -> None:
    drive = open_dataset(write_euroc(tmp_path / "MH_01_easy", rough))
    assert (drive.name, drive.remarks) == ("MH_01_easy", ())
    assert_frames(drive, rough)
    assert drive.ground_truth is not None
    np.testing.assert_allclose(drive.ground_truth, rough.truth, atol=1e-5)


def test_euroc_chooses_among_sequences(tmp_path: Path, rough: Taken) -> None:
    for name in ("V1_01", "V1_02"):
        write_euroc(tmp_path / name, rough)
    assert detect_format(DatasetSpec(tmp_path)) == "euroc"
    assert open_dataset(tmp_path, "V1_02").name == "V1_02"


def test_images_without_a_partner_are_left_out_with_a_remark(tmp_path: Path, rough: Taken) -> None:
    table = write_euroc(tmp_path / "MH", rough) / "mav0" / "cam1" / "data.csv"
    lines = table.read_text().splitlines()
    table.write_text("\n".join(lines[:2] + lines[3:]))
    drive = open_dataset(tmp_path / "MH")
    assert len(drive) == 4
    assert drive.remarks == (
        f"cam1/data.csv: 1 images in data are not listed and left out, the first is {lines[2].split(',')[1]}",
        "1 images without a partner in the other camera are left out",
    )
    np.testing.assert_array_equal(drive[1].right, rough.ideal.right(rough.pairs[2][1]))
    assert drive.ground_truth is not None
    np.testing.assert_allclose(drive.ground_truth, np.delete(rough.truth, 1, axis=0), atol=1e-5)


def test_images_outside_the_ground_truth_are_left_out_with_a_remark(tmp_path: Path, rough: Taken) -> None:
    table = write_euroc(tmp_path / "MH", rough) / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    lines = table.read_text().splitlines()
    table.write_text("\n".join([lines[0], *lines[9:]]))  # begins 0.04 s after the first image
    drive = open_dataset(tmp_path / "MH")
    assert (len(drive), drive.remarks) == (4, ("1 images before or after the ground truth are left out",))
    np.testing.assert_array_equal(drive[0].left, rough.ideal.left(rough.pairs[1][0]))
    np.testing.assert_array_equal(drive.read_left(0), drive[0].left)


@pytest.mark.parametrize("name", ["rgbd_dataset_freiburg3_room", "my_room"])
def test_tum_rgbd_with_the_cameras_of_the_benchmark_or_a_custom_one(tmp_path: Path, rough: Taken, name: str) -> None:
    folder = write_tum_rgbd(tmp_path / name, rough)
    if name == "my_room":
        (folder / "camera.toml").write_text(camera_toml(rough.rig, pair=False))
    drive = open_dataset(folder)
    assert (drive.has_right, len(drive), drive[3].right) == (False, 5, None)
    assert drive.camera.fx == pytest.approx(535.4 if name != "my_room" else 185, abs=40)
    if name != "my_room":  # an undistorted camera whose images are taken as they are
        np.testing.assert_array_equal(drive[3].left, rough.pairs[3][0])
    assert drive.ground_truth is not None
    T = np.linalg.inv(rough.poses[0]) @ rough.poses
    np.testing.assert_allclose(drive.ground_truth, T, atol=1e-5)


@pytest.mark.parametrize("rig", RIGS)
def test_folders_of_a_custom_stereo_pair(tmp_path: Path, rig: str) -> None:
    drive = taken(rig, 3)
    assert_frames(open_dataset(write_folders(tmp_path / "mine", drive, fps=RATE)), drive)


def test_five_numbers_are_enough_for_a_pair_and_four_for_one_camera(tmp_path: Path) -> None:
    ideal = taken("ideal", 3)
    folder = write_folders(tmp_path / "mine", ideal, ("cam0", "cam1"))
    numbers = "fx = 260\nfy = 260\ncx = 160\ncy = 118\n"
    (folder / "camera.toml").write_text(numbers + "baseline = 0.3\n")
    (folder / "times.txt").write_text("".join(f"{k / RATE}\n" for k in range(3)))
    assert_frames(open_dataset(folder), ideal)
    (folder / "camera.toml").write_text(numbers)
    alone = open_dataset(folder)
    assert (alone.has_right, alone.remarks) == (False, ("camera.toml has no baseline: the left camera alone is used",))


def test_a_folder_of_images_with_truth(tmp_path: Path, rough: Taken) -> None:
    folder = write_folders(tmp_path / "mine", rough, fps=RATE, ground_truth="poses.txt")
    write_kitti(folder / "poses.txt", rough.poses)
    truth = open_dataset(folder).ground_truth
    assert truth is not None
    np.testing.assert_allclose(truth, rough.truth, atol=1e-9)


@pytest.mark.parametrize(("codec", "suffix"), [("MJPG", ".avi"), ("mp4v", ".mp4")])
def test_two_videos(tmp_path: Path, rough: Taken, codec: str, suffix: str) -> None:
    for side, name in enumerate(("left", "right")):
        write_video(tmp_path / f"{name}{suffix}", [pair[side] for pair in rough.pairs], codec)
    (tmp_path / "camera.toml").write_text(camera_toml(rough.rig))
    assert_frames(open_dataset(tmp_path), rough, blur=6.0)


@pytest.mark.parametrize(("codec", "suffix"), [("MJPG", ".avi"), ("mp4v", ".mp4")])
def test_any_image_of_a_video_is_found_again(tmp_path: Path, rough: Taken, codec: str, suffix: str) -> None:
    images = [np.roll(rough.pairs[0][0], 7 * k, axis=1) for k in range(40)]
    path = write_video(tmp_path / f"drive{suffix}", images, codec)
    (tmp_path / "camera.toml").write_text(camera_toml(rough.rig, pair=False))
    drive = open_dataset(path)
    in_order = [frame.left for frame in prefetch(drive)]
    assert len(in_order) == 40
    for index in (17, 18, 3, 39, 0, 19, 20, 4):
        np.testing.assert_array_equal(drive[index].left, in_order[index])


def test_a_video_without_calibration_serves_place_recognition(tmp_path: Path, rough: Taken) -> None:
    path = write_video(tmp_path / "drive.avi", [left for left, _ in rough.pairs])
    images = open_images(DatasetSpec(path))
    assert (detect_format(DatasetSpec(path)), images.name, len(images), images.ground_truth) == (
        "images",
        "drive.avi",
        5,
        None,
    )
    assert images.timestamps is not None
    np.testing.assert_allclose(np.diff(images.timestamps), 1 / RATE, atol=2e-3)
    assert_alike(images[4], rough.pairs[4][0], 6.0)


@pytest.mark.parametrize("storage", ["ros1", "sqlite3", "mcap"])
def test_bags_with_a_calibrated_pair(tmp_path: Path, rough: Taken, storage: str) -> None:
    path = write_bag(tmp_path, rough, BagStyle(storage))
    assert detect_format(DatasetSpec(path)) == "bag"
    drive = open_dataset(path)
    assert_frames(drive, rough)
    assert drive.timestamps[0] == pytest.approx(rough.times[0], abs=1e-6)  # when taken, not when received
    np.testing.assert_array_equal(drive[1].left, rough.ideal.left(rough.pairs[1][0]))


@pytest.mark.parametrize("encoding", [*ENCODED, "png"])
def test_every_encoding_of_a_bag_gives_the_same_grey(tmp_path: Path, rough: Taken, encoding: str) -> None:
    path = write_bag(tmp_path, rough, BagStyle(encoding=encoding, infos=False, topics=("/camera/image",)))
    images = open_images(DatasetSpec(path))
    for index in (2, 0, 1):
        assert_alike(images[index], rough.pairs[index][0], 0.0)


def test_a_single_mcap_file_is_a_bag(tmp_path: Path, rough: Taken) -> None:
    path = next(write_bag(tmp_path, rough, BagStyle("mcap")).glob("*.mcap"))
    assert_frames(open_dataset(path), rough)


def test_topics_and_calibration_can_be_given_by_the_user(tmp_path: Path, rough: Taken) -> None:
    path = write_bag(tmp_path, rough, BagStyle("mcap", infos=False, topics=("/a/image", "/b/image")))
    (tmp_path / "camera.toml").write_text(camera_toml(rough.rig))
    assert_frames(open_dataset(DatasetSpec(path, topics=("/a/image", "/b/image"))), rough)
    (tmp_path / "camera.toml").write_text(camera_toml(rough.rig, left="/a/image", right="/b/image"))
    assert_frames(open_dataset(path), rough)


def test_ground_truth_of_a_bag_is_read_from_a_file_beside_it(tmp_path: Path, rough: Taken) -> None:
    path = write_bag(tmp_path, rough, BagStyle("sqlite3"))
    (path / "camera.toml").write_text(camera_toml(rough.rig, ground_truth="poses.txt"))
    write_tum(path / "poses.txt", *finely(rough))
    truth = open_dataset(path).ground_truth
    assert truth is not None
    np.testing.assert_allclose(truth, rough.truth, atol=1e-5)


@pytest.mark.parametrize(
    ("topics", "named", "chosen"),
    [
        (("/cam0/image_raw", "/cam1/image_raw"), (), ("/cam0/image_raw", "/cam1/image_raw")),
        (("/camera/color/image_raw", "/camera/depth/image_rect_raw"), (), ("/camera/color/image_raw", None)),
        (("/l/image", "/l/image/compressed"), (), ("/l/image", None)),
        (("/left/image_raw", "/left/image_rect", "/right/image_raw", "/right/image_rect"), (),
         ("/left/image_rect", "/right/image_rect")),
        (("/camera/infra1/image", "/camera/infra2/image", "/camera/color/image"), (),
         ("/camera/infra1/image", "/camera/infra2/image")),
        (("/a", "/b", "/c"), ("/c", "/a"), ("/c", "/a")),
    ],
)  # fmt: skip
def test_topics_are_found_by_their_names(
    topics: tuple[str, ...], named: tuple[str, ...], chosen: tuple[str, str | None]
) -> None:
    found = choose_topics(Bag(Path("x.bag"), dict.fromkeys(topics, 9), {}), named)
    assert (found.left, found.right) == chosen


def test_the_command_line_names_every_format() -> None:
    assert sorted(app.FORMAT_NAMES.split(", ")) == sorted(FORMATS)


Write = Callable[[Path, Taken], Path]
WRITERS: dict[str, Write] = {
    "euroc": write_euroc,
    "tum-rgbd": lambda root, drive: write_tum_rgbd(root / "freiburg1", drive),
    "own-camera": lambda root, drive: write_folders(root, drive, fps=RATE),
    "bag": lambda root, drive: write_bag(root, drive, BagStyle()),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_the_format_is_detected_and_its_images_are_the_left_images_of_the_dataset(
    tmp_path: Path, rough: Taken, kind: str
) -> None:
    source = DatasetSpec(WRITERS[kind](tmp_path / "drive", rough))
    assert detect_format(source) == kind
    drive, images = open_dataset(source), open_images(source)
    np.testing.assert_array_equal(images[2], drive[2].left)
    np.testing.assert_array_equal(images.timestamps, drive.timestamps)


@pytest.mark.parametrize(
    "source",
    [DatasetSpec(Path("a b")), DatasetSpec(Path("c"), "00", "bag", 12.5, ("/left", "/right"))],
)
def test_the_dataset_spec_is_restored_from_the_metrics(source: DatasetSpec, tmp_path: Path):
    write_metrics(tmp_path / "metrics.json", {"recording": source.as_metrics()})
    metrics = read_metrics(tmp_path / "metrics.json")
    assert DatasetSpec.from_metrics(metrics["recording"]) == source
    assert metrics["notes"] == {}
