"""Time of each frame by stage, memory and file sizes over a run, and the time of each step after the last frame."""

import json
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from unittest.mock import patch

import numpy as np
from rich.console import Console
from rich.table import Table

from slam.io.frames_and_loops_csv import read_frames
from slam.pipeline.run_warnings import RunWarnings
from slam.report.style import INK, new_figure, save_png, style_axes
from slam.run_log import RunLog

TENTHS = 10
_INTERVAL_S = 2.0  # between two samples of memory and files
_BEFORE, _AFTER = 1, 9  # the tenths that are compared: the first one still learns the place
_TOTAL, _CPU = "total", "processor time"
_SPILLED = "temporary files"
_SHOWN_FILES = ("map.db", "recording.rrd", _SPILLED)


@dataclass(frozen=True)
class Sample:
    """What a run holds at a moment.

    Attributes:
        frames: frames processed so far.
        memory_mb: resident memory.
        files_mb: size of each file of the run's folder, and of its temporary files without a name.
    """

    frames: int
    memory_mb: float
    files_mb: dict[str, float]


@dataclass
class Measurement:
    """What a run cost.

    Attributes:
        stage_ms: milliseconds of each frame by stage (N,), their sum, and the processor time of the whole process.
        samples: memory and files during the drive, then after it.
        steps_s: seconds of each step after the last frame, by name.
        after_s, after_cpu_s: all of them, and what lies between; and their processor time.
        files_mb: size of each result.
        metrics: those of metrics.json.
    """

    stage_ms: dict[str, np.ndarray] = field(default_factory=dict)
    samples: list[Sample] = field(default_factory=list)
    steps_s: dict[str, float] = field(default_factory=dict)
    after_s: float = 0.0
    after_cpu_s: float = 0.0
    files_mb: dict[str, float] = field(default_factory=dict)
    metrics: dict = field(default_factory=dict)

    def tenths(self, stage: str) -> list[tuple[float, float]]:
        """Median and 99th percentile of each tenth of the drive, milliseconds."""
        parts = np.array_split(self.stage_ms[stage], TENTHS)
        return [(float(np.median(part)), float(np.percentile(part, 99))) for part in parts]

    def ratios(self, stage: str) -> tuple[float, float]:
        """Median and 99th percentile of the last tenth, as multiples of those of the second."""
        tenths = np.array(self.tenths(stage))
        median, p99 = tenths[_AFTER] / np.maximum(tenths[_BEFORE], 1e-3)
        return float(median), float(p99)

    def at_tenth(self, tenth: int) -> Sample | None:
        """The last sample before the end of a tenth."""
        end = (tenth + 1) * len(self.stage_ms[_TOTAL]) / TENTHS
        return next((sample for sample in reversed(self.samples) if sample.frames <= end), None)

    def as_json(self) -> dict[str, object]:
        """All but the single frames."""
        names = ("frames", "path_length_m", "odometry", "corrected", "loops", "peak_memory_mb", "memory_mb", "graph")
        return {
            "tenths_ms": {stage: self.tenths(stage) for stage in self.stage_ms},
            "ratios": {stage: self.ratios(stage) for stage in self.stage_ms},
            "samples": [vars(sample) for sample in self.samples],
            "steps_s": self.steps_s,
            "after_s": self.after_s,
            "after_cpu_s": self.after_cpu_s,
            "files_mb": self.files_mb,
            "metrics": {name: self.metrics.get(name) for name in names},
        }


class _Recorder:
    """Counts the frames of a run, and times what follows them."""

    def __init__(self, out: Path) -> None:
        self.cpu_s: list[float] = []
        self.samples: list[Sample] = []
        self.steps_s: dict[str, float] = {}
        self.last_frame_at = self.last_frame_cpu = 0.0
        self._out, self._done = out, threading.Event()

    @contextmanager
    def watch(self) -> Iterator[None]:
        """Measure while the block runs."""
        add, attempt = RunLog.add, RunWarnings.attempt

        def count(log: RunLog, *given: object) -> None:
            add(log, *given)
            self.last_frame_at, self.last_frame_cpu = time.perf_counter(), time.process_time()
            self.cpu_s.append(self.last_frame_cpu)

        def time_step(warnings: RunWarnings, what: str, *given: object) -> object:
            begin = time.perf_counter()
            try:
                return attempt(warnings, what, *given)
            finally:
                self.steps_s[what] = self.steps_s.get(what, 0.0) + time.perf_counter() - begin

        sampler = threading.Thread(target=self._sample_all, daemon=True)
        with patch.object(RunLog, "add", count), patch.object(RunWarnings, "attempt", time_step):
            sampler.start()
            try:
                yield
            finally:
                self._done.set()
                sampler.join()

    def _sample_all(self) -> None:
        while not self._done.wait(_INTERVAL_S):
            self.samples.append(Sample(len(self.cpu_s), _resident_mb(), _file_sizes_mb(self._out) | _spilled_mb()))


