"""Recordings in colour: read once, red first, only where there is colour and somebody asks."""

import cv2
import numpy as np
import pytest

from slam.datasets.formats.image_sequence import open_image_folder
from slam.datasets.prefetch import ColorImages, has_color, prefetch


@pytest.fixture
def folder(tmp_path):
    """Writes images, in colour or grey."""

    def write(name, *images):
        (tmp_path / name).mkdir()
        for k, image in enumerate(images):
            cv2.imwrite(str(tmp_path / name / f"{k:03d}.png"), image)
        return open_image_folder(tmp_path / name)

    return write


BLUE = np.full((30, 40, 3), (200, 20, 10), np.uint8)  # as OpenCV writes it: blue first


def test_images_are_read_red_first(folder):
    images = ColorImages(folder("color", BLUE, BLUE // 2))
    assert has_color(folder("again", BLUE))
    assert len(images) == 2
    np.testing.assert_array_equal(images[0][0, 0], [10, 20, 200])
    np.testing.assert_array_equal(images[1][0, 0], [5, 10, 100])


def test_grey_recordings_have_no_colour_and_a_grey_image_among_others_stays_grey(folder):
    gray = np.full((30, 40), 9, np.uint8)
    assert not has_color(folder("grey", gray))
    mixed = ColorImages(folder("mixed", BLUE, gray))
    assert [image.ndim for image in prefetch(mixed)] == [3, 2]
    np.testing.assert_array_equal(mixed[1], gray)
    assert not has_color([gray])


def test_each_file_is_decoded_once(folder, monkeypatch):
    images, read = ColorImages(folder("color", BLUE, BLUE, BLUE)), []
    decode = cv2.imread
    monkeypatch.setattr(cv2, "imread", lambda path, *flags: read.append(path) or decode(path, *flags))
    for image in prefetch(images):
        assert image.shape == (30, 40, 3)
    assert len(read) == len(set(read)) == 3
