"""Executor on processes of dask.distributed (the extra `cluster`): on this machine or of an existing scheduler.

The choice of dask and its figures: docs/decisions/cluster.md.
"""

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

from slam.engine.engine import Completed, Failed, Item, Result
from slam.errors import ConfigError, ExecutorError

_LOOPBACK = "127.0.0.1"
_MAX_WORKER_DEATHS = 2  # deaths of own workers on one item that are tolerated; with the next one the item fails
_MAX_CONNECTION_ATTEMPTS = 5
_CONNECTION_TIMEOUT_S = 20
_POLL_INTERVAL_S = 0.05  # short beside the seconds of an item, long enough to cost no processor time
# dask's defaults are made for large tables and slow down runs, which allocate and free arrays with each frame:
# * returning freed memory to the kernel at once costs a third of the time; None restores the allocator's own threshold;
# * OpenCV threads compete with the other processes, one per core, and cost a tenth of the time;
# * the profiler, which samples every 10 ms, costs a twentieth.
# A worker that answers late because all cores are busy must not be lost for good, hence the timeout of a day.
_DASK_SETTINGS = {
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
    "distributed.nanny.pre-spawn-environ.OPENCV_FOR_THREADS_NUM": 1,
    "distributed.worker.profile.enabled": False,
    "distributed.deploy.lost-worker-timeout": "1 day",
}


class DaskExecutor:
    """Runs each item in the next free process (an Executor).

    An item whose process dies is given to another process. After a few deaths the item itself is taken for their cause
    and fails. Own processes listen on the loopback device only.
    """

    def __init__(self, workers: int, scheduler: str | None) -> None:
        """Prepare the executor; processes are started when the context is entered.

        Args:
            workers: number of processes to start on this machine; ignored if there is a scheduler.
            scheduler: address of an existing scheduler, whose workers must see the same files; None to start workers.

        Raises:
            ConfigError: dask.distributed is not installed.
        """
        self._workers, self._scheduler = workers, scheduler
        self._distributed = _import_distributed()
        self._client: Any = None
        self._open = ExitStack()

    @property
    def address(self) -> str:
        """Address of the scheduler, within the context."""
        return str(self._client.scheduler.address)

    def run(
        self, work: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[Completed[Item, Result] | Failed[Item]]:
        """Do the work for every item and yield each result or failure as it arrives, in any order."""
        waiting, running, done = deque(items), dict[Any, Item](), self._distributed.as_completed()
        submit = self._submitter(work)

        def fill() -> None:
            # Submit only as many as can run at once: an item that waits at a dying process would be blamed too.
            while waiting and len(running) < self._slots:
                item = waiting.popleft()
                future = submit(item)
                running[future] = item
                done.add(future)

        try:
            fill()
            while running:
                ready = next(done) if done.has_ready() else None
                ended = [] if ready is None else [_completed_or_failed(running.pop(ready), ready)]
                fill()  # even if nothing has ended: a restarted worker may be free again
                yield from ended
                time.sleep(0 if ended else _POLL_INTERVAL_S)
        finally:
            self._client.cancel(list(running))

    def map(self, work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """The results in the order of the items; twice as many as can be done at once are begun ahead.

        Raises:
            ExecutorError: the processes that worked on one item died, or the scheduler was lost. Exceptions of the work
                are raised as they are.
        """
        waiting, begun, submit = iter(items), deque[Any](), self._submitter(work)
        try:
            while True:
                begun.extend(map(submit, islice(waiting, max(0, 2 * self._slots - len(begun)))))
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
    def _slots(self) -> int:
        """Number of items that can run at once."""
        return max(1, sum(self._client.nthreads().values()))

    def _submitter(self, work: Callable[[Item], Result]) -> Callable[[Item], Any]:
        """Return a function that submits one item and returns its future."""
        batch = uuid4().hex[:8]  # a key used before would give the result of the earlier item
        numbers = count()
        return lambda item: self._client.submit(work, item, key=f"revisit-{batch}-{next(numbers)}", pure=False)

    def _result(self, future: Any) -> Any:
        deaths = (self._distributed.KilledWorker, CancelledError)
        try:
            return future.result()
        except deaths as error:
            raise ExecutorError(
                f"expected worker processes that live, {_reason(error)}; give them more memory, or --workers 0"
            ) from None

    def __enter__(self) -> Self:
        """Start the processes, or connect to the scheduler.

        Raises:
            ConfigError: the scheduler does not answer.
        """
        address = self._scheduler
        try:
            self._open.enter_context(_dask_settings())
            cluster = self._open.enter_context(self._local_cluster()) if address is None else address
            self._client = self._open.enter_context(self._connect(cluster))
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
        """End the own processes, or disconnect from the scheduler."""
        self._open.close()

    def _connect(self, cluster: Any) -> Any:
        """Connect to a scheduler.

        Retries because the client of dask asserts that the first message holds the greeting alone, which fails if the
        scheduler broadcasts another message to all clients at that moment.
        """
        for _ in range(_MAX_CONNECTION_ATTEMPTS - 1):
            with suppress(AssertionError):
                return self._distributed.Client(cluster, timeout=_CONNECTION_TIMEOUT_S)
        return self._distributed.Client(cluster, timeout=_CONNECTION_TIMEOUT_S)

    def _local_cluster(self) -> Any:
        """Workers of one thread each, without the memory limit of dask: a run may need more than its share."""
        settings = {"dashboard": False, "dashboard_address": f"{_LOOPBACK}:0", "allowed_failures": _MAX_WORKER_DEATHS}
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


def _completed_or_failed(item: Item, future: Any) -> Completed[Item, Any] | Failed[Item]:
    # Do not trust the state of the future: a result is lost with the process that holds it, and is then computed again.
    try:
        return Completed(item, future.result())
    except Exception as error:
        return Failed(item, _reason(error))


def _reason(error: Exception) -> str:
    """Reason of a failure, one line."""
    return f"the worker failed: {' '.join(str(error).split())}"


def _dask_settings() -> AbstractContextManager[object]:
    """Context in which dask starts processes with the settings that runs need."""
    import dask

    context: AbstractContextManager[object] = dask.config.set(_DASK_SETTINGS)
    return context


def _import_distributed() -> Any:
    try:
        import distributed
    except ImportError:
        raise ConfigError(
            "several processes need dask.distributed, which is not installed; type: "
            "pip install 'revisit-slam[cluster]', or give --workers 0"
        ) from None
    return distributed
