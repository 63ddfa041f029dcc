"""Working ahead: threads read, prepare and measure the next frames while the current one is processed.

Decision record: docs/decisions/features_on_the_frame.md.
"""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from itertools import islice
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from slam.datasets.dataset import Dataset, Frame, read_color

Item = TypeVar("Item")
Result = TypeVar("Result")
ItemRead = TypeVar("ItemRead", covariant=True)


class Recording(Protocol[ItemRead]):
    """Frames, or images alone, that are read on demand by their index."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> ItemRead: ...


class ColorFrames:
    """The frames of a dataset with their left images in colour."""

    def __init__(self, dataset: Dataset) -> None:
        self._dataset = dataset

    def __len__(self) -> int:
        return len(self._dataset)

    def __getitem__(self, index: int) -> Frame:
        """Read a frame."""
        return replace(self._dataset[index], color=self._dataset.read_color(index))


class ColorImages:
    """The images of a recording in colour, (H, W, 3) red first, those that are grey as (H, W)."""

    def __init__(self, images: Recording[NDArray[np.uint8]]) -> None:
        self._images = images

    def __len__(self) -> int:
        return len(self._images)

    def __getitem__(self, index: int) -> NDArray[np.uint8]:
        """Read an image: once, where it is in colour."""
        color = read_color(self._images, index)
        return self._images[index] if color is None else color


def has_color(images: object) -> bool:
    """Whether the first image of a dataset or recording can be read in colour."""
    return read_color(images, 0) is not None


def prefetch(
    recording: Recording[Item], ahead: int = 4, begin: int = 0, prepare: Callable[[Item], Item] | None = None
) -> Iterator[Item]:
    """Frames of a recording in order, read by one background thread.

    Args:
        recording: what to read.
        ahead: maximum number of frames that wait in memory.
        begin: index of the first frame.
        prepare: function that the thread applies to each frame after reading it, such as feature extraction; None
            for none.

    Raises:
        DataError: a frame cannot be read; raised where that frame is reached, after all frames before it.
    """

    def read(index: int) -> Item:
        item = recording[index]
        return item if prepare is None else prepare(item)

    # One thread: decoding and extraction release the interpreter lock, and more threads would compete with those of
    # the odometry.
    executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="read-ahead")
    waiting: deque[Future[Item]] = deque()
    try:
        for index in range(begin, len(recording)):
            waiting.append(executor.submit(read, index))
            if len(waiting) >= ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:  # also where the consumer stops early: nothing is read any more
        executor.shutdown(cancel_futures=True)


def work_ahead(
    items: Iterator[Item], work: Callable[[Item], Result], may_run_ahead: Callable[[], bool]
) -> Iterator[Result]:
    """Results of work on items, in order; one background thread works on the next item while the last result is used.

    Args:
        items: what to work on; the thread also takes them.
        work: function of one item.
        may_run_ahead: called before each result is handed out: whether the work on the next item may begin at once.
            Otherwise it begins when the next result is asked for, and what both sides share stands still until then.

    Raises:
        Exception: that of an item, or of the work on it, where its result is reached.
    """

    def take() -> tuple[Result, ...]:
        return tuple(work(item) for item in islice(items, 1))

    executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="work-ahead")
    try:
        results = executor.submit(take)
        while result := results.result():
            runs_ahead = may_run_ahead()
            if runs_ahead:
                results = executor.submit(take)
            yield result[0]
            if not runs_ahead:
                results = executor.submit(take)
    finally:  # also where the consumer stops early: no further item is begun
        executor.shutdown(cancel_futures=True)
