"""Progress bar of a run with its loops and its error so far, and its interruption without losing results."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.segment import Segment
from rich.style import Style
from rich.text import Text

from slam.evaluation.trajectory_errors import Alignment, absolute_trajectory_error

Array = NDArray[np.float64]

_RUN_BAR_CELLS = 20  # the whole line then fits a terminal of 80 columns
# Between two errors: each copies all poses so far, for which a longer drive has longer intervals.
_ERROR_INTERVAL_FRAMES, _ERROR_INTERVAL_SHARE = 25, 0.01
_LOOP_ERROR_INTERVAL_FRAMES = 5  # after a loop the error is shown sooner
_DONE, _LEFT = Style(color="cyan"), Style(color="grey37")
_LOOP = Style(color="green", bold=True)


class _RateColumn(ProgressColumn):
    """Frames per second."""

    def render(self, task: Task) -> Text:
        """Show the recent rate."""
        rate = task.finished_speed or task.speed
        return Text("" if rate is None else f"{rate:.1f} frames/s", style="cyan")


@contextmanager
def progress_bar(console: Console, title: str) -> Iterator[Callable[[int, int], None]]:
    """Yield a function `(done, total)` that moves the bar; nothing is drawn if the console is no terminal."""
    with Progress(*_columns(BarColumn()), console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task(title, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


def _columns(bar: ProgressColumn) -> tuple[ProgressColumn, ...]:
    return (
        TextColumn("{task.description}"),
        bar,
        MofNCompleteColumn(),
        _RateColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )


@contextmanager
def announce_compilation(console: Console) -> Iterator[None]:
    """Say once within the block that kernels are compiled, if they are: else the first run seems to stand still.

    Kernels that numba has in its cache are none of these.
    """
    from numba.core import event

    class Notice(event.Listener):
        is_given = False

        def on_start(self, event: object) -> None:
            if not self.is_given:
                self.is_given = True
                console.print("Compiling kernels, once on this machine: up to a minute")

        def on_end(self, event: object) -> None:
            pass

    with event.install_listener("numba:compile", Notice()):
        yield


class RunProgress(Protocol):
    """Shows the progress of a run."""

    def show(self, index: int, is_closed: bool, poses: Callable[[], Array]) -> None:
        """Show that a frame is processed.

        Args:
            index: number of the frame.
            is_closed: whether a loop was closed with it.
            poses: returns the trajectory so far, T_world_camera (index + 1, 4, 4); called only if it is shown.
        """
        ...


class HiddenProgress:
    """Progress that nobody watches (a RunProgress)."""

    def show(self, index: int, is_closed: bool, poses: Callable[[], Array]) -> None:
        """Do nothing."""


class ProgressLine:
    """Progress as one line of the terminal: bar with a mark for each loop, rate, time left, error (a RunProgress)."""

    def __init__(self, progress: Progress, num_frames: int, live_error: "LiveError") -> None:
        self._progress, self._live_error, self._loops = progress, live_error, list[int]()
        self._task = progress.add_task("Processing", total=num_frames, loops=self._loops, error="")

    def show(self, index: int, is_closed: bool, poses: Callable[[], Array]) -> None:
        """Move the bar, mark a loop on it, and show the error so far."""
        if is_closed:
            self._loops.append(index)
        error = self._live_error.describe(index, is_closed, poses)
        self._progress.update(self._task, completed=index + 1, error=error)


class LiveError:
    """The error of the trajectory so far by ground truth, computed every few frames."""

    def __init__(self, ground_truth: Array | None, alignment: Alignment) -> None:
        """Take the true poses (N, 4, 4), metres, or None where they are not known."""
        self._truth, self._alignment = ground_truth, alignment
        self._text, self._measured_at = "", -_ERROR_INTERVAL_FRAMES

    def describe(self, index: int, is_closed: bool, poses: Callable[[], Array]) -> str:
        """Return the ATE of the trajectory so far, as text; empty without ground truth."""
        interval = _LOOP_ERROR_INTERVAL_FRAMES if is_closed else _ERROR_INTERVAL_FRAMES
        interval = max(interval, int(_ERROR_INTERVAL_SHARE * index))
        if self._truth is not None and index - self._measured_at >= interval:
            self._measured_at = index
            ate = absolute_trajectory_error(poses(), self._truth[: index + 1], self._alignment)
            self._text = f"ATE {ate:.2f} m"
        return self._text


@contextmanager
def run_progress(
    console: Console, num_frames: int, ground_truth: Array | None, alignment: Alignment
) -> Iterator[RunProgress]:
    """Yield what shows the progress of a run on a console; nothing is computed or drawn if it is no terminal.

    Args:
        console: the console.
        num_frames: number of all frames.
        ground_truth: true poses (N, 4, 4), metres, by which the error so far is shown; None where they are not known.
        alignment: alignment of that error.
    """
    if not console.is_terminal:
        yield HiddenProgress()
        return
    columns = (*_columns(_LoopBarColumn()), TextColumn("{task.fields[error]}"))
    with Progress(*columns, console=console) as progress:
        yield ProgressLine(progress, num_frames, LiveError(ground_truth, alignment))


class _LoopBarColumn(ProgressColumn):
    """A bar with a mark where a loop was closed."""

    def render(self, task: Task) -> "_LoopBar":
        """Show what is done, and its loops."""
        total = max(int(task.total or 0), 1)
        marked = {min(loop * _RUN_BAR_CELLS // total, _RUN_BAR_CELLS - 1) for loop in task.fields["loops"]}
        return _LoopBar(int(task.completed) * _RUN_BAR_CELLS // total, frozenset(marked))


@dataclass(frozen=True)
class _LoopBar:
    """A bar of `_RUN_BAR_CELLS` cells.

    Attributes:
        done: number of cells that are done.
        loops: cells in which a loop was closed.
    """

    done: int
    loops: frozenset[int]

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        """Return the width, which is fixed."""
        return Measurement(_RUN_BAR_CELLS, _RUN_BAR_CELLS)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw the cells, in ASCII where the console has nothing else."""
        line, mark = ("-", "o") if options.ascii_only else ("\N{BOX DRAWINGS HEAVY HORIZONTAL}", "\N{BLACK CIRCLE}")
        for k in range(_RUN_BAR_CELLS):
            style = _LOOP if k in self.loops else _DONE if k < self.done else _LEFT
            yield Segment(mark if k in self.loops else line, style)


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
