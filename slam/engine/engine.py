"""What does work that consists of many items: this process, or many."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, Protocol, Self, TypeVar

from numpy.typing import NDArray

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Done(Generic[Item, Result]):
    """An item, and what came of it."""

    item: Item
    result: Result


@dataclass(frozen=True)
class Lost(Generic[Item]):
    """An item of which nothing came, and why, in one line."""

    item: Item
    reason: str


class Engine(Protocol):
    """Does work; used as a context manager, which ends whatever it has started.

    The work may be done again where its process dies: what it does twice must be as if done once. It, the items and the
    results go from process to process.
    """

    def run(self, work: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Done[Item, Result] | Lost[Item]]:
        """Do the work for every item; what becomes of each as it comes, in any order."""

    def map(self, work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """The results in the order of the items, as the builtin does it; some items are begun ahead, never all.

        Raises:
            EngineError: whatever did an item died, again and again.
        """

    def share(self, array: NDArray[Any], folder: Path) -> NDArray[Any]:
        """The same numbers where all can read them: a file in the folder, where they are not all here.

        Raises:
            OSError: the file cannot be written.
        """

    def __enter__(self) -> Self:
        """Begin."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End."""


class OneProcess:
    """Does one item after the other here (an Engine)."""

    def run(self, work: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Done[Item, Result] | Lost[Item]]:
        """Do the work for every item in turn; what it raises ends it."""
        return (Done(item, work(item)) for item in items)

    def map(self, work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
        """The results in turn."""
        return map(work, items)

    def share(self, array: NDArray[Any], folder: Path) -> NDArray[Any]:
        """The array itself."""
        return array

    def __enter__(self) -> Self:
        """Begin: there is nothing to start."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End: there is nothing to end."""
