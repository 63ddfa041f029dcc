"""A bar with rate and time left where somebody watches, and nothing at all in a pipe."""

import io
import time

import pytest
from rich.console import Console

from slam.pipeline.progress import progress_bar


def told(terminal: bool) -> str:
    out = io.StringIO()
    with progress_bar(Console(file=out, force_terminal=terminal, width=120), "Processing") as progress:
        for done in range(1, 6):
            progress(done, 5)
            time.sleep(0.05)
    return out.getvalue()


def test_a_pipe_gets_nothing():
    assert told(terminal=False) == ""


@pytest.mark.parametrize("word", ["Processing", "5/5", "frames/s", "left"])
def test_a_terminal_shows_how_far_how_fast_and_how_long(word: str):
    assert word in told(terminal=True)
