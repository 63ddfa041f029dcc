"""One run of a benchmark, in a folder of its own that is complete or absent."""

import shlex
import shutil
import traceback
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

from rich.console import Console

from slam.config import RunConfig, read_config
from slam.datasets.dataset import DatasetSpec
from slam.errors import OutputError, RevisitError, UnmeasuredError
from slam.external.matches_file import path_of
from slam.io.files import atomic_writer
from slam.io.metrics import read_metrics
from slam.pipeline.pipeline import RunOptions, resolve_config, run_pipeline

_QUIET = Console(quiet=True)


@dataclass(frozen=True)
class Job:
    """One run of a benchmark.

    Attributes:
        source_name: name of the source in the benchmark.
        source: recording to read.
        folder: folder for the results, absolute.
        settings_file: TOML file with the settings of all runs; None for the defaults.
        paradigm, robust, seed, record: settings as in `RunConfig`; a map is saved if a recording is.
        preset: preset of the paradigm; None for that of the settings.
        odometry: "stereo", "mono" or "file:PATH"; None for that of the settings.
    """

    source_name: str
    source: DatasetSpec
    folder: Path
    settings_file: Path | None
    paradigm: str
    robust: str
    seed: int
    record: bool
    preset: str | None = None
    odometry: str | None = None

    @property
    def name(self) -> str:
        """Name of the run, which is that of its folder."""
        return self.folder.name

    def run_options(self, out: Path) -> RunOptions:
        """Options of `revisit run` for this job, with another output folder."""
        source = self.source
        return RunOptions(
            source=source.path,
            sequence=source.sequence,
            out=out,
            config=self.settings_file,
            format=source.format,
            command=self.command,
        )

    @property
    def settings(self) -> dict[str, object]:
        """Settings that the benchmark changes, by their names in `RunConfig`."""
        preset = {} if self.preset is None else {"preset": self.preset}
        return (
            preset
            | self._odometry_settings
            | {
                "paradigm": self.paradigm,
                "robust": self.robust,
                "seed": self.seed,
                "save_recording": self.record,
                "save_map": self.record,
            }
        )

    @property
    def _odometry_settings(self) -> dict[str, object]:
        if self.odometry is None:
            return {}
        file = path_of(self.odometry)
        return {"mono": self.odometry == "mono", "odometry_file": "" if file is None else str(file)}

    @property
    def config(self) -> RunConfig:
        """Complete configuration of the run.

        Raises:
            ConfigError: the settings file, a paradigm, a preset or a back end cannot be used.
        """
        return resolve_config(self.run_options(self.folder), self.settings)

    @property
    def command(self) -> tuple[str, ...]:
        """Words after `revisit` of the command that repeats this run alone."""
        named = {
            "--sequence": self.source.sequence,
            "--format": self.source.format,
            "--odometry": path_of(self.odometry or ""),
            "--paradigm": self.paradigm,
            "--preset": self.preset,
            "--robust": self.robust,
            "--seed": self.seed,
            "--config": self.settings_file,
            "--out": self.folder,
        }
        words = [str(word) for option in named.items() if option[1] is not None for word in option]
        flags = ["--mono"] if self.odometry == "mono" else []
        flags += [] if self.record else ["--no-record", "--no-map"]
        return ("run", str(self.source.path), *words, *flags)

    @property
    def error_file(self) -> Path:
        """File beside the folder that keeps the traceback of a bug."""
        return self.folder.with_name(f"{self.name}.error.txt")


@dataclass(frozen=True)
class JobResult:
    """Result of a job: metrics, or the reason why there are none.

    Attributes:
        name: name of the job.
        metrics: content of metrics.json; empty if the run failed.
        error: reason of the failure, one line; empty if there was none.
    """

    name: str
    metrics: Mapping[str, object]
    error: str = ""


def read_result(job: Job) -> JobResult | None:
    """Read the result of a finished job from its folder; None if the job is not finished."""
    if not (job.folder / "metrics.json").is_file():
        return None
    return JobResult(job.name, read_metrics(job.folder / "metrics.json"))


def check_job(job: Job) -> None:
    """Check the settings of a job and, if it is finished, that it was run with the same settings and source.

    Raises:
        ConfigError: the settings file, a paradigm or a back end cannot be used.
        OutputError: the finished run had other settings or another source.
    """
    config, done = job.config, read_result(job)
    if done is None:
        return
    same_source = _source(done) == job.source
    if not same_source or read_config(job.folder / "config.toml") != config:
        found = "one with other settings" if same_source else f"one of {done.metrics.get('recording')}"
        raise OutputError(
            f"{job.folder}: expected what {shlex.join(['revisit', *job.command])} gives, found {found};"
            " remove it or choose another folder with --out"
        )


def _source(done: JobResult) -> DatasetSpec | None:
    """Source of a finished run; None if its metrics do not name it."""
    recording = done.metrics.get("recording")
    try:
        return DatasetSpec.from_metrics(recording) if isinstance(recording, Mapping) else None
    except (KeyError, TypeError):
        return None


def run_job(job: Job) -> JobResult:
    """Run a job unless it is finished. A failure is part of the result and leaves no files in the folder.

    Raises:
        KeyboardInterrupt: the user interrupted the run.
    """
    try:
        return read_result(job) or _run(job)
    except RevisitError as error:
        return JobResult(job.name, {}, " ".join(str(error).split()))
    except Exception as error:  # a bug in one run must not stop the others; its traceback is kept
        with atomic_writer(job.error_file) as file:
            file.write(traceback.format_exc())
        message = " ".join(f"{type(error).__name__}: {error}".split())
        return JobResult(job.name, {}, f"{message} (a bug; see {job.error_file})")


def _run(job: Job) -> JobResult:
    # Written beside its place and then renamed: a process that dies meanwhile leaves nothing that looks finished.
    unfinished = job.folder.with_name(f".{job.name}-{uuid4().hex[:8]}")
    try:
        with suppress(UnmeasuredError):  # a result as well: its row shows the errors
            if run_pipeline(job.run_options(unfinished), job.settings, _QUIET, _QUIET):
                raise KeyboardInterrupt
        _rename(unfinished, job.folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
    job.error_file.unlink(missing_ok=True)
    return JobResult(job.name, read_metrics(job.folder / "metrics.json"))


def _rename(unfinished: Path, folder: Path) -> None:
    try:
        unfinished.rename(folder)
    except OSError as error:
        if (folder / "metrics.json").is_file():  # finished meanwhile by another worker that was taken for dead
            return
        raise OutputError(f"{folder}: cannot be written, {error.strerror}; remove it or choose another --out") from None
