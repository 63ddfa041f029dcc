"""What is wrong with a drive is said in one line that names the file."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.datasets.formats.kitti import open_kitti
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
    "calib missing": (lambda f: (f / "calib.txt").unlink(), r"calib.txt: .*No such file"),
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


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_when_the_drive_is_opened(root: Path, folder: Path, fault: str) -> None:
    damage, message = FAULTS[fault]
    damage(folder)
    with pytest.raises(DataError, match=message) as caught:
        open_kitti(root)
    assert "\n" not in str(caught.value)
    assert str(root) in str(caught.value)


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
