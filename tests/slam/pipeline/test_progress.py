"""A bar with rate and time left where somebody watches, and nothing at all in a pipe."""

import io
import time

import pytest
from rich.console import Console

from slam.pipeline.progress import progress_bar


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
