"""Time and results of a sweep with one process, with three, and with three of which one is killed.

python benchmarks/cluster.py sweep.toml

The ideal is the processor time of the single process divided by the number of cores. Use a machine without other work,
and enough runs that the start of three processes, and the work lost with one of them, are a small part:

    revisit simulate circle --difficulty standard --laps 2 --length 160 --width 620 --height 188 --seed 3 \
        --out data/small

and in sweep.toml

    paradigms = ["sequence-histograms", "dynamic-sequences", "hierarchical-places", "tracked-words"]
    seeds = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9]
    [[sources]]
    path = "data/small"
"""

import argparse
import os
import resource
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil
from command_line import existing, run_script
from rich.console import Console
from rich.table import Table
from run_results import differing, lasting_results

from slam.benchmark.executors import DaskExecutor, Executor, SerialExecutor
from slam.benchmark.job import run_job
from slam.benchmark.sweep import make_jobs, run_jobs
from slam.benchmark.sweep_config import read_sweep

WORKERS = 3


@dataclass(frozen=True)
class Measured:
    """Times and results of one sweep.

    Attributes:
        wall, processor: wall-clock time and processor time of all processes, seconds.
        results: results by run and file, without times and memory.
    """

    wall: float
    processor: float
    results: dict[str, object]


def measure(config: Path, out: Path, executor: Executor) -> Measured:
    """Run a sweep; its times include the start and the end of the processes.

    Raises:
        SystemExit: a run failed.
    """
    jobs = make_jobs(read_sweep(config), out)
    (out / "jobs").mkdir(parents=True)
    wall, processor = time.perf_counter(), processor_seconds()
    with executor:
        rows = run_jobs(jobs, executor, run_job, out, Console(quiet=True))
    wall, processor = time.perf_counter() - wall, processor_seconds() - processor
    if failed := [row.error for row in rows if row.error]:
        raise SystemExit(f"{len(failed)} runs failed, the first: {failed[0]}")
    left = {job.name: lasting_results(job.folder) for job in jobs}
    return Measured(wall, processor, {f"{run}/{name}": of[name] for run, of in left.items() for name in of})


def processor_seconds() -> float:
    """Processor time of this process and of its children that have ended, seconds."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


@contextmanager
def one_killed(seconds: float) -> Iterator[None]:
    """Kill the busiest child process after some seconds."""
    timer = threading.Timer(seconds, kill_busiest)
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def kill_busiest() -> None:
    """Kill the child process with the most processor time, which is one of the workers."""
    workers = psutil.Process().children(recursive=True)
    busiest = max(workers, key=lambda process: sum(process.cpu_times()[:2]))
    os.kill(busiest.pid, signal.SIGKILL)


def main() -> None:
    """Run the sweep three times, compare the results, and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("config", type=existing)
    config, cores = parser.parse_args().config, len(os.sched_getaffinity(0))
    table = Table("", "wall s", "processor s", f"ideal on {cores} cores", "ratio", "results that differ")
    with tempfile.TemporaryDirectory() as folder:
        alone = measure(config, Path(folder) / "alone", SerialExecutor())
        ideal = alone.processor / cores
        table.add_row("one process", f"{alone.wall:.1f}", f"{alone.processor:.1f}", "", "", "")

        def tell(name: str, found: Measured) -> None:
            unequal = ", ".join(differing(alone.results, found.results)[:3]) or "none"
            table.add_row(
                name,
                f"{found.wall:.1f}",
                f"{found.processor:.1f}",
                f"{ideal:.1f}",
                f"{found.wall / ideal:.3f}",
                unequal,
            )

        whole = measure(config, Path(folder) / "whole", DaskExecutor(WORKERS, None))
        tell(f"{WORKERS} workers", whole)
        with one_killed(whole.wall / 2):
            killed = measure(config, Path(folder) / "killed", DaskExecutor(WORKERS, None))
        tell(f"one killed after {whole.wall / 2:.0f} s", killed)
    Console(width=120).print(table)


if __name__ == "__main__":
    run_script(main)
