"""Work on processes of dask.distributed (the extra `cluster`): on this machine, or those of an existing scheduler."""

import logging
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, ExitStack, suppress
from itertools import count, islice
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from slam.engine.engine import Done, Item, Lost, Result
from slam.errors import ConfigError, EngineError

_LOOPBACK = "127.0.0.1"
_ALLOWED_DEATHS = 2  # of processes of our own that do the same item
_TRIES = 5  # to greet a scheduler
_PATIENCE_S = 20  # until a scheduler that does not answer is given up
_LOOK_S = 0.05  # between two looks at what has ended
# What dask sets up for large tables is not for runs, which take and free arrays with each frame. Giving freed memory
# back at once costs a third of their time, all in the kernel; None leaves the allocator as it is elsewhere. Threads of
# OpenCV where each core has its process cost a tenth, a profiler that looks every 10 ms a twentieth. And a process that
# comes back late, as it may where all cores are busy, is not given up for good.
_SETTINGS = {
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
    "distributed.nanny.pre-spawn-environ.OPENCV_FOR_THREADS_NUM": 1,
    "distributed.worker.profile.enabled": False,
    "distributed.deploy.lost-worker-timeout": "1 day",
}


class Cluster:
    """Does each item in the next process that is free (an Engine).

    An item whose process dies is given to another one; after some deaths it is taken for what kills them, and fails.
    Processes of our own listen on the loopback device only.
    """

    def __init__(self, workers: int, scheduler: str | None) -> None:
        """Start nothing yet.

        Args:
            workers: processes to start on this machine; of no meaning where there is a scheduler.
            scheduler: address of an existing one; its workers must see the same files.

        Raises:
            ConfigError: dask.distributed is not installed.
        """
        self._workers, self._scheduler = workers, scheduler
        self._distributed = _library()
        self._client: Any = None
        self._open = ExitStack()

    @property
    def address(self) -> str:
        """Of the scheduler, once begun."""
        return str(self._client.scheduler.address)

    def run(self, work: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Done[Item, Result] | Lost[Item]]:
        """Do the work for every item; what becomes of each as it comes."""
        waiting, running, done = deque(items), dict[Any, Item](), self._distributed.as_completed()
        submit = self._submitter(work)

        def fill() -> None:
            # No more than can be done at once: what waits at a process that dies would be suspected as well.
            while waiting and len(running) < self._free:
                item = waiting.popleft()
                future = submit(item)
                running[future] = item
                done.add(future)

        try:
            fill()
            while running:
                ready = next(done) if done.has_ready() else None
                ended = [] if ready is None else [_ended(running.pop(ready), ready)]
                fill()  # also where nothing has ended: a process that had died may be back
                yield from ended
                time.sleep(0 if ended else _LOOK_S)
        finally:
            self._client.cancel(list(running))

    def map(self, work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """The results in the order of the items; twice as many as can be done at once are begun ahead.

        Raises:
            EngineError: the processes that did an item died, or the scheduler was lost. What the work raises is raised.
        """
        waiting, begun, submit = iter(items), deque[Any](), self._submitter(work)
        try:
            while True:
                begun.extend(map(submit, islice(waiting, max(0, 2 * self._free - len(begun)))))
                if not begun:
                    return
                yield self._result(begun.popleft())
        finally:
            self._client.cancel(list(begun))

    def share(self, array: NDArray[Any], folder: Path) -> NDArray[Any]:
        """The array in a .npy file of the folder, mapped into memory when it is read.

        Raises:
            OSError: it cannot be written.
        """
        path = folder / "shared.npy"
        np.save(path, array)
        return np.lib.format.open_memmap(path, mode="r")

    @property
    def _free(self) -> int:
        """Items that can be done at once."""
        return max(1, sum(self._client.nthreads().values()))

    def _submitter(self, work: Callable[[Item], Result]) -> Callable[[Item], Any]:
        """What begins an item, and gives its future."""
        mark = uuid4().hex[:8]  # of these items: a scheduler would take an equal name for what it has done
        numbers = count()
        return lambda item: self._client.submit(work, item, key=f"revisit-{mark}-{next(numbers)}", pure=False)

    def _result(self, future: Any) -> Any:
        deaths = (self._distributed.KilledWorker, CancelledError)
        try:
            return future.result()
        except deaths as error:
            raise EngineError(
                f"expected worker processes that live, {_reason(error)}; give them more memory, or --workers 0"
            ) from None

    def __enter__(self) -> Self:
        """Start the processes, or reach the scheduler.

        Raises:
            ConfigError: it does not answer.
        """
        address = self._scheduler
        try:
            self._open.enter_context(_settings())
            where = self._open.enter_context(self._own()) if address is None else address
            self._client = self._open.enter_context(self._greeted(where))
        except (OSError, ValueError) as error:
            self._open.close()
            reason = " ".join(str(error).split())
            raise ConfigError(
                f"--scheduler {address}: expected a dask scheduler, {reason}; check it, or leave it out"
            ) from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the processes, or leave the scheduler."""
        self._open.close()

    def _greeted(self, where: Any) -> Any:
        """A client of a scheduler.

        Dask asserts that the greeting comes alone, which it does not where news for all clients leave at that moment.
        """
        for _ in range(_TRIES - 1):
            with suppress(AssertionError):
                return self._distributed.Client(where, timeout=_PATIENCE_S)
        return self._distributed.Client(where, timeout=_PATIENCE_S)

    def _own(self) -> Any:
        """Processes with one thread each. Their memory is what runs need, not what dask would have them share."""
        settings = {"dashboard": False, "dashboard_address": f"{_LOOPBACK}:0", "allowed_failures": _ALLOWED_DEATHS}
        return self._distributed.LocalCluster(
            n_workers=self._workers,
            threads_per_worker=1,
            processes=True,
            host=_LOOPBACK,
            dashboard_address=None,
            scheduler_kwargs=settings,
            memory_limit=0,
            silence_logs=logging.CRITICAL,
        )


def _ended(item: Item, future: Any) -> Done[Item, Any] | Lost[Item]:
    # Its state may still change: a result is lost with the process that keeps it, and then made again.
    try:
        return Done(item, future.result())
    except Exception as error:
        return Lost(item, _reason(error))


def _reason(error: Exception) -> str:
    """Why there is no result, one line."""
    return f"the worker failed: {' '.join(str(error).split())}"


def _settings() -> AbstractContextManager[object]:
    """Has dask work as runs need it, in processes that are started meanwhile."""
    import dask

    context: AbstractContextManager[object] = dask.config.set(_SETTINGS)
    return context


def _library() -> Any:
    try:
        import distributed
    except ImportError:
        raise ConfigError(
            "several processes need dask.distributed, which is not installed; type: "
            "pip install 'revisit-slam[cluster]', or give --workers 0"
        ) from None
    return distributed
