"""What does the jobs of a benchmark: this process, or many."""

from collections.abc import Callable, Iterator, Sequence
from types import TracebackType
from typing import Protocol, Self

from slam.benchmark.job import Job, Outcome

Work = Callable[[Job], Outcome]


class Engine(Protocol):
    """Does jobs; used as a context manager, which ends whatever it has started."""

    def run(self, work: Work, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Do the work for every job, and give each outcome as it comes, in any order.

        The work may be done again where its process dies: what it does twice must be as if done once.
        """

    def __enter__(self) -> Self:
        """Begin."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End."""


class OneProcess:
    """Does one job after the other here (an Engine)."""

    def run(self, work: Work, jobs: Sequence[Job]) -> Iterator[Outcome]:
        """Do the work for every job in turn."""
        return map(work, jobs)

    def __enter__(self) -> Self:
        """Begin: there is nothing to start."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End: there is nothing to end."""
