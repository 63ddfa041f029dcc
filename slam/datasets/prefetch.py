"""Reading ahead: the next images are decoded while the current ones are worked on."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol, TypeVar

Item = TypeVar("Item", covariant=True)


class Recording(Protocol[Item]):
    """Frames, or images alone, that are read when asked for by their index."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> Item: ...


def prefetch(recording: Recording[Item], ahead: int = 4, begin: int = 0) -> Iterator[Item]:
    """Frames of the drive in order, read by one background thread.

    Args:
        recording: the drive.
        ahead: frames that wait in memory at most.
        begin: index of the first one.

    Raises:
        DataError: where the frame is reached that cannot be read; the frames before it are given.
    """
    # One thread: decoding and describing let go of the interpreter, and more would compete with the odometry's own.
    executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="read-ahead")
    waiting: deque[Future[Item]] = deque()
    try:
        for index in range(begin, len(recording)):
            waiting.append(executor.submit(recording.__getitem__, index))
            if len(waiting) >= ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:  # also where the consumer stops early: nothing is read any more
        executor.shutdown(cancel_futures=True)
