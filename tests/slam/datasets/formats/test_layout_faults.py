"""Whatever is wrong with a recording is one line that names the file, what was expected and found, and the remedy."""

import random
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.registry import open_dataset, open_images
from slam.errors import ConfigError, DataError

from ..layouts import (
    BagStyle,
    Taken,
    taken,
    write_bag,
    write_euroc,
    write_folders,
    write_tum_rgbd,
    write_video,
)


@pytest.fixture(scope="module")
def rough() -> Taken:
    return taken("radtan", 3)


def edit(path: Path, change: Callable[[str], str]) -> None:
    path.write_text(change(path.read_text()))


def shrink(path: Path) -> None:
    cv2.imwrite(str(path), np.zeros((40, 60), np.uint8))


def cut(path: Path, share: float) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])


CAM0, CAM1 = Path("mav0/cam0"), Path("mav0/cam1")
EUROC: dict[str, tuple[Callable[[Path], object], str]] = {
    "an image is missing": (
        lambda r: sorted((r / CAM0 / "data").iterdir())[1].unlink(),
        r"data\.csv: expected the image .*\.png, which it lists, found none",
    ),
    "an image of another size": (
        lambda r: shrink(sorted((r / CAM1 / "data").iterdir())[1]),
        r"\.png: expected 320 x 240 pixels as in .*found 60",
    ),
    "a damaged image": (lambda r: cut(sorted((r / CAM0 / "data").iterdir())[2], 0.0), r"\.png: expected an image"),
    "no calibration": (lambda r: (r / CAM1 / "sensor.yaml").unlink(), r"sensor.yaml: expected this file, found none"),
    "calibration that is no YAML": (
        lambda r: edit(r / CAM0 / "sensor.yaml", lambda t: "a: [" + t),
        r"sensor.yaml: expected YAML, found",
    ),
    "calibration without intrinsics": (
        lambda r: edit(r / CAM0 / "sensor.yaml", lambda t: t.replace("intrinsics", "intrinsic")),
        r"sensor.yaml: expected a list of numbers intrinsics, found None",
    ),
    "a pose that is none": (
        lambda r: edit(r / CAM0 / "sensor.yaml", lambda t: t.replace("data: [", "data: [7, ")),
        r"sensor.yaml: expected 4 x 4 numbers T_BS",
    ),
    "a model that nobody knows": (
        lambda r: edit(r / CAM0 / "sensor.yaml", lambda t: t.replace("radial-tangential", "omni")),
        r"expected one of the models .*, found 'omni'",
    ),
    "cameras swapped": (
        lambda r: [
            (r / CAM0 / "sensor.yaml").rename(r / "x"),
            (r / CAM1 / "sensor.yaml").rename(r / CAM0 / "sensor.yaml"),
            (r / "x").rename(r / CAM1 / "sensor.yaml"),
        ],
        r"sensor.yaml: expected the right camera to the right of the left one, found it at \[-0.1",
    ),
    "a word for a time": (
        lambda r: edit(r / CAM0 / "data.csv", lambda t: t + "late,1.png\n"),
        r"data.csv, line 5: expected a time, found 'late'",
    ),
    "one column": (
        lambda r: edit(r / CAM0 / "data.csv", lambda t: t.replace(",", ";")),
        r"data.csv, line 2: expected 2 cells, found 1",
    ),
    "an empty table": (lambda r: (r / CAM1 / "data.csv").write_text("#t,f\n"), r"data.csv: expected lines of 2 cells"),
    "cameras of two recordings": (
        lambda r: edit(r / CAM1 / "data.csv", lambda t: t.replace("\n1403", "\n1503")),
        r"expected right images within 0.005 s of left",
    ),
}


TRUTH = Path("mav0/state_groundtruth_estimate0/data.csv")
EUROC_TRUTH: dict[str, tuple[Callable[[str], str], str]] = {
    "too few columns": (lambda t: "1,2,3\n", r"line 1: expected 8 finite numbers"),
    "no rotation": (lambda t: "1,0,0,0,0,0,0,0\n2,0,0,0,0,0,0,0\n", r"expected unit quaternions"),
    "no line": (lambda t: "#timestamp\n", r"data.csv: expected lines of 1 cells, found none"),
    "not a table": (lambda t: "404: not found\n", r"line 1: expected 8 finite numbers"),
}


@pytest.mark.parametrize("fault", EUROC_TRUTH)
def test_ground_truth_of_euroc_that_cannot_be_used_is_a_remark(tmp_path: Path, rough: Taken, fault: str) -> None:
    change, message = EUROC_TRUTH[fault]
    root = write_euroc(tmp_path / "MH_01", rough)
    edit(root / TRUTH, change)
    drive = open_dataset(root)
    assert (len(drive), drive.ground_truth, len(drive.remarks)) == (3, None, 1)
    assert re.search(message, drive.remarks[0])


