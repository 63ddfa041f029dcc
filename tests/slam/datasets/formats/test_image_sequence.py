"""A folder of images is a recording too."""

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.datasets.formats.kitti import open_image_sequence
from slam.errors import DataError


def write(folder: Path, *names: str) -> Path:
    folder.mkdir(exist_ok=True)
    for value, name in enumerate(names):
        cv2.imwrite(str(folder / name), np.full((4, 6, 3), 10 * value, np.uint8))
    return folder


def test_images_come_in_the_natural_order_of_their_names(tmp_path: Path) -> None:
    images = open_image_sequence(write(tmp_path / "hall", "10.png", "9.png", "100.png", "1.png"), fps=2.0)
    assert [file.name for file in images.files] == ["1.png", "9.png", "10.png", "100.png"]
    assert [int(images[index][0, 0]) for index in range(4)] == [30, 10, 0, 20]
    assert (images.name, images.timestamps.tolist()) == ("hall", [0.0, 0.5, 1.0, 1.5])


@pytest.mark.parametrize("names", [("a2.jpg", "a10.JPG"), ("x1y2.bmp", "x1y10.bmp"), ("1.png", "b.png")])
def test_numbers_within_names_count_as_numbers(tmp_path: Path, names: tuple[str, ...]) -> None:
    images = open_image_sequence(write(tmp_path / "a", *reversed(names)), fps=1.0)
    assert tuple(file.name for file in images.files) == names


def test_images_are_grey(tmp_path: Path) -> None:
    image = open_image_sequence(write(tmp_path / "a", "1.png"), fps=1.0)[0]
    assert (image.shape, image.dtype) == ((4, 6), np.uint8)


@pytest.mark.parametrize("high", [1023, 4095, 16383, 65535])
def test_images_of_sixteen_bits_keep_the_high_bits_of_the_sensor(tmp_path: Path, high: int) -> None:
    folder = write(tmp_path / "a")
    grey = np.tile(np.arange(256, dtype=np.uint16), (8, 1))
    for number in range(4):  # the brightest is the last: all have one scale
        cv2.imwrite(str(folder / f"{number}.png"), ((grey * (high // 255)) >> (3 - number)).astype(np.uint16))
    images = open_image_sequence(folder, fps=1.0)
    for number in range(4):
        assert np.abs(images[number].astype(int) - (grey.astype(int) >> (3 - number))).max() <= 2


def test_floats_are_refused_by_name(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "1.tiff"), np.ones((8, 8), np.float32))
    images = open_image_sequence(tmp_path)
    with pytest.raises(DataError, match=r"1.tiff: expected .* 8 or 16 bits, found 32-bit floats; save as 8 or 16 bit"):
        images[0]


def test_a_file_of_times_beside_the_images_is_used(tmp_path: Path) -> None:
    write(tmp_path, "1.png", "2.png")
    (tmp_path / "times.txt").write_text("5.0\n7.5\n")
    assert open_image_sequence(tmp_path, fps=1.0).timestamps.tolist() == [5.0, 7.5]


def test_a_kitti_drive_needs_no_calibration_for_its_images(root: Path, folder: Path) -> None:
    (folder / "calib.txt").unlink()
    shutil.rmtree(folder / "image_1")
    images = open_image_sequence(root)
    assert (images.name, len(images)) == ("00", 3)
    np.testing.assert_allclose(images.timestamps, [0.0, 0.1, 0.2])


def test_a_kitti_sequence_is_chosen_by_name(root: Path, write_drive: Callable[..., Path]) -> None:
    write_drive(root, "07")
    assert open_image_sequence(root, "07").name == "07"


@pytest.mark.parametrize("fps", [0.0, -1.0, float("nan"), float("inf")])
def test_an_invalid_frame_rate_is_refused(tmp_path: Path, fps: float) -> None:
    write(tmp_path, "1.png", "2.png")
    with pytest.raises(DataError, match=r"times.txt: expected the times of 2 images, found none, and --fps"):
        open_image_sequence(tmp_path, fps=fps)


def test_images_without_times_open_all_the_same(tmp_path: Path) -> None:
    images = open_image_sequence(write(tmp_path, "1.png", "2.png"))
    assert (len(images), images.timestamps) == (2, None)


def test_a_damaged_image_is_named_when_it_is_read(tmp_path: Path) -> None:
    write(tmp_path, "1.png", "2.png")
    (tmp_path / "2.png").write_bytes(b"no image")
    images = open_image_sequence(tmp_path, fps=1.0)
    with pytest.raises(DataError, match=r"2.png: expected an image"):
        images[1]


def test_an_index_beyond_the_images_is_an_index_error(tmp_path: Path) -> None:
    with pytest.raises(IndexError, match="from 0 to 0, got 1"):
        open_image_sequence(write(tmp_path / "a", "1.png"), fps=1.0)[1]


@pytest.mark.parametrize("made", [True, False])
def test_a_folder_without_images_is_named(tmp_path: Path, made: bool) -> None:
    folder = tmp_path / "hall"
    if made:
        folder.mkdir()
    with pytest.raises(DataError, match="hall: expected"):
        open_image_sequence(folder, fps=1.0)


def test_the_corridor_opens(test_data: Path) -> None:
    images = open_image_sequence(test_data / "corridor_two_laps", fps=0.5)
    assert (len(images), images[83].shape) == (84, (384, 512))
    assert [file.name for file in images.files[:11:10]] == ["1.jpg", "11.jpg"]
