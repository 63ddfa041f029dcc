"""Many runs, by one process and by several: the same results, whatever dies meanwhile."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from slam.benchmark.executors import Executor, SerialExecutor
from slam.benchmark.job import Job, check_job, run_job
from slam.benchmark.sweep import BenchmarkOptions, make_jobs, run_benchmark, run_jobs
from slam.benchmark.sweep_config import read_sweep
from slam.cli import app
from slam.config import RunConfig
from slam.datasets.dataset import DatasetSpec
from slam.errors import OutputError

QUIET = Console(quiet=True)
SWEEP = """
paradigms = ["pixel-sequences", "global-descriptor"]

[[sources]]
name = "street"
simulate = "circle"
length_m = 150
width = 310
height = 94
max_frames = 8
"""
# What differs from one run of the same to the next: times, memory, and the pictures of them.
TIMED = {"frames.csv", "metrics.json", "report.html", "run.log"}
TIMES = {"timing_ms", "frames_per_second", "wall_seconds", "peak_memory_mb", "command"}


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sweep") / "sweep.toml"
    path.write_text(SWEEP)
    return path


@pytest.fixture(scope="module")
def alone(sweep: Path) -> Path:
    """The benchmark by one process."""
    out = sweep.parent / "alone"
    assert run_benchmark(BenchmarkOptions(sweep, out, workers=0), QUIET, QUIET)
    return out


def some_jobs(folder: Path, count: int) -> list[Job]:
    return [Job("s", DatasetSpec(folder), folder / f"job{n}", None, "p", "gnc", n, False) for n in range(count)]


def test_several_processes_give_the_bits_of_one(sweep: Path, alone: Path, cluster: Executor):
    out = sweep.parent / "several"
    jobs = make_jobs(read_sweep(sweep), out)
    (out / "sources").mkdir(parents=True)
    (out / "jobs").mkdir()
    (out / "sources" / "street").symlink_to(alone / "sources" / "street")
    rows = run_jobs(jobs, cluster, run_job, out, QUIET)
    assert [row.error for row in rows] == ["", ""]
    for job in jobs:
        other = alone / "jobs" / job.name
        names = {path.name for path in job.folder.iterdir()}
        assert names == {path.name for path in other.iterdir()}
        assert all((job.folder / name).read_bytes() == (other / name).read_bytes() for name in names - TIMED)
        assert figures(job.folder) == figures(other)


def figures(folder: Path) -> dict:
    metrics = json.loads((folder / "metrics.json").read_text())
    metrics["source"] = metrics["recording"]["path"] = Path(metrics["source"]).name
    metrics["graph"].pop("seconds")
    return {key: value for key, value in metrics.items() if key not in TIMES}


def test_a_benchmark_leaves_its_figures_and_each_run_whole(alone: Path):
    assert {path.name for path in alone.iterdir()} == {
        "jobs", "sources", "results.csv", "results.json", "tables.tex", "report.html"
    }  # fmt: skip
    runs = json.loads((alone / "results.json").read_text())["runs"]
    assert [run["run"] for run in runs] == ["street.pixel-sequences.pcm+gnc.0", "street.global-descriptor.pcm+gnc.0"]
    assert sorted(path.name for path in (alone / "jobs").iterdir()) == sorted(run["run"] for run in runs)
    for run in runs:
        metrics = json.loads((alone / "jobs" / run["run"] / "metrics.json").read_text())
        assert (run["frames"], run["ate_m"]) == (8, metrics["corrected"]["ate_m"])
        assert metrics["command"].startswith("revisit run ")


def test_what_is_finished_is_not_done_again(sweep: Path, alone: Path):
    done = {path: path.stat().st_mtime_ns for path in (alone / "jobs").rglob("*")}
    left = alone / "jobs" / ".street.killed"
    left.mkdir()
    more = sweep.with_name("more.toml")
    more.write_text(SWEEP.replace('"pixel-sequences", ', '"pixel-sequences", "no-such", '))
    with pytest.raises(Exception, match="no-such"):
        run_benchmark(BenchmarkOptions(more, alone, workers=0), QUIET, QUIET)
    assert left.exists()  # refused before anything was touched
    assert run_benchmark(BenchmarkOptions(sweep, alone, workers=0), QUIET, QUIET)
    assert {path: path.stat().st_mtime_ns for path in (alone / "jobs").rglob("*")} == done


def test_finished_runs_of_other_settings_are_refused(sweep: Path, alone: Path):
    (sweep.parent / "own.toml").write_text("[landmarks]\n" + f"{landmark_setting()} = 77\n")
    other = sweep.with_name("other.toml")
    other.write_text('config = "own.toml"\n' + SWEEP)
    with pytest.raises(OutputError, match="found one with other settings"):
        run_benchmark(BenchmarkOptions(other, alone, workers=0), QUIET, QUIET)


def test_finished_runs_of_another_source_are_refused(alone: Path, sweep: Path, tmp_path: Path):
    job = make_jobs(read_sweep(sweep), alone)[0]
    check_job(job)
    changes = ({"path": tmp_path / "other"}, {"sequence": "01"}, {"format": "kitti"})
    for other in (replace(job.source, **change) for change in changes):
        with pytest.raises(OutputError, match=r"found one of .*street"):
            check_job(replace(job, source=other))


def landmark_setting() -> str:
    return next(name for name, value in vars(RunConfig().landmarks).items() if isinstance(value, int | float))


def test_a_run_that_fails_costs_no_other_and_is_tried_again(alone: Path, sweep: Path, tmp_path: Path):
    good = make_jobs(read_sweep(sweep), alone)[0]
    bad = Job("gone", DatasetSpec(tmp_path / "gone"), tmp_path / "bad", None, good.paradigm, good.robust, 0, False)
    rows = run_jobs([bad, good], SerialExecutor(), run_job, tmp_path, QUIET)
    assert str(tmp_path / "gone") in rows[0].error
    assert rows[1].error == ""
    assert len((tmp_path / "results.csv").read_text().splitlines()) == 3
    assert not bad.folder.exists()
    assert not list(tmp_path.glob(".*"))


def test_a_bug_in_a_run_keeps_its_traceback(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def breaks(*_: object) -> bool:
        raise ZeroDivisionError("no wheels")

    monkeypatch.setattr("slam.benchmark.job.run_pipeline", breaks)
    (job,) = some_jobs(tmp_path, 1)
    assert "ZeroDivisionError: no wheels" in run_job(job).error
    assert "in breaks" in job.error_file.read_text()


def test_a_run_that_is_stopped_leaves_nothing_and_stops_the_benchmark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("slam.benchmark.job.run_pipeline", lambda *_: True)
    with pytest.raises(KeyboardInterrupt):
        run_job(some_jobs(tmp_path, 1)[0])
    assert list(tmp_path.iterdir()) == []


def test_without_dask_the_message_has_the_command_that_installs_it(
    sweep: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    monkeypatch.setitem(sys.modules, "distributed", None)
    arguments = ["benchmark", str(sweep), "--out", str(sweep.parent / "none"), "--workers", "2"]
    assert app._exit_code(lambda: app.app(arguments)) == app.EXIT_USAGE
    message = capsys.readouterr().err
    assert "pip install 'revisit-slam[cluster]'" in message
    assert message.count("\n") == 1
    assert not (sweep.parent / "none").exists()
