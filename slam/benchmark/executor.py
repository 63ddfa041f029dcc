"""Executors: run a list of independent jobs in this process, or in many (`slam.benchmark.dask_executor`)."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Generic, Protocol, Self, TypeVar

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