def drive_all(path: Path) -> None:
    """Open a drive and read it to the end."""
    for _ in open_dataset(path):
        pass


@pytest.mark.parametrize("fault", EUROC)
def test_faults_of_euroc(tmp_path: Path, rough: Taken, fault: str) -> None:
    spoil, message = EUROC[fault]
    root = write_euroc(tmp_path / "MH_01", rough)
    spoil(root)
    with pytest.raises(DataError, match=message):
        drive_all(root)


def write_own(root: Path, drive: Taken) -> Path:
    return write_folders(root, drive, fps=20)


def toml(change: Callable[[str], str]) -> Callable[[Path], object]:
    return lambda root: edit(root / "camera.toml", change)


OWN: dict[str, tuple[Callable[[Path], object], str]] = {
    "no TOML": (toml(lambda t: t + "= 3"), r"camera.toml: expected TOML, found .*correct that line"),
    "no fx": (toml(lambda t: t.replace("fx", "f", 1)), r"camera.toml: expected only fx, .*found 'f'"),
    "a key of another name": (
        toml(lambda t: 'images = "left"\n' + t),
        r"found 'images' \(did you mean left\?\)",
    ),
    "a key with a slip of the pen": (toml(lambda t: "basline = 0.1\n" + t), r"'basline' \(did you mean baseline\?\)"),
    "a key in capital letters": (toml(lambda t: t.replace("cx", "Cx", 1)), r"found 'Cx' \(did you mean cx\?\)"),
    "a key of the right camera": (
        toml(lambda t: t.replace("T_left_right", "T_c1_c2")),
        r"\[right_camera\] expected only .*'T_c1_c2' \(did you mean T_left_right\?\)",
    ),
    "a word for a number": (
        toml(lambda t: t.replace("fx = 200.0", "fx = 'wide'", 1)),
        r"expected a number fx, found 'wide'",
    ),
    "an infinite number": (toml(lambda t: t.replace("fx = 200.0", "fx = inf", 1)), r"expected a finite number fx"),
    "a focal length of nothing": (
        toml(lambda t: t.replace("fx = 200.0", "fx = 0", 1)),
        r"positive focal lengths, found 0",
    ),
    "two answers": (toml(lambda t: "baseline = 0.1\n" + t), r"expected baseline or \[right_camera\], found both"),
    "coefficients missing": (
        toml(lambda t: t.replace("-0.28, ", "", 1)),
        r"expected 4, 5, 8, 12 or 14 coefficients of radtan, found 3",
    ),
    "a rotation that is none": (
        toml(lambda t: t.replace("T_left_right = [[0", "T_left_right = [[5", 1)),
        r"expected a rotation",
    ),
    "no times": (
        toml(lambda t: t.replace("fps = 20\n", "")),
        r"left: expected the times of 3 images, found no times.txt",
    ),
    "a folder that is not there": (
        toml(lambda t: 'left = "nowhere"\n' + t),
        r"expected images or a video called nowhere",
    ),
    "poses missing": (toml(lambda t: 'ground_truth = "poses.txt"\n' + t), r"poses.txt: expected this file, found none"),
    "fewer right images": (lambda r: (r / "right" / "8.png").unlink(), r"right: expected 3 images as in left, found 2"),
    "times of other images": (
        lambda r: (r / "left" / "times.txt").write_text("1\n2\n"),
        r"times.txt: expected 3 times",
    ),
    "nothing to be found": (
        lambda r: (r / "left").rename(r / "other"),
        r"expected images, one video, or a folder or video",
    ),
}


@pytest.mark.parametrize("fault", OWN)
def test_faults_of_a_custom_camera(tmp_path: Path, rough: Taken, fault: str) -> None:
    spoil, message = OWN[fault]
    root = write_own(tmp_path / "mine", rough)
    spoil(root)
    with pytest.raises(DataError, match=message):
        drive_all(root)


def test_images_without_calibration_serve_place_recognition_only(tmp_path: Path, rough: Taken) -> None:
    root = write_own(tmp_path / "mine", rough)
    (root / "camera.toml").unlink()
    with pytest.raises(DataError, match=r"camera.toml: expected the calibration of the camera, found none; write it"):
        open_dataset(root)
    assert len(open_images(DatasetSpec(root))) == 3


