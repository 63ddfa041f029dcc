"""Reading ahead changes when images are read, and nothing else."""

import threading
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from slam.datasets.dataset import Frame
from slam.datasets.formats.kitti import open_kitti
from slam.datasets.prefetch import prefetch
from slam.errors import DataError


@dataclass
class Recorded:
    """A drive that remembers what was asked of it and fails at one frame."""

    count: int
    broken: int | None = None
    asked: list[int] = field(default_factory=list)
    threads: set[str] = field(default_factory=set)

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> Frame:
        self.asked.append(index)
        self.threads.add(threading.current_thread().name)
        if index == self.broken:
            raise DataError(f"image {index} is broken")
        return Frame(index, 0.1 * index, np.zeros((2, 2), np.uint8), None)


@pytest.mark.parametrize("ahead", [1, 2, 7, 100])
def test_frames_come_in_order_and_once(ahead: int) -> None:
    drive = Recorded(20)
    assert [frame.index for frame in prefetch(drive, ahead)] == list(range(20))
    assert drive.asked == list(range(20))


def test_one_background_thread_reads() -> None:
    drive = Recorded(20)
    list(prefetch(drive))
    assert len(drive.threads) == 1
    assert threading.current_thread().name not in drive.threads


def test_an_error_comes_at_its_frame() -> None:
    frames = prefetch(Recorded(20, broken=5), ahead=8)
    assert [next(frames).index for _ in range(5)] == [0, 1, 2, 3, 4]
    with pytest.raises(DataError, match="image 5 is broken"):
        next(frames)


def test_no_more_than_the_bound_is_read_ahead() -> None:
    drive = Recorded(100)
    frames = prefetch(drive, ahead=4)
    assert next(frames).index == 0
    frames.close()
    assert len(drive.asked) <= 4


def test_stopping_early_ends_the_thread() -> None:
    before = threading.active_count()
    frames = prefetch(Recorded(100))
    next(frames)
    frames.close()
    assert threading.active_count() == before


def test_an_empty_recording_gives_nothing() -> None:
    assert list(prefetch(Recorded(0))) == []


def test_images_are_the_same_as_without_reading_ahead(root: Path) -> None:
    drive = open_kitti(root)
    for ahead, direct in zip(prefetch(drive), drive, strict=True):
        np.testing.assert_array_equal(ahead.left, direct.left)
        np.testing.assert_array_equal(ahead.right, direct.right)
