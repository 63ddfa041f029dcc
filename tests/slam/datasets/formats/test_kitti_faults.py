"""What is wrong with a drive is said in one line that names the file."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.kitti import open_kitti
from slam.datasets.formats.registry import open_for_odometry, open_images
from slam.errors import DataError
from slam.io.trajectory_files import write_kitti

WriteDrive = Callable[..., Path]

P0 = "P0: 50 0 31.5 0 0 50 15.5 0 0 0 1 0"
P1 = "P1: 50 0 31.5 -20 0 50 15.5 0 0 0 1 0"
SWAPPED = P0.replace("P0", "P1"), P1.replace("P1", "P0")
LINE = "1 0 0 0 0 1 0 0 0 0 1 0\n"


def calib(*lines: str) -> Callable[[Path], object]:
    return lambda folder: (folder / "calib.txt").write_text("\n".join(lines) + "\n")


def times(text: str) -> Callable[[Path], object]:
    return lambda folder: (folder / "times.txt").write_text(text)


def poses(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], object]:
    return lambda folder: write_kitti(
        folder.parent.parent / "poses" / "00.txt", change(np.repeat(np.eye(4)[None], 3, axis=0))
    )


def pose_text(text: str) -> Callable[[Path], object]:
    return lambda folder: (folder.parent.parent / "poses" / "00.txt").write_text(text)


def scaled(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda T: T * np.array([factor, factor, factor, 1.0])


FAULTS = {
    "no images": (
        lambda f: [p.unlink() for p in (f / "image_0").iterdir()],
        r"image_0: .*found none; unpack",
    ),
    "no image folder": (
        lambda f: [shutil.rmtree(f / f"image_{c}") for c in (0, 1)],
        r"00: .*image_0 or image_2",
    ),
    "right image missing": (lambda f: (f / "image_1/000002.png").unlink(), r"image_1: expected 3 .*found 2"),
    "right images empty": (
        lambda f: [p.unlink() for p in (f / "image_1").iterdir()],
        r"image_1: .*found none",
    ),
    "gap": (
        lambda f: [(f / f"image_{c}/000001.png").unlink() for c in (0, 1)],
        r"image_0: .*without gaps.*found 000002.png after 000000.png",
    ),
    "other numbers right": (
        lambda f: (f / "image_1/000000.png").rename(f / "image_1/000003.png"),
        r"image_1: expected 000000.png as in image_0, found 000001.png",
    ),
    "name without number": (
        lambda f: (f / "image_0/000002.png").rename(f / "image_0/last.png"),
        r"last.png: expected a name like 000000.png",
    ),
    "first image unreadable": (
        lambda f: (f / "image_0/000000.png").write_bytes(b"no image"),
        r"000000.png: expected an image",
    ),
    "calib missing": (lambda f: (f / "calib.txt").unlink(), r"calib.txt: expected this file, found none"),
    "calib is a folder": (
        lambda f: ((f / "calib.txt").unlink(), (f / "calib.txt").mkdir()),
        r"calib.txt: .*directory",
    ),
    "calib empty": (calib(""), r"calib.txt: expected only lines such as"),
    "calib without P0": (calib(P1), r"calib.txt: expected a line 'P0: 12 numbers', found none"),
    "calib without P1": (calib(P0), r"calib.txt: expected a line 'P1: 12 numbers', found none"),
    "calib with 11 numbers": (
        calib(P0, P1[: P1.rindex(" ")]),
        r"calib.txt: expected 12 numbers in P1, found 11",
    ),
    "calib with words": (calib(P0, P1 + "x"), r"calib.txt: expected a line 'P1"),
    "calib with NaN": (calib(P0.replace("31.5", "nan"), P1), r"calib.txt: expected finite .* in P0"),
    "calib without focal length": (
        calib("P0:" + " 0" * 12, "P1:" + " 0" * 12),
        r"calib.txt: .*focal lengths",
    ),
    "calib of other cameras": (calib(P0, P1.replace("31.5", "32.5")), r"calib.txt: .*same intrinsics"),
    "calib swapped": (calib(*SWAPPED), r"calib.txt: expected P1 to the right of P0 .*found 0 and -20"),
    "times missing": (lambda f: (f / "times.txt").unlink(), r"times.txt: expected this file, found none"),
    "times empty": (times(""), r"times.txt: .*empty file"),
    "times too few": (times("0\n1\n"), r"times.txt: expected 3 times.*found 2"),
    "times with words": (times("0\none\n2\n"), r"times.txt, line 2: expected 1 finite number, found 'one'"),
    "times with NaN": (times("0\nnan\n2\n"), r"times.txt, line 2: .*found 'nan'"),
    "times backwards": (times("0\n2\n1\n"), r"times.txt: expected increasing times, found 1.0 after 2.0"),
    "times standing": (times("0\n1\n1\n"), r"times.txt: expected increasing times, found 1.0 after 1.0"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_when_the_drive_is_opened(root: Path, folder: Path, fault: str) -> None:
    damage, message = FAULTS[fault]
    damage(folder)
    with pytest.raises(DataError, match=message) as caught:
        open_kitti(root)
    assert "\n" not in str(caught.value)
    assert str(root) in str(caught.value)


# Ground truth is optional: whatever is wrong with it is a remark, and the drive is read without it.
TRUTH_FAULTS = {
    "poses too many": (poses(lambda T: np.concatenate([T, T])), r"poses/00.txt: expected 3 poses.*found 6"),
    "poses too few": (poses(lambda T: T[:2]), r"poses/00.txt: expected 3 poses.*found 2"),
    "poses with NaN": (poses(lambda T: T * np.nan), r"poses/00.txt, line 1: expected 12 finite numbers"),
    "poses not rigid": (poses(scaled(1.01)), r"poses/00.txt, pose 0: expected a rotation"),
    "poses mirrored": (poses(scaled(-1.0)), r"poses/00.txt, pose 0: .*mirrored"),
    "poses with 11 numbers": (
        pose_text(LINE * 2 + LINE[:-3]),
        r"poses/00.txt, line 3: expected 12 .*found 11",
    ),
    "poses not text": (
        lambda f: (f.parent.parent / "poses/00.txt").write_bytes(b"\xff\xfe\x80"),
        "expected a text",
    ),
}


@pytest.mark.parametrize("fault", TRUTH_FAULTS)
def test_a_fault_of_the_ground_truth_is_a_remark_and_the_drive_is_read(root: Path, folder: Path, fault: str) -> None:
    damage, message = TRUTH_FAULTS[fault]
    damage(folder)
    spec = DatasetSpec(root)
    for dataset in (open_for_odometry(spec, mono=False), open_for_odometry(spec, mono=True), open_images(spec)):
        assert (len(dataset), dataset.ground_truth, len(dataset.remarks)) == (3, None, 1)
        assert re.search(message, dataset.remarks[0])
        assert dataset.remarks[0].endswith("; the ground truth is not used")


# What --mono and places do not look at.
RIGHT_FAULTS: dict[str, Callable[[Path], object]] = {
    "last right image missing": lambda f: (f / "image_1/000002.png").unlink(),
    "one right image too many": lambda f: shutil.copy(f / "image_1/000000.png", f / "image_1/000003.png"),
    "no right image": lambda f: [path.unlink() for path in (f / "image_1").iterdir()],
    "other right numbers": lambda f: (f / "image_1/000000.png").rename(f / "image_1/000003.png"),
    "right images with words for names": lambda f: (f / "image_1/000000.png").rename(f / "image_1/first.png"),
    "damaged right images": lambda f: [path.write_bytes(b"") for path in (f / "image_1").iterdir()],
    "no right calibration": calib(P0),
    "right camera to the left": calib(*SWAPPED),
    "right camera of another size": calib(P0, P1.replace("31.5", "99.5")),
    "right calibration of words": calib(P0, "P1: none"),
}


@pytest.mark.parametrize("fault", RIGHT_FAULTS)
def test_no_fault_of_the_right_camera_stops_the_left_one(root: Path, folder: Path, fault: str) -> None:
    expected = [frame.left for frame in open_kitti(root)]
    RIGHT_FAULTS[fault](folder)
    spec = DatasetSpec(root)
    mono, images = open_for_odometry(spec, mono=True), open_images(spec)
    assert not mono.has_right
    assert (mono.camera.fx, mono.camera.cx) == (50.0, 31.5)
    for index, image in enumerate(expected):
        np.testing.assert_array_equal(mono[index].left, image)
        np.testing.assert_array_equal(images[index], image)


@pytest.mark.parametrize("suffix", ["jpg", "jpeg", "bmp", "webp", "JPG"])
def test_images_may_have_any_suffix(root: Path, folder: Path, suffix: str) -> None:
    for file in [*(folder / "image_0").iterdir(), *(folder / "image_1").iterdir()]:
        cv2.imwrite(str(file.with_suffix(f".{suffix}")), cv2.imread(str(file)))
        file.unlink()
    drive = open_kitti(root)
    assert (len(drive), drive.has_right, drive[2].left.shape) == (3, True, (32, 64))


def test_two_sets_of_the_same_images_are_named(root: Path, folder: Path) -> None:
    shutil.copy(folder / "image_0/000001.png", folder / "image_0/000001.jpg")
    with pytest.raises(DataError, match=r"image_0: expected each number once, found 000001.* and 000001.*; remove one"):
        open_kitti(root)


@pytest.mark.parametrize("text", ["\n{}", "{}\n\n", "\ufeff{}", "{}\r\n", "{}\ncalib_time: 09-Jan-2012\n  \n"])
def test_blank_lines_and_line_ends_of_the_calibration_do_not_matter(root: Path, folder: Path, text: str) -> None:
    (folder / "calib.txt").write_text(text.format(f"{P0}\n{P1}"), newline="")
    assert open_kitti(root).camera.baseline == pytest.approx(0.4)


def test_a_picture_beside_the_sequences_decides_nothing(root: Path, folder: Path) -> None:
    for place in (root, folder, root / "sequences"):
        shutil.copy(folder / "image_0/000000.png", place / "preview.png")
        images = open_images(DatasetSpec(place))
        assert (images.name, len(images)) == ("00", 3)


@pytest.mark.parametrize(("ticks", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
def test_times_of_another_unit_become_seconds_with_a_remark(root: Path, folder: Path, ticks: float, unit: str) -> None:
    for start in (0.0, 1.4e9):
        times("".join(f"{(start + 0.1 * k) * ticks:.0f}\n" for k in range(3)))(folder)
        drive = open_kitti(root)
        np.testing.assert_allclose(drive.timestamps, start + 0.1 * np.arange(3), atol=1e-6)
        assert f"times.txt: the times are read as {unit}" in drive.remarks[0]


def test_times_between_a_number_and_an_exposure_are_read(root: Path, folder: Path) -> None:
    times("".join(f"{k:05d} {1.4e9 + 0.1 * k:.3f} 12.5\n" for k in range(3)))(folder)
    np.testing.assert_allclose(open_kitti(root).timestamps, 1.4e9 + 0.1 * np.arange(3), atol=1e-6)


def test_a_time_that_goes_back_is_named_with_its_line(root: Path, folder: Path) -> None:
    times("# seconds\n\n0\n2\n1\n")(folder)
    with pytest.raises(DataError, match=r"found 1.0 after 2.0 in line 5; correct the line, or remove the file and giv"):
        open_kitti(root)


def test_images_of_one_pixel_are_too_small(root: Path, folder: Path) -> None:
    for file in [*(folder / "image_0").iterdir(), *(folder / "image_1").iterdir()]:
        cv2.imwrite(str(file), np.zeros((1, 1), np.uint8))
    with pytest.raises(DataError, match=r"000000.png: images too small, expected at least 8 x 8 pixels, found 1 x 1"):
        open_kitti(root)


def test_poses_rounded_to_three_digits_are_rotations_enough(root: Path, folder: Path) -> None:
    poses(scaled(1.001))(folder)
    assert open_kitti(root).ground_truth is not None


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=re.escape(f"{tmp_path / 'nowhere'}: expected a folder")):
        open_kitti(tmp_path / "nowhere")


def test_a_file_is_refused_as_a_dataset(tmp_path: Path) -> None:
    (tmp_path / "drive").write_text("")
    with pytest.raises(DataError, match=r"drive: expected a folder .*found a file"):
        open_kitti(tmp_path / "drive")


def test_the_error_for_an_empty_folder_names_the_expected_file(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"expected sequences/XX/image_0/000000.png, found none"):
        open_kitti(tmp_path)


def test_one_of_several_sequences_must_be_named(root: Path, write_drive: WriteDrive) -> None:
    write_drive(root, "05")
    with pytest.raises(DataError, match="found 00, 05; choose one with --sequence"):
        open_kitti(root)


def test_the_error_for_an_unknown_sequence_lists_the_existing_ones(root: Path) -> None:
    with pytest.raises(DataError, match="expected sequence 42, found 00"):
        open_kitti(root, "42")


@pytest.mark.parametrize("camera", [0, 1])
def test_an_image_of_another_size_is_named_when_it_is_read(root: Path, folder: Path, camera: int) -> None:
    path = folder / f"image_{camera}" / "000001.png"
    cv2.imwrite(str(path), np.zeros((32, 66), dtype=np.uint8))
    drive = open_kitti(root)
    assert drive[0].index == 0
    with pytest.raises(DataError, match=rf"image_{camera}/000001.png: expected 64 x 32 .*found 66 x 32"):
        drive[1]


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b[::-1]])
def test_a_damaged_image_is_named_when_it_is_read(root: Path, folder: Path, damage: Callable[[bytes], bytes]) -> None:
    path = folder / "image_1" / "000002.png"
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(DataError, match=r"image_1/000002.png: expected an image"):
        open_kitti(root)[2]


def test_colour_images_need_their_own_calibration(tmp_path: Path, write_drive: WriteDrive) -> None:
    folder = write_drive(tmp_path, cameras=(2, 3))
    calib(P0, P1)(folder)
    with pytest.raises(DataError, match=r"calib.txt: expected a line 'P2"):
        open_kitti(tmp_path)


def test_the_error_for_missing_right_images_names_both_folders(root: Path, folder: Path) -> None:
    for index in (3, 4):
        shutil.copy(folder / "image_0/000000.png", folder / f"image_0/{index:06d}.png")
    with pytest.raises(DataError, match=r"image_1: expected 5 images as in image_0, found 3"):
        open_kitti(root)


def test_one_camera_needs_no_calibration_of_the_other(root: Path, folder: Path) -> None:
    shutil.rmtree(folder / "image_1")
    calib(P0)(folder)
    drive = open_kitti(root)
    assert not drive.has_right
    assert (drive.camera.fx, drive.camera.cx, drive.camera.baseline) == (50.0, 31.5, 0.5)
