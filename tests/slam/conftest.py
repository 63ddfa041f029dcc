"""A small simulated drive and a run of the chain on it, made once for all tests of the chain in all test processes."""

import fcntl
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from rich.console import Console

from slam.benchmark.executors import DaskExecutor
from slam.pipeline.pipeline import RunOptions, run_pipeline
from slam.simulation import SimulationConfig, simulate


def make_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """A folder that the first process of a test session makes (pytest-xdist has several) and that all of them read."""
    shared = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent  # the session's; within it each process has a folder of its own
    folder = shared / "shared" / name
    folder.parent.mkdir(exist_ok=True)
    with (folder.parent / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            make(folder)
    return folder


@pytest.fixture(scope="session")
def circle_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two laps of 160 m, images at half of KITTI's size, in KITTI layout; whoever changes it takes a copy."""
    spec = SimulationConfig(
        shape="circle", laps=2, length_m=160.0, width=620, height=188, seed=3, difficulty="standard"
    )
    return make_once(tmp_path_factory, "drive", lambda folder: simulate(spec, folder))


@pytest.fixture(scope="session")
def circle_run(circle_drive: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a run with the default settings over these laps, without a recording; whoever changes it copies it."""
    quiet = Console(quiet=True)

    def run(out: Path) -> None:
        run_pipeline(RunOptions(source=circle_drive, out=out), {"save_recording": False}, quiet, quiet)

    return make_once(tmp_path_factory, "run", run)


@pytest.fixture(scope="session")
def cluster() -> Iterator[DaskExecutor]:
    """Two processes; the second death of an item is its last, as each takes seconds."""
    with pytest.MonkeyPatch.context() as patch, ExitStack() as open_:
        patch.setattr("slam.benchmark.executors._ALLOWED_DEATHS", 1)
        started = open_.enter_context(DaskExecutor(2, None))
        patch.undo()
        yield started
