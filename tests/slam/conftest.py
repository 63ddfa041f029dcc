"""A small simulated drive, rendered once for all tests of the chain."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from slam.benchmark.executors import DaskExecutor
from slam.simulation import SimulationConfig, simulate


@pytest.fixture(scope="session")
def circle_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two laps of 160 m, images at half of KITTI's size, in KITTI layout."""
    spec = SimulationConfig(
        shape="circle", laps=2, length_m=160.0, width=620, height=188, seed=3, difficulty="standard"
    )
    return simulate(spec, tmp_path_factory.mktemp("circle") / "drive")


@pytest.fixture(scope="session")
def cluster() -> Iterator[DaskExecutor]:
    """Two processes; the second death of an item is its last, as each takes seconds."""
    with pytest.MonkeyPatch.context() as patch, ExitStack() as open_:
        patch.setattr("slam.benchmark.executors._ALLOWED_DEATHS", 1)
        started = open_.enter_context(DaskExecutor(2, None))
        patch.undo()
        yield started
