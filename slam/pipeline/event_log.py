"""The event log of a run, `run.log`: what is out of the ordinary about frames, and what became of each loop."""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from slam.system import FrameResult, LoopCandidate

log = logging.getLogger("revisit")


def log_frame(result: FrameResult) -> None:
    """Log what is out of the ordinary about a frame."""
    if result.motion.predicted:
        log.warning("frame %d: motion predicted, %s", result.frame.index, result.motion.reason)
    log_loops(result.candidates)


def log_loops(candidates: Sequence[LoopCandidate]) -> None:
    """Log what became of each loop that was proposed."""
    for candidate in candidates:
        if candidate.reason:
            outcome = "closed" if candidate.closed else "not closed"
            log.info("loop %d -> %s %s: %s", candidate.belief.query, candidate.belief.match, outcome, candidate.reason)


@contextmanager
def log_to_file(path: Path) -> Iterator[None]:
    """Send the log to a file while the block runs."""
    handler = _LogFile(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.removeHandler(handler)
        with suppress(OSError):
            handler.close()


class _LogFile(logging.FileHandler):
    """A log that a full disk cuts short, and nothing else: the results, which need room too, will say so."""

    def handleError(self, record: logging.LogRecord) -> None:
        """Go on."""
