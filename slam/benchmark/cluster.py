"""Jobs on processes of dask.distributed (the extra `cluster`): on this machine, or those of an existing scheduler."""

import logging
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import Any, Self
from uuid import uuid4

from slam.benchmark.engine import Work
from slam.benchmark.job import Job, Outcome
from slam.errors import ConfigError

_LOOPBACK = "127.0.0.1"
_ALLOWED_DEATHS = 2  # of processes of our own that do the same job
_TRIES = 5  # to greet a scheduler
_PATIENCE_S = 20  # until a scheduler that does not answer is given up
# Dask has its processes give freed memory back at once, which serves large tables. A run takes and frees arrays with
# each frame and pays for it with a third of its time, all in the kernel. None: as in any other process.
_ENVIRONMENT = {"distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None}


class Cluster:
    """Does each job in the next process that is free (an Engine).

    A job whose process dies is given to another one; after some deaths the job is taken for what kills them, and fails.
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

    def run(self, work: Work, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Do the work for every job; each outcome as it comes."""
        waiting, running, done = deque(jobs), dict[Any, Job](), self._distributed.as_completed()
        mark = uuid4().hex[:8]  # of this command: a scheduler would take an equal name for a job that it has done

        def fill() -> None:
            # No more than can be done at once: what waits at a process that dies would be suspected as well.
            while waiting and len(running) < max(1, sum(self._client.nthreads().values())):
                job = waiting.popleft()
                future = self._client.submit(work, job, key=f"{job.name}-{mark}", pure=False)
                running[future] = job
                done.add(future)

        try:
            fill()
            for future in done:
                outcome = _outcome(running.pop(future), future)
                fill()
                yield outcome
        finally:
            self._client.cancel(list(running))

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


def _outcome(job: Job, future: Any) -> Outcome:
    if future.status == "finished":
        return future.result()
    reason = " ".join(str(future.exception()).split()) if future.status == "error" else future.status
    return Outcome(job.name, {}, f"the worker failed: {reason}")


def _library() -> Any:
    try:
        import distributed
    except ImportError:
        raise ConfigError(
            "a benchmark on several processes needs dask.distributed, which is not installed; type: "
            "pip install 'revisit-slam[cluster]', or give --workers 0"
        ) from None
    return distributed
