"""A bar with rate and time left where somebody watches, and nothing at all in a pipe; in a run also loops and error."""

import io
import re
import runpy
import time
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from slam.pipeline.progress import LiveError, announce_compilation, progress_bar, run_progress

NUM_FRAMES = 60


def bar_text(terminal: bool) -> str:
    out = io.StringIO()
    with progress_bar(Console(file=out, force_terminal=terminal, width=120), "Processing") as progress:
        for done in range(1, 6):
            progress(done, 5)
            time.sleep(0.05)
    return out.getvalue()


def test_no_bar_is_written_into_a_pipe():
    assert bar_text(terminal=False) == ""


@pytest.mark.parametrize("word", ["Processing", "5/5", "frames/s", "left"])
def test_a_terminal_shows_progress_rate_and_time_left(word: str):
    assert word in bar_text(terminal=True)


def line() -> np.ndarray:
    """Poses one metre apart on a straight line, the true ones."""
    poses = np.tile(np.eye(4), (NUM_FRAMES, 1, 1))
    poses[:, 2, 3] = np.arange(NUM_FRAMES)
    return poses


def bent(size: float) -> np.ndarray:
    """The same poses, in turn to the left and to the right of the line: their ATE is that distance."""
    poses = line()
    poses[:, 0, 3] = size * np.where(np.arange(NUM_FRAMES) // 2 % 2, 1.0, -1.0)
    return poses


def run_text(loops: tuple[int, ...], estimate: np.ndarray, truth: np.ndarray | None, terminal: bool = True) -> str:
    """The line as it was drawn last; empty if nothing was drawn."""
    out = io.StringIO()
    console = Console(file=out, force_terminal=terminal, color_system=None, width=80)
    with run_progress(console, NUM_FRAMES, truth, "se3") as progress:
        for index in range(NUM_FRAMES):
            progress.show(index, index in loops, lambda index=index: estimate[: index + 1])
    drawn = [text for text in re.split(r"[\r\n]|\x1b\[[^A-Za-z]*[A-Za-z]", out.getvalue()) if text.strip()]
    return drawn[-1] if drawn else ""


def test_a_run_marks_its_loops_where_they_were_closed():
    # 20 cells of three frames each
    bar = run_text((30, 59), bent(2.0), line()).split("Processing ")[-1][:20]
    assert [k for k, cell in enumerate(bar) if cell != bar[0]] == [10, 19]


def test_a_run_shows_its_error_so_far_and_only_with_ground_truth():
    assert "ATE 2.0" in run_text((), bent(2.0), line())
    assert "ATE" not in run_text((), bent(2.0), None)


def test_the_line_of_a_run_fits_a_terminal_of_80_columns():
    assert "ATE 2.00 m" in run_text((3,), bent(2.0), line())


def test_nobody_watches_a_pipe_so_that_no_pose_is_copied():
    assert run_text((3,), np.empty(0), line(), terminal=False) == ""


def test_the_error_is_that_of_the_trajectory_after_the_loop_that_was_just_closed():
    live = LiveError(line(), "se3")
    assert live.describe(50, False, lambda: bent(2.0)[:51]).startswith("ATE 2.0")
    assert live.describe(54, True, lambda: bent(0.5)[:55]).startswith("ATE 2.0")  # too soon
    assert live.describe(56, False, lambda: bent(0.5)[:57]).startswith("ATE 2.0")
    assert live.describe(57, True, lambda: bent(0.5)[:58]).startswith("ATE 0.5")


def test_compilation_is_announced_once_and_only_where_something_is_compiled(tmp_path: Path):
    source = tmp_path / "kernel.py"
    source.write_text("from numba import njit\n\n@njit(cache=True)\ndef double(value):\n    return 2 * value\n")
    said = []
    for _run in ("first", "with what the first has compiled"):
        double = runpy.run_path(str(source))["double"]
        for value in (1, 1.0, 2):
            out = io.StringIO()
            with announce_compilation(Console(file=out, width=120)):
                assert double(value) == 2 * value
                double(value + 1j)
            said.append(out.getvalue())
    assert said == ["Compiling kernels, once on this machine: up to a minute\n"] * 2 + [""] * 4
