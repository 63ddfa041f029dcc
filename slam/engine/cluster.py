"""Work on processes of dask.distributed (the extra `cluster`): on this machine, or those of an existing scheduler."""

import logging
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, suppress
from itertools import count, islice
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from uuid import uuid4

from numpy.typing import NDArray

from slam.engine.engine import Done, Item, Lost, Result, stored
from slam.errors import ConfigError, EngineError

_LOOPBACK = "127.0.0.1"
_ALLOWED_DEATHS = 2  # of processes of our own that do the same item
_TRIES = 5  # to greet a scheduler
_PATIENCE_S = 20  # until a scheduler that does not answer is given up
# Dask has its processes give freed memory back at once, which serves large tables. A run takes and frees arrays with
# each frame and pays for it with a third of its time, all in the kernel. None: as in any other process.
_ENVIRONMENT = {"distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None}


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
            for future in done:
                item = running.pop(future)
                ended = Done(item, future.result()) if future.status == "finished" else Lost(item, _reason(future))
                fill()
                yield ended
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
        """The array in a file of the folder.

        Raises:
            OSError: it cannot be written.
        """
        return stored(array, folder)

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
        except deaths:
            raise EngineError(
                f"expected worker processes that live, {_reason(future)}; give them more memory, or --workers 0"
            ) from None

    def __enter__(self) -> Self:
        """Start the processes, or reach the scheduler.

        Raises:
            ConfigError: it does not answer.
        """
        address = self._scheduler
        try:
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
        import dask

        settings = {"dashboard": False, "dashboard_address": f"{_LOOPBACK}:0", "allowed_failures": _ALLOWED_DEATHS}
        with dask.config.set(_ENVIRONMENT):
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


def _reason(future: Any) -> str:
    """Why there is no result, one line."""
    reason = " ".join(str(future.exception()).split()) if future.status == "error" else future.status
    return f"the worker failed: {reason}"


def _library() -> Any:
    try:
        import distributed
    except ImportError:
        raise ConfigError(
            "several processes need dask.distributed, which is not installed; type: "
            "pip install 'revisit-slam[cluster]', or give --workers 0"
        ) from None
    return distributed
