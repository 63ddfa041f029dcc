"""The chapter's recordings open from their original trees, with its cameras and its sampling."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from slam.datasets.formats.image_sequence import ImageSequence
from slam.datasets.formats.place_datasets import open_city_centre, open_malaga, open_new_college
from slam.errors import DataError

OPENERS = (open_malaga, open_new_college, open_city_centre)


def write(folder: Path, *names: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for value, name in enumerate(names):
        cv2.imwrite(str(folder / name), np.full((6, 8), value, np.uint8))
    return folder


def test_malaga_takes_the_left_rectified_images_in_the_order_of_their_times(tmp_path: Path) -> None:
    both = [f"CAMERA1_{t}.5_{side}.jpg" for t in (1000, 99, 102) for side in ("left", "right")]
    write(tmp_path / "set" / "Images_rectified", *both)
    write(tmp_path / "set" / "Images", *both)
    images = open_malaga(tmp_path)
    assert [file.name for file in images.files] == [f"CAMERA1_{t}.5_left.jpg" for t in (99, 102, 1000)]
    assert {file.parent.name for file in images.files} == {"Images_rectified"}
    assert images.timestamps is not None
    assert images.timestamps.tolist() == [99.5, 102.5, 1000.5]


def test_new_college_takes_every_twentieth_left_image_at_one_hertz(tmp_path: Path) -> None:
    names = [f"StereoImages__{1225719868 + k / 20:.6f}-{side}.pnm" for k in range(41) for side in ("left", "right")]
    images = open_new_college(write(tmp_path / "a" / "b", *names).parents[1])
    assert [file.name for file in images.files] == [f"StereoImages__{1225719868 + k}.000000-left.pnm" for k in range(3)]
    assert images.timestamps is not None
    assert images.timestamps.tolist() == [0.0, 1.0, 2.0]
    assert images[0].shape == (6, 8)


def test_city_centre_takes_the_images_of_one_camera_at_seven_hertz(tmp_path: Path) -> None:
    write(tmp_path / "CityCentre" / "Images", *(f"{k:04d}.jpg" for k in range(1, 12)))
    images = open_city_centre(tmp_path)
    assert [file.stem for file in images.files] == ["0001", "0003", "0005", "0007", "0009", "0011"]
    assert images.timestamps is not None
    assert np.allclose(images.timestamps, np.arange(6) / 7.0)


@pytest.mark.parametrize("opener", OPENERS)
def test_the_error_for_a_missing_dataset_says_where_to_get_it(
    tmp_path: Path, opener: Callable[[Path], ImageSequence]
) -> None:
    with pytest.raises(DataError, match=r"nowhere: expected the .* recording, found nothing; get it from http"):
        opener(tmp_path / "nowhere")
    with pytest.raises(DataError, match=r"expected images such as .*, found none; get them from http"):
        opener(tmp_path)


def test_images_unpacked_twice_are_refused(tmp_path: Path) -> None:
    for folder in ("one", "other"):
        write(tmp_path / folder, "0001.jpg", "0002.jpg")
    with pytest.raises(DataError, match="expected each image once, found 4 files of 2 names"):
        open_city_centre(tmp_path)
