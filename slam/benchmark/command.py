"""`revisit benchmark`: a TOML file in, a folder of runs and their figures side by side out."""

import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from rich.console import Console

from slam.benchmark.job import Job, Outcome, check_job, finished, run_job
from slam.benchmark.latex import write_latex
from slam.benchmark.report import write_report
from slam.benchmark.results import Row, make_row, summary, told, write_csv, write_json
from slam.benchmark.sweep import Recorded, Simulated, Sweep, read_sweep
from slam.datasets.source import DatasetSpec
from slam.engine.choice import choose_engine
from slam.engine.engine import Done, Engine, Lost
from slam.errors import OutputError
from slam.progress import progress_bar
from slam.simulation import simulate

Work = Callable[[Job], Outcome]


@dataclass(frozen=True)
class BenchmarkOptions:
    """What to run, where, and on what.

    Attributes:
        config: TOML file of the sweep.
        out: folder for the results; what an earlier command has finished there is kept.
        workers: processes on this machine; 0 for this one, None for as many as there are cores.
        scheduler: address of a dask scheduler to use instead.
    """

    config: Path
    out: Path
    workers: int | None = None
    scheduler: str | None = None

    @property
    def engine(self) -> Engine:
        """What does the jobs.

        Raises:
            ConfigError: there cannot be so many, or both are given, or dask is not installed.
        """
        return choose_engine(self.workers, self.scheduler, len(os.sched_getaffinity(0)))


def run_benchmark(options: BenchmarkOptions, messages: Console, results: Console) -> bool:
    """Run what is not finished yet, tell of each run as it ends, and write the figures of all.

    Args:
        options: what and where.
        messages: for progress.
        results: for the rows and the table.

    Returns:
        Whether every run has succeeded. One that has not is tried again by the next command.

    Raises:
        RevisitError: the sweep, its sources, the engine or the output folder cannot be used.
        KeyboardInterrupt: the user stopped it; what is finished stays, and the same command goes on.
    """
    sweep, engine, out = read_sweep(options.config), options.engine, options.out.resolve()
    jobs = make_jobs(sweep, out)
    for job in jobs:
        check_job(job)
    _prepare(out)
    for source in sweep.sources:
        _render(source, out, messages)
    try:
        with engine:
            rows = carry_out(jobs, engine, run_job, out, results)
    except KeyboardInterrupt:
        messages.print("Interrupted: what is finished stays; the same command goes on.")
        raise
    _clear(out)
    write_json(out, rows, ("benchmark", str(options.config), "--out", str(options.out)))
    write_latex(out, rows)
    write_report(out, options.config.stem, rows)
    results.print(summary(rows))
    results.print(f"Report: {options.out / 'report.html'}", highlight=False, markup=False)
    return not any(row.error for row in rows)


def make_jobs(sweep: Sweep, out: Path) -> list[Job]:
    """Every combination, in the order of the file; the same names each time."""
    return [
        Job(
            source.name,
            source.source if isinstance(source, Recorded) else DatasetSpec(_rendered(source, out)),
            out / "jobs" / f"{source.name}.{paradigm}.{robust}.{seed}",
            sweep.config,
            paradigm,
            robust,
            seed,
            sweep.record,
        )
        for source, paradigm, robust, seed in product(sweep.sources, sweep.paradigms, sweep.robust, sweep.seeds)
    ]


def _rendered(source: Simulated, out: Path) -> Path:
    return out / "sources" / source.name


def _render(source: Recorded | Simulated, out: Path, messages: Console) -> None:
    if isinstance(source, Simulated):
        with progress_bar(messages, f"Rendering {source.name}") as progress:
            simulate(source.spec, _rendered(source, out), progress)


def _prepare(out: Path) -> None:
    jobs = out / "jobs"
    try:
        jobs.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written, {error.strerror}; choose another folder with --out") from None
    _clear(out)


def _clear(out: Path) -> None:
    """Remove what killed processes have left unfinished."""
    for left in (out / "jobs").glob(".*"):
        shutil.rmtree(left, ignore_errors=True)


def carry_out(jobs: Sequence[Job], engine: Engine, work: Work, out: Path, results: Console) -> list[Row]:
    """Do what is not done; results.csv holds at each moment what is known. Returns a row for each job."""
    known: dict[str, Row] = {}
    for count, (job, outcome) in enumerate(_outcomes(jobs, engine, work), start=1):
        known[job.name] = make_row(job, outcome)
        write_csv(out, (known[job.name] for job in jobs if job.name in known))
        results.print(f"{count}/{len(jobs)}  {told(known[job.name])}", highlight=False, markup=False, soft_wrap=True)
    return [known[job.name] for job in jobs]


def _outcomes(jobs: Sequence[Job], engine: Engine, work: Work) -> Iterator[tuple[Job, Outcome]]:
    done = [(job, outcome) for job in jobs if (outcome := finished(job))]
    yield from done
    names = {job.name for job, _ in done}
    for ended in engine.run(work, [job for job in jobs if job.name not in names]):
        yield ended.item, _outcome(ended)


def _outcome(ended: Done[Job, Outcome] | Lost[Job]) -> Outcome:
    return Outcome(ended.item.name, {}, ended.reason) if isinstance(ended, Lost) else ended.result
