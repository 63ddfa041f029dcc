"""Timing of a run, stage by stage."""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Item = TypeVar("Item")


class StageTimer:
    """Adds up the time of named stages within one frame."""

    def __init__(self) -> None:
        self._milliseconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time of the enclosed block towards a stage; a stage may be entered several times a frame."""
        start = time.perf_counter()
        try:
            yield
        finally:
            spent = 1000.0 * (time.perf_counter() - start)
            self._milliseconds[name] = self._milliseconds.get(name, 0.0) + spent

    def lap(self) -> dict[str, float]:
        """Milliseconds of each stage since the last lap; starts the next one."""
        spent, self._milliseconds = self._milliseconds, {}
        return spent


def timed(items: Iterator[Item], timer: StageTimer) -> Iterator[Item]:
    """Pass items on, counting the wait for each as the stage `read`."""
    while True:
        with timer.stage("read"):
            item = next(items, None)
        if item is None:
            return
        yield item


def timing_ms(stage_ms: Mapping[str, NDArray[np.float64]]) -> dict[str, dict[str, float]]:
    """Median and 99th percentile of each stage and of their total, as they stand in metrics.json.

    Args:
        stage_ms: stage to milliseconds in each frame (N,); N > 0.
    """
    total = np.sum(list(stage_ms.values()), axis=0)
    return {
        stage: {"median": float(np.median(spent)), "p99": float(np.percentile(spent, 99))}
        for stage, spent in {"total": total, **stage_ms}.items()
    }
