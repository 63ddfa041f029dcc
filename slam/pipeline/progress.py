"""Progress bar of a run, and its interruption from the keyboard without losing results."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text


class _RateColumn(ProgressColumn):
    """Frames per second."""

    def render(self, task: Task) -> Text:
        """Show the recent rate."""
        rate = task.finished_speed or task.speed
        return Text("" if rate is None else f"{rate:.1f} frames/s", style="cyan")


@contextmanager
def progress_bar(console: Console, title: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function `(done, total)` that moves the bar; nothing is drawn if the console is no terminal."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        _RateColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task(title, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


class StopRequest:
    """Whether the user has asked to stop.

    Attributes:
        requested: whether that is so.
    """

    def __init__(self, messages: Console | None = None) -> None:
        self.requested = False
        self._messages = messages

    def request(self, number: int, frame: FrameType | None) -> None:
        """Handle the signal; a second one interrupts at once."""
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
        if self._messages is not None:
            self._messages.print("Interrupted: the results are written first; Ctrl-C again gives them up.")


@contextmanager
def stop_on_interrupt(messages: Console | None = None) -> Iterator[StopRequest]:
    """Turn the first Ctrl-C within the block into a request, which the loop checks between two frames.

    A block that checks nothing, such as one that writes results, ends as if nothing had been requested. Python handles
    signals in the main thread only; in another thread nothing is ever requested.

    Args:
        messages: console on which such a block says so; None for a loop that has its own words.
    """
    request = StopRequest(messages)
    if threading.current_thread() is not threading.main_thread():
        yield request
        return
    before = signal.signal(signal.SIGINT, request.request)
    try:
        yield request
    finally:
        signal.signal(signal.SIGINT, before)
