"""`revisit benchmark`: run a sweep described by a TOML file and compare the results of its runs."""

import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from rich.console import Console

from slam.benchmark.executors import Executor, Failed, make_executor
from slam.benchmark.job import Job, JobResult, check_job, read_result, run_job
from slam.benchmark.sweep_config import RecordedSource, SimulatedSource, Sweep, read_sweep
from slam.benchmark.sweep_results import (
    ResultRow,
    format_row,
    make_row,
    summary_table,
    write_benchmark_report,
    write_csv,
    write_json,
    write_latex,
)
from slam.datasets.dataset import DatasetSpec
from slam.errors import OutputError
from slam.external.matches_file import path_of, short_name
from slam.io.folder_lock import FolderLock
from slam.pipeline.progress import progress_bar
from slam.simulation import simulate

Work = Callable[[Job], JobResult]


@dataclass(frozen=True)
class BenchmarkOptions:
    """Options of `revisit benchmark`.

    Attributes:
        config: TOML file of the sweep.
        out: folder for the results; runs that an earlier command finished there are kept.
        workers: number of processes on this machine; 0 for this process alone, None for one per core.
        scheduler: address of a dask scheduler to use instead, or None.
    """

    config: Path
    out: Path
    workers: int | None = None
    scheduler: str | None = None

    def make_executor(self) -> Executor:
        """Make the executor that runs the jobs.

        Raises:
            ConfigError: the number of workers is negative, both options are given, or dask is not installed.
        """
        return make_executor(self.workers, self.scheduler, len(os.sched_getaffinity(0)))


def run_benchmark(options: BenchmarkOptions, messages: Console, results: Console) -> bool:
    """Run all jobs that are not finished, print a line for each, and write the results of all.

    Args:
        options: sweep, output folder and workers.
        messages: console for progress.
        results: console for the lines and the table.

    Returns:
        Whether every run has succeeded. A failed run is tried again by the next command.

    Raises:
        RevisitError: the sweep, its sources, the executor or the output folder cannot be used.
        KeyboardInterrupt: the user interrupted it; finished runs are kept, and the same command continues.
    """
    sweep, executor, out = read_sweep(options.config), options.make_executor(), options.out.resolve()
    jobs = make_jobs(sweep, out)
    # All jobs are checked before anything is written, so that a wrong sweep leaves the folder as it was.
    for job in jobs:
        check_job(job)
    _prepare(out)
    with FolderLock.acquire(out):
        _clear(out)
        for source in sweep.sources:
            _render(source, out, messages)
        try:
            with executor:
                rows = run_jobs(jobs, executor, run_job, out, results)
        except KeyboardInterrupt:
            messages.print("Interrupted: finished runs are kept; the same command continues.")
            raise
        _clear(out)  # also here: processes that died during this command leave folders
    write_json(out, rows, ("benchmark", str(options.config), "--out", str(options.out)))
    write_latex(out, rows)
    write_benchmark_report(out, options.config.stem, rows)
    results.print(summary_table(rows))
    results.print(f"Report: {options.out / 'report.html'}", highlight=False, markup=False)
    return not any(row.error for row in rows)


def make_jobs(sweep: Sweep, out: Path) -> list[Job]:
    """Make a job for every combination, in the order of the file; names are the same each time."""
    return [
        Job(
            source.name,
            source.source if isinstance(source, RecordedSource) else DatasetSpec(_rendered_folder(source, out)),
            out / "jobs" / _job_name(source.name, odometry, paradigm, preset, robust, str(seed)),
            sweep.config,
            _for_source(paradigm, source.name),
            robust,
            seed,
            sweep.record,
            preset,
            None if odometry is None else _for_source(odometry, source.name),
        )
        for source, odometry, paradigm, preset, robust, seed in product(
            sweep.sources, sweep.odometries, sweep.paradigms, sweep.presets, sweep.robust, sweep.seeds
        )
    ]


def _job_name(*parts: str | None) -> str:
    return ".".join(short_name(part) for part in parts if part)


def _for_source(name: str, source: str) -> str:
    """Return the name of an odometry or a paradigm, with that of the source in the path of its file."""
    return name.replace("{source}", source) if path_of(name) else name


def _rendered_folder(source: SimulatedSource, out: Path) -> Path:
    return out / "sources" / source.name


def _render(source: RecordedSource | SimulatedSource, out: Path, messages: Console) -> None:
    if isinstance(source, SimulatedSource):
        with progress_bar(messages, f"Rendering {source.name}") as progress:
            simulate(source.spec, _rendered_folder(source, out), progress)


def _prepare(out: Path) -> None:
    jobs = out / "jobs"
    try:
        jobs.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written, {error.strerror}; choose another folder with --out") from None


def _clear(out: Path) -> None:
    """Remove the unfinished folders of killed processes."""
    for left in (out / "jobs").glob(".*"):
        shutil.rmtree(left, ignore_errors=True)


def run_jobs(jobs: Sequence[Job], executor: Executor, work: Work, out: Path, results: Console) -> list[ResultRow]:
    """Run the jobs that are not finished and return a row for each job.

    results.csv is written anew after each job, so that it holds all results so far at any moment.
    """
    rows: dict[str, ResultRow] = {}
    for count, (job, result) in enumerate(_results(jobs, executor, work), start=1):
        rows[job.name] = make_row(job, result)
        write_csv(out, (rows[job.name] for job in jobs if job.name in rows))
        line = f"{count}/{len(jobs)}  {format_row(rows[job.name])}"
        results.print(line, highlight=False, markup=False, soft_wrap=True)
    return [rows[job.name] for job in jobs]


def _results(jobs: Sequence[Job], executor: Executor, work: Work) -> Iterator[tuple[Job, JobResult]]:
    """Yield first the results of finished jobs, then those of the others as they arrive."""
    finished = [(job, result) for job in jobs if (result := read_result(job))]
    yield from finished
    names = {job.name for job, _ in finished}
    for ended in executor.run(work, [job for job in jobs if job.name not in names]):
        if isinstance(ended, Failed):
            yield ended.item, JobResult(ended.item.name, {}, ended.reason)
        else:
            yield ended.item, ended.result