def measure(run: Callable[[Console], object], out: Path) -> Measurement:
    """Run and measure; `out` is the folder of the run."""
    recorder = _Recorder(out)
    with recorder.watch():
        run(Console(stderr=True))
        after_s, after_cpu_s = (
            time.perf_counter() - recorder.last_frame_at,
            time.process_time() - recorder.last_frame_cpu,
        )
    table = read_frames(out / "frames.csv")
    stages = {name: np.nan_to_num(spent) for name, spent in table.stage_ms.items()}
    total = np.sum(list(stages.values()), axis=0)
    cpu = 1000.0 * np.diff(recorder.cpu_s, prepend=recorder.cpu_s[0])
    return Measurement(
        stage_ms={_TOTAL: total, _CPU: cpu, **stages},
        samples=recorder.samples,
        steps_s=recorder.steps_s,
        after_s=after_s,
        after_cpu_s=after_cpu_s,
        files_mb=_file_sizes_mb(out),
        metrics=json.loads((out / "metrics.json").read_text()),
    )


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _file_sizes_mb(folder: Path) -> dict[str, float]:
    """Size of each file of a run's folder, also of one that is not complete; megabytes."""
    sizes: dict[str, float] = {}
    for parent in (folder, *folder.glob(".unfinished-*")):
        for file in parent.glob("*"):
            try:
                sizes[file.name] = file.stat().st_size / 1e6
            except OSError:  # it was moved at this moment
                continue
    return {name: size for name, size in sizes.items() if not name.startswith(".")}


def _spilled_mb() -> dict[str, float]:
    """Size of the files of this process that have no name; megabytes."""
    total = 0.0
    for file in Path("/proc/self/fd").iterdir():
        try:
            if "(deleted)" in str(file.readlink()):
                total += file.stat().st_size / 1e6
        except OSError:  # closed meanwhile
            continue
    return {_SPILLED: total}


def print_measurement(console: Console, title: str, found: Measurement) -> None:
    """Print the tables of a run."""
    table = Table("tenth", *found.stage_ms, "memory MB", *_SHOWN_FILES, title=f"{title}: median / p99 ms, then MB")
    for tenth in range(TENTHS):
        times = [found.tenths(stage)[tenth] for stage in found.stage_ms]
        sample = found.at_tenth(tenth)
        held = [] if sample is None else [sample.memory_mb, *(sample.files_mb.get(name, 0.0) for name in _SHOWN_FILES)]
        table.add_row(
            str(tenth + 1), *(f"{median:.1f} / {p99:.0f}" for median, p99 in times), *(f"{size:.0f}" for size in held)
        )
    table.add_section()
    ratios = [found.ratios(stage) for stage in found.stage_ms]
    table.add_row("last : 2nd", *(f"{median:.2f} / {p99:.2f}" for median, p99 in ratios))
    console.print(table)
    steps = sorted(found.steps_s.items(), key=lambda item: -item[1])
    console.print(f"after the last frame: {found.after_s:.1f} s, processor time {found.after_cpu_s:.1f} s")
    console.print("  " + ", ".join(f"{name} {seconds:.1f} s" for name, seconds in steps if seconds >= 0.05))
    console.print("files: " + ", ".join(f"{name} {size:.1f}" for name, size in _by_size(found.files_mb)) + " MB")
    metrics = found.metrics
    ate = [f"{metrics[name]['ate_m']} m {name}" for name in ("odometry", "online", "corrected")]
    console.print(f"frames {metrics['frames']}, peak memory {metrics['peak_memory_mb']:.0f} MB, ATE {', '.join(ate)}")
    console.print(f"memory by component: {metrics['memory_mb']}")
    console.print(f"loops: {metrics['loops']}\n", soft_wrap=True)


def _by_size(files_mb: dict[str, float]) -> list[tuple[str, float]]:
    return sorted(((name, size) for name, size in files_mb.items() if size >= 0.1), key=lambda item: -item[1])


def draw(found: Measurement, title: str, path: Path) -> None:
    """Draw time by stage, memory and files over the drive."""
    figure = new_figure(13.0, 7.5)
    (medians, tails), (memory, files) = figure.subplots(2, 2)
    frames = len(found.stage_ms[_TOTAL])
    middles = (np.arange(TENTHS) + 0.5) * frames / TENTHS
    for stage in found.stage_ms:
        times = np.array(found.tenths(stage))
        for ax, column in ((medians, 0), (tails, 1)):
            ax.plot(middles, times[:, column], lw=1.5, marker=".", label=stage)
    during = [sample for sample in found.samples if sample.frames]
    x = [sample.frames for sample in during]
    memory.plot(x, [sample.memory_mb for sample in during], lw=1.5)
    for name in _SHOWN_FILES:
        files.plot(x, [sample.files_mb.get(name, np.nan) for sample in during], lw=1.5, label=name)
    for ax, label in (
        (medians, "median of a tenth [ms]"),
        (tails, "99th percentile of a tenth [ms]"),
        (memory, "resident memory [MB]"),
        (files, "size [MB]"),
    ):
        style_axes(ax)
        ax.set(xlabel="frame", ylabel=label, xlim=(0, frames))
        ax.set_ylim(bottom=0)
    medians.legend(frameon=False, fontsize=8)
    files.legend(frameon=False, fontsize=8)
    figure.suptitle(title, color=INK)
    save_png(figure, path)
