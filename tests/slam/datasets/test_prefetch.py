"""Reading ahead changes when images are read, and nothing else."""

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from slam.datasets.dataset import Frame
from slam.datasets.formats.kitti import open_kitti
from slam.datasets.prefetch import prefetch, work_ahead
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


def test_results_of_work_come_in_order_from_one_other_thread() -> None:
    threads = set()

    def square(number: int) -> int:
        threads.add(threading.current_thread().name)
        return number**2

    assert list(work_ahead(iter(range(20)), square, lambda: True)) == [number**2 for number in range(20)]
    assert len(threads) == 1
    assert threading.current_thread().name not in threads
    assert list(work_ahead(iter([]), square, lambda: True)) == []


@pytest.mark.parametrize("ahead", [True, False])
def test_work_runs_ahead_by_one_item_where_it_may(ahead: bool) -> None:
    begun = [threading.Event() for _ in range(5)]
    for number, _ in zip(range(4), work_ahead(iter(begun), threading.Event.set, lambda: ahead), strict=False):
        assert begun[number + 1].wait(5.0 if ahead else 0.02) == ahead
        assert not any(event.is_set() for event in begun[number + 2 :])


@pytest.mark.parametrize("broken", ["item", "work"])
def test_an_error_of_work_comes_at_its_item(broken: str) -> None:
    def numbers() -> Iterator[int]:
        yield from (6, 3)
        yield 0
        if broken == "item":
            raise DataError("no more numbers")

    found: list[int] = []
    with pytest.raises(DataError if broken == "item" else ZeroDivisionError):
        found.extend(work_ahead(numbers(), lambda number: 6 if broken == "item" else 6 // number, lambda: True))
    assert found == ([6, 6, 6] if broken == "item" else [1, 2])


def test_work_that_is_no_longer_wanted_ends_its_thread() -> None:
    before, begun = threading.active_count(), []
    results = work_ahead(iter(range(100)), begun.append, lambda: True)
    next(results)
    results.close()
    assert threading.active_count() == before
    assert len(begun) <= 2
