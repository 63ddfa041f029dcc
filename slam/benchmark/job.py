"""One run of a benchmark, in a folder of its own that is whole or absent."""

import shlex
import shutil
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

from rich.console import Console

from slam.config import RunConfig, read_config
from slam.datasets.source import DatasetSpec
from slam.errors import OutputError, RevisitError
from slam.run import RunOptions, configure, run_recorded
from slam.storage.atomic import atomic_writer
from slam.storage.metrics import read_metrics

_QUIET = Console(quiet=True)


@dataclass(frozen=True)
class Job:
    """One run.

    Attributes:
        source_name: of the source in the benchmark.
        source: what to read.
        folder: where the results go, absolute.
        settings_file: of all runs; None for the defaults.
        paradigm, robust, seed, record: settings, as in `RunConfig`; a map is kept where a recording is.
    """

    source_name: str
    source: DatasetSpec
    folder: Path
    settings_file: Path | None
    paradigm: str
    robust: str
    seed: int
    record: bool

    @property
    def name(self) -> str:
        """Of the run: its folder's."""
        return self.folder.name

    def options(self, out: Path) -> RunOptions:
        """What `revisit run` is told to read, and where to write."""
        source = self.source
        return RunOptions(
            source.path, source.sequence, out, config=self.settings_file, kind=source.format, command=self.command
        )

    @property
    def settings(self) -> dict[str, object]:
        """What the benchmark sets, by the names in `RunConfig`."""
        return {
            "paradigm": self.paradigm,
            "robust": self.robust,
            "seed": self.seed,
            "record": self.record,
            "keep_map": self.record,
        }

    @property
    def config(self) -> RunConfig:
        """Everything that decides the result.

        Raises:
            ConfigError: the settings file, a paradigm or a back end cannot be used.
        """
        return configure(self.options(self.folder), self.settings)

    @property
    def command(self) -> tuple[str, ...]:
        """The words after `revisit` that make this run alone."""
        named = {
            "--sequence": self.source.sequence,
            "--kind": self.source.format,
            "--paradigm": self.paradigm,
            "--robust": self.robust,
            "--seed": self.seed,
            "--config": self.settings_file,
            "--out": self.folder,
        }
        words = [str(word) for pair in named.items() if pair[1] is not None for word in pair]
        return ("run", str(self.source.path), *words, *([] if self.record else ["--no-record", "--no-map"]))

    @property
    def trace(self) -> Path:
        """Beside the folder: how a run broke that should not have."""
        return self.folder.with_name(f"{self.name}.error.txt")


@dataclass(frozen=True)
class Outcome:
    """What became of a job.

    Attributes:
        name: of the job.
        metrics: of the run; empty where it failed.
        error: why it failed, one line; empty where it did not.
    """

    name: str
    metrics: Mapping[str, object]
    error: str = ""


def finished(job: Job) -> Outcome | None:
    """What an earlier command has left of a job; None where it is still to do."""
    if not (job.folder / "metrics.json").is_file():
        return None
    return Outcome(job.name, read_metrics(job.folder / "metrics.json"))


def check_job(job: Job) -> None:
    """Check that a job has settings that work, and, where it is finished, that these and its source were the same.

    Raises:
        ConfigError: the settings file, a paradigm or a back end cannot be used.
        OutputError: the finished run is another one.
    """
    config, done = job.config, finished(job)
    if done is None:
        return
    same_source = _source(done) == job.source
    if not same_source or read_config(job.folder / "config.toml") != config:
        found = "one with other settings" if same_source else f"one of {done.metrics.get('recording')}"
        raise OutputError(
            f"{job.folder}: expected what {shlex.join(['revisit', *job.command])} gives, found {found};"
            " remove it or choose another folder with --out"
        )


def _source(done: Outcome) -> DatasetSpec | None:
    """What a finished run has read; None where it does not say so."""
    recording = done.metrics.get("recording")
    try:
        return DatasetSpec.from_metrics(recording) if isinstance(recording, Mapping) else None
    except (KeyError, TypeError):
        return None


def run_job(job: Job) -> Outcome:
    """Run a job, unless it is finished. What goes wrong is told, and none of it remains in the folder.

    Raises:
        KeyboardInterrupt: the user stopped it.
    """
    try:
        return finished(job) or _run(job)
    except RevisitError as error:
        return Outcome(job.name, {}, " ".join(str(error).split()))
    except Exception as error:  # a bug in one run must not cost the others; its traceback is kept
        with atomic_writer(job.trace) as file:
            file.write(traceback.format_exc())
        told = " ".join(f"{type(error).__name__}: {error}".split())
        return Outcome(job.name, {}, f"{told} (a bug; see {job.trace})")


def _run(job: Job) -> Outcome:
    # Beside its place and renamed: a process that dies while it writes leaves nothing that looks finished.
    unfinished = job.folder.with_name(f".{job.name}-{uuid4().hex[:8]}")
    try:
        if run_recorded(job.options(unfinished), job.settings, _QUIET, _QUIET):
            raise KeyboardInterrupt
        _rename(unfinished, job.folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    job.trace.unlink(missing_ok=True)
    return Outcome(job.name, read_metrics(job.folder / "metrics.json"))


def _rename(unfinished: Path, folder: Path) -> None:
    try:
        unfinished.rename(folder)
    except OSError as error:
        if (folder / "metrics.json").is_file():  # another worker was given up for dead, and was not
            return
        raise OutputError(f"{folder}: cannot be written, {error.strerror}; remove it or choose another --out") from None
