"""Executors: run a list of independent jobs in this process, or in many.

Many processes, on this machine or those of a scheduler, are those of dask.distributed (the extra `cluster`). Why dask,
and what it costs: docs/decisions/cluster.md.
"""

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass
from itertools import count
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeVar
from uuid import uuid4

from slam.errors import ConfigError

_LOOPBACK = "127.0.0.1"
_ALLOWED_DEATHS = 2  # of own processes on the same item; the next one makes the item a failure
_MAX_CONNECT_ATTEMPTS = 5
_CONNECT_TIMEOUT_S = 20  # after which a scheduler that does not answer is an error
_POLL_INTERVAL_S = 0.05
# dask's defaults are made for large tables; runs allocate and free arrays with each frame.
_DASK_SETTINGS = {
    # Returning freed memory to the system at once costs a third of a run's time, all of it in the kernel; None leaves
    # the allocator at the system's default.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
    # Threads of OpenCV cost a tenth where each core has a process of its own.
    "distributed.nanny.pre-spawn-environ.OPENCV_FOR_THREADS_NUM": 1,
    # The profiler, which samples every 10 ms, costs a twentieth.
    "distributed.worker.profile.enabled": False,
    # On a busy machine a process may be silent for long, and must not be given up.
    "distributed.deploy.lost-worker-timeout": "1 day",
}
Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Completed(Generic[Item, Result]):
    """An item and the result of the work on it."""

    item: Item
    result: Result


@dataclass(frozen=True)
class Failed(Generic[Item]):
    """An item whose work gave no result, and the reason in one line."""

    item: Item
    reason: str


class Executor(Protocol):
    """Runs work on items; a context manager that stops at its end whatever it has started.

    Work is repeated if its process dies, so doing it twice must have the same effect as doing it once. Functions, items
    and results are sent between processes and must be picklable.
    """

    def run(
        self, work: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[Completed[Item, Result] | Failed[Item]]:
        """Do the work for every item and yield each outcome as soon as it is there, in any order."""

    def __enter__(self) -> Self:
        """Start the processes."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the processes."""


class SerialExecutor:
    """Runs one item after the other in this process (an Executor)."""

    def run(
        self, work: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[Completed[Item, Result] | Failed[Item]]:
        """Do the work for every item in turn; an exception of the work is raised."""
        return (Completed(item, work(item)) for item in items)

    def __enter__(self) -> Self:
        """Start nothing."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop nothing."""


class DaskExecutor:
    """Runs each item in the next free process (an Executor).

    An item whose process dies is given to another process. After three deaths the item counts as their cause, and
    fails. Processes that the executor starts itself listen on the loopback device only.
    """

    def __init__(self, workers: int, scheduler: str | None) -> None:
        """Prepare an executor; processes start when it is entered.

        Args:
            workers: number of processes to start on this machine; ignored where there is a scheduler.
            scheduler: address of an existing dask scheduler; its workers must see the same files.

        Raises:
            ConfigError: dask.distributed is not installed.
        """
        self._workers, self._scheduler = workers, scheduler
        self._distributed = _import_distributed()
        self._client: Any = None
        self._resources = ExitStack()

    @property
    def address(self) -> str:
        """Address of the scheduler, once the executor is entered."""
        return str(self._client.scheduler.address)

    def run(
        self, work: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[Completed[Item, Result] | Failed[Item]]:
        """Do the work for every item and yield each outcome as soon as it is there, in any order."""
        waiting, running, ready = deque(items), dict[Any, Item](), self._distributed.as_completed()
        submit = self._submitter(work)

        def fill() -> None:
            # No more than can run at once: an item that only waits at a dying process would be suspected as well.
            while waiting and len(running) < self._capacity:
                item = waiting.popleft()
                future = submit(item)
                running[future] = item
                ready.add(future)

        try:
            fill()
            while running:
                future = next(ready) if ready.has_ready() else None
                outcomes = [] if future is None else [_outcome(running.pop(future), future)]
                fill()  # even without a new outcome: a process that had died may be back
                yield from outcomes
                time.sleep(0 if outcomes else _POLL_INTERVAL_S)
        finally:
            self._client.cancel(list(running))

    @property
    def _capacity(self) -> int:
        """Number of items that can run at once."""
        return max(1, sum(self._client.nthreads().values()))

    def _submitter(self, work: Callable[[Item], Result]) -> Callable[[Item], Any]:
        """Return a function that starts an item and returns its future."""
        # The keys are unique to this call: a scheduler takes a task of a known key for one that it has done already.
        mark, numbers = uuid4().hex[:8], count()
        return lambda item: self._client.submit(work, item, key=f"revisit-{mark}-{next(numbers)}", pure=False)

    def __enter__(self) -> Self:
        """Start the processes, or connect to the scheduler.

        Raises:
            ConfigError: the scheduler does not answer.
        """
        address = self._scheduler
        try:
            self._resources.enter_context(_dask_settings())
            target = self._resources.enter_context(self._local_cluster()) if address is None else address
            self._client = self._resources.enter_context(self._connect(target))
        except (OSError, ValueError) as error:
            self._resources.close()
            reason = " ".join(str(error).split())
            raise ConfigError(
                f"--scheduler {address}: expected a dask scheduler, {reason}; check it, or leave it out"
            ) from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Stop the processes, or disconnect from the scheduler."""
        self._resources.close()

    def _connect(self, target: Any) -> Any:
        """Return a client of a scheduler."""
        # dask asserts that the scheduler's first message comes alone, and fails where news for all clients join it.
        for _ in range(_MAX_CONNECT_ATTEMPTS - 1):
            with suppress(AssertionError):
                return self._distributed.Client(target, timeout=_CONNECT_TIMEOUT_S)
        return self._distributed.Client(target, timeout=_CONNECT_TIMEOUT_S)

    def _local_cluster(self) -> Any:
        """Return processes of one thread each, whose memory dask does not limit: a run needs what it needs."""
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


def _outcome(item: Item, future: Any) -> Completed[Item, Any] | Failed[Item]:
    # The state of a future that is ready may still change: a result is lost with the process that keeps it, and then
    # made again. So the result itself is awaited.
    try:
        return Completed(item, future.result())
    except Exception as error:
        return Failed(item, f"the worker failed: {' '.join(str(error).split())}")


def _dask_settings() -> AbstractContextManager[object]:
    """Return a context in which dask starts processes as runs need them."""
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


def make_executor(workers: int | None, scheduler: str | None, default_workers: int) -> Executor:
    """Make an executor from the options `--workers` and `--scheduler`.

    Args:
        workers: number of processes on this machine; 0 for this process alone, None where the option is not given.
        scheduler: address of a dask scheduler to use instead; None where the option is not given.
        default_workers: number of processes where neither option is given.

    Raises:
        ConfigError: the number is negative, both options are given, or dask is not installed.
    """
    if scheduler is not None and workers is not None:
        raise ConfigError("--scheduler: expected no --workers beside it, found both; the scheduler has its own")
    count = default_workers if workers is None else workers
    if count < 0:
        raise ConfigError(f"--workers: expected 0 or more, found {count}")
    is_serial = count == 0 and scheduler is None
    return SerialExecutor() if is_serial else DaskExecutor(count, scheduler)