def test_a_tum_folder_of_an_unknown_camera_asks_for_its_calibration(tmp_path: Path, rough: Taken) -> None:
    with pytest.raises(DataError, match=r"camera.toml: expected the calibration, as the folder's name has no freiburg"):
        open_dataset(write_tum_rgbd(tmp_path / "room", rough))
    images = open_images(DatasetSpec(tmp_path / "room"))  # for places it need not be known
    np.testing.assert_array_equal(images[2], rough.pairs[2][0])


def test_euroc_without_a_calibration_serves_place_recognition(tmp_path: Path, rough: Taken) -> None:
    (write_euroc(tmp_path / "MH_01", rough) / CAM0 / "sensor.yaml").unlink()
    with pytest.raises(DataError, match=r"sensor.yaml: expected this file, found none"):
        open_dataset(tmp_path / "MH_01")
    np.testing.assert_array_equal(open_images(DatasetSpec(tmp_path / "MH_01"))[2], rough.pairs[2][0])


@pytest.mark.parametrize("data", [b"", b"no video" * 100, b"RIFF\xff\xff\xff\xffAVI LIST"])
def test_the_error_for_a_file_that_is_no_video_names_it(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "drive.avi").write_bytes(data)
    with pytest.raises(DataError, match=r"drive.avi: expected a video, found .* decoded; copy it again or convert it"):
        open_images(DatasetSpec(tmp_path / "drive.avi"))


def test_the_readable_part_of_a_truncated_video_is_read(tmp_path: Path, rough: Taken) -> None:
    path = write_video(tmp_path / "drive.avi", [left for left, _ in rough.pairs] * 20)
    cut(path, 0.5)
    images = open_images(DatasetSpec(path))
    assert 20 < len(images) < 45
    assert [images[index].shape for index in range(len(images))] == [(240, 320)] * len(images)


def test_faults_of_bags(tmp_path: Path, rough: Taken) -> None:
    bare = write_bag(tmp_path / "bare", rough, BagStyle(infos=False))
    with pytest.raises(
        DataError, match=r"expected a CameraInfo for /stereo/left/image_raw, found none; write camera.toml"
    ):
        open_dataset(bare)
    with pytest.raises(
        DataError, match=r"expected images of the topic /other, found /stereo/left/image_raw, /stereo/right"
    ):
        open_dataset(DatasetSpec(bare, topics=("/other",)))
    unclear = write_bag(tmp_path / "unclear", rough, BagStyle(topics=("/a/image", "/b/image")))
    with pytest.raises(DataError, match=r"found /a/image \(3\), /b/image \(3\); choose with --image-topic"):
        open_dataset(unclear)
    swapped = DatasetSpec(write_bag(tmp_path / "swapped", rough, BagStyle()), topics=tuple(reversed(BagStyle().topics)))
    with pytest.raises(DataError, match=r"found /stereo/right/image_raw to the right of /stereo/left"):
        open_dataset(swapped)


@pytest.mark.parametrize("storage", ["ros1", "sqlite3", "mcap"])
def test_a_damaged_or_truncated_bag_is_read_or_refused_with_a_data_error(
    tmp_path: Path, rough: Taken, storage: str
) -> None:
    path = write_bag(tmp_path, rough, BagStyle(storage))
    file = path if path.is_file() else next(item for item in path.iterdir() if item.suffix in (".mcap", ".db3"))
    intact, rng = file.read_bytes(), random.Random(0)
    for trial in range(12):
        damaged = bytearray(intact)
        for _ in range(20):
            damaged[rng.randrange(len(damaged) if trial % 2 else 4000)] = rng.randrange(256)
        file.write_bytes(damaged[: rng.randrange(len(damaged)) if trial % 3 == 0 else None])
        try:
            drive_all(path)
        except DataError as error:
            assert str(error).startswith(str(path))  # noqa: PT017 - most of the damage is harmless


@pytest.mark.parametrize("path", ["nowhere", "empty"])
def test_a_missing_path_is_refused(tmp_path: Path, path: str) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match=f"{path}: expected"):
        open_dataset(tmp_path / path)


def test_an_unknown_format_is_a_configuration_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"--format: expected one of bag, euroc, .*, found 'rosbag'"):
        open_dataset(DatasetSpec(tmp_path, format="rosbag"))


def test_image_datasets_without_calibration_are_refused_for_slam(tmp_path: Path) -> None:
    for k in range(3):
        cv2.imwrite(str(tmp_path / f"CAMERA1_{k}.5_left.jpg"), np.zeros((16, 16), np.uint8))
    with pytest.raises(
        DataError, match=r"expected a calibration, found images of places alone; use it with revisit places"
    ):
        open_dataset(tmp_path)
    assert open_images(DatasetSpec(tmp_path)).name == "Malaga 2009 6L"
