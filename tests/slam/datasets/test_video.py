"""Any order of indices gives the right images from a file that is only read forward."""

import threading
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.datasets.video import SequentialReader
from slam.errors import DataError

COUNT = 20


class Forward:
    """A source of images whose value is their index, which counts how often it is opened and read."""

    def __init__(self) -> None:
        self.opened: list[int] = []
        self.read = 0

    def open_at(self, index: int) -> Iterator[np.ndarray]:
        self.opened.append(index)
        for value in range(index, COUNT):
            self.read += 1
            yield np.full((2, 3), value, np.uint8)


@settings(max_examples=60, deadline=None)
@given(indices=st.lists(st.integers(0, COUNT - 1), max_size=40))
def test_any_order_gives_the_image_of_the_index(indices: list[int]) -> None:
    reader = SequentialReader(Forward().open_at)
    for index in indices:
        image = reader[index]
        assert image is not None
        assert (image == index).all()


def test_reading_in_order_opens_the_file_once_and_decodes_each_image_once() -> None:
    source = Forward()
    reader = SequentialReader(source.open_at)
    assert [int(reader.read(k, COUNT, str, "video")[0, 0]) for k in range(COUNT)] == list(range(COUNT))
    assert (source.opened, source.read) == ([0], COUNT)


def test_two_readers_in_turn_do_not_disturb_each_other() -> None:
    source = Forward()
    reader = SequentialReader(source.open_at)
    for step in range(6):
        assert reader[step][0, 0] == step
        assert reader[10 + step][0, 0] == 10 + step
    assert source.opened == [0, 10]


def test_an_image_past_the_end_is_named() -> None:
    reader = SequentialReader(Forward().open_at)
    with pytest.raises(IndexError, match="from 0 to 4, got 5"):
        reader.read(5, 5, str, "video")
    with pytest.raises(DataError, match="image 20: expected an image, found none; copy the bag again"):
        reader.read(COUNT, COUNT + 1, lambda index: f"image {index}", "bag")
    assert reader[3][0, 0] == 3  # and the reader still works


def test_threads_get_the_images_that_they_ask_for() -> None:
    reader, wrong = SequentialReader(Forward().open_at), []

    def work(start: int) -> None:
        wrong.extend(k for k in range(start, COUNT) if reader[k][0, 0] != k)

    threads = [threading.Thread(target=work, args=(start,)) for start in (0, 3, 7, 11)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []
