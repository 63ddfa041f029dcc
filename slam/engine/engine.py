"""Executors: run one function on many items, in this process or in several."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeVar

from numpy.typing import NDArray

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Completed(Generic[Item, Result]):
    """An item and the result of its work.

    Attributes:
        item: argument of the work.
        result: return value of the work.
    """

    item: Item
    result: Result


@dataclass(frozen=True)
class Failed(Generic[Item]):
    """An item without a result.

    Attributes:
        item: argument of the work.
        reason: reason of the failure, one line.
    """

    item: Item
    reason: str


class Executor(Protocol):
    """Runs work on items; a context manager that ends the processes it has started.

    Work is repeated when its process dies, so it must be idempotent. The work, the items and the results are sent
    between processes and must therefore be serialisable.
    """

    def run(
        self, work: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[Completed[Item, Result] | Failed[Item]]:
        """Do the work for every item and yield each result or failure as it arrives, in any order."""

    def map(self, work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Yield the results in the order of the items, like the builtin `map`; only a few items are begun ahead.

        Raises:
            ExecutorError: the processes that worked on one item died repeatedly.
        """

    def share(self, array: NDArray[Any], folder: Path) -> NDArray[Any]:
        """The same numbers where all can read them: a file in the folder, where they are not all here.

        Raises:
            OSError: the file cannot be written.
        """

    def __enter__(self) -> Self:
        """Start the processes."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the processes."""


class SerialExecutor:
    """Runs one item after the other in this process (an Executor)."""

    def run(
        self, work: Callable[[Item], Result], items: Sequence[Item]
    ) -> Iterator[Completed[Item, Result] | Failed[Item]]:
        """Do the work for every item in turn; an exception of the work ends the iteration and is raised."""
        return (Completed(item, work(item)) for item in items)

    def map(self, work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """Yield the results in turn."""
        return map(work, items)

    def share(self, array: NDArray[Any], folder: Path) -> NDArray[Any]:
        """The array itself."""
        return array

    def __enter__(self) -> Self:
        """Return the executor; there is nothing to start."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Do nothing; there is nothing to end."""
