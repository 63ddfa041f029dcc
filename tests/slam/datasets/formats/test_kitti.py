"""Drives are found and read however they were unpacked."""

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from odometry import se3
from slam.datasets.formats.kitti import open_kitti
from slam.datasets.formats.registry import open_dataset
from slam.io.trajectory_files import write_kitti

WriteDrive = Callable[..., Path]


def drive_poses() -> np.ndarray:
    poses = np.repeat(np.eye(4)[None], 3, axis=0)
    poses[:, 2, 3] = np.arange(3)
    return poses


def test_camera_times_and_ground_truth_are_read(root: Path) -> None:
    drive = open_dataset(root)
    assert (drive.name, len(drive), drive.has_right) == ("00", 3, True)
    assert (drive.camera.fx, drive.camera.width, drive.camera.height) == (50.0, 64, 32)
    assert drive.camera.baseline == pytest.approx(0.4)
    np.testing.assert_allclose(drive.timestamps, [0.0, 0.1, 0.2])
    np.testing.assert_allclose(drive.ground_truth, drive_poses())


def test_frames_are_the_images_on_disk(root: Path, folder: Path) -> None:
    for index, frame in enumerate(open_kitti(root)):
        assert (frame.index, frame.timestamp) == (index, pytest.approx(0.1 * index))
        for image, camera in ((frame.left, 0), (frame.right, 1)):
            expected = cv2.imread(str(folder / f"image_{camera}" / f"{index:06d}.png"), cv2.IMREAD_GRAYSCALE)
            np.testing.assert_array_equal(image, expected)


def test_an_index_beyond_the_dataset_is_an_index_error(root: Path) -> None:
    with pytest.raises(IndexError, match="from 0 to 2, got 3"):
        open_kitti(root)[3]


@pytest.mark.parametrize("place", [".", "sequences", "sequences/00"])
def test_root_may_be_any_folder_of_the_layout(root: Path, place: str) -> None:
    drive = open_kitti(root / place)
    assert drive.name == "00"
    assert drive.ground_truth is not None


def test_the_folder_called_dataset_may_lie_between(tmp_path: Path, write_drive: WriteDrive) -> None:
    write_drive(tmp_path / "dataset")
    assert open_kitti(tmp_path, "00").ground_truth is not None


def test_the_current_folder_may_be_the_sequence(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    drive = open_kitti(Path())
    assert drive.name == "00"
    assert drive.ground_truth is not None


def test_a_sequence_is_chosen_by_name(root: Path, write_drive: WriteDrive) -> None:
    write_drive(root, "07")
    assert open_kitti(root, "07").name == "07"


def test_a_drive_without_poses_has_no_ground_truth(root: Path) -> None:
    shutil.rmtree(root / "poses")
    assert open_kitti(root).ground_truth is None


def test_poses_may_lie_in_the_sequence(root: Path, folder: Path) -> None:
    (root / "poses" / "00.txt").rename(folder / "poses.txt")
    assert open_kitti(root).ground_truth is not None


def test_a_drive_with_one_camera_has_no_right_images(root: Path, folder: Path) -> None:
    shutil.rmtree(folder / "image_1")
    drive = open_kitti(root)
    assert not drive.has_right
    assert drive[0].right is None


def test_the_laser_calibration_is_ignored(root: Path, folder: Path) -> None:
    with (folder / "calib.txt").open("a") as file:
        file.write("Tr: 1 2 3\n")
    assert open_kitti(root).camera.baseline == pytest.approx(0.4)


def test_numbering_may_start_anywhere(root: Path, folder: Path) -> None:
    for camera in (0, 1):
        for index in reversed(range(3)):
            images = folder / f"image_{camera}"
            (images / f"{index:06d}.png").rename(images / f"{index + 100:06d}.png")
    assert len(open_kitti(root)) == 3


def test_colour_images_become_grey_with_their_own_calibration(tmp_path: Path, write_drive: WriteDrive) -> None:
    write_drive(tmp_path, cameras=(2, 3))
    drive = open_kitti(tmp_path)
    assert drive.has_right
    assert drive[1].left.shape == (32, 64)
    np.testing.assert_array_equal(drive.read_left(1), drive[1].left)
    assert drive.camera.baseline == pytest.approx(0.41)


def test_a_complete_pair_is_preferred_to_a_single_grey_camera(tmp_path: Path, write_drive: WriteDrive) -> None:
    write_drive(tmp_path, cameras=(0, 2, 3))
    assert open_kitti(tmp_path).files.cameras == (2, 3)


def test_ground_truth_is_that_of_the_colour_camera(tmp_path: Path, write_drive: WriteDrive) -> None:
    write_drive(tmp_path, cameras=(2, 3))
    T_camera0 = np.stack([np.eye(4), se3.exp(np.array([0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0])), np.eye(4)])
    write_kitti(tmp_path / "poses" / "00.txt", T_camera0)
    truth = open_kitti(tmp_path).ground_truth
    # Camera 2 sits 6 cm left of camera 0; turning camera 0 on the spot by 90 degrees swings camera 2 around.
    np.testing.assert_allclose(truth[1, :3, 3], [0.06, 0.0, 0.06], atol=1e-9)


def test_the_world_is_the_first_camera(root: Path) -> None:
    shift = se3.exp(np.array([0.1, -0.4, 0.2, 5.0, 6.0, 7.0]))
    write_kitti(root / "poses" / "00.txt", shift @ drive_poses())
    np.testing.assert_allclose(open_kitti(root).ground_truth, drive_poses(), atol=1e-12)


def test_hidden_files_between_the_images_are_ignored(root: Path, folder: Path) -> None:
    (folder / "image_0" / "._000000.png").write_bytes(b"what another system left behind")
    assert len(open_kitti(root)) == 3


def test_grey_comes_first_where_there_is_everything(root: Path, folder: Path) -> None:
    for camera in (2, 3):
        shutil.copytree(folder / "image_0", folder / f"image_{camera}")
    assert open_kitti(root).files.cameras == (0, 1)


@pytest.mark.parametrize(("sequence", "count", "stereo"), [("05", 60, True), ("06", 51, True), ("07", 160, False)])
def test_real_clips_open(test_data: Path, sequence: str, count: int, stereo: bool) -> None:
    drive = open_dataset(test_data / "kitti_clips", sequence)
    assert (len(drive), drive.has_right) == (count, stereo)
    assert drive.camera.baseline == pytest.approx(0.537, abs=5e-4)
    assert drive[count - 1].left.shape == (370, 1226)
