"""A small simulated drive, rendered once for all tests of the chain."""

from pathlib import Path

import pytest

from slam.simulation import DriveSpec, simulate


@pytest.fixture(scope="session")
def circle_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two laps of 160 m, images at half of KITTI's size, in KITTI layout."""
    spec = DriveSpec(shape="circle", laps=2, length=160.0, width=620, height=188, seed=3)
    return simulate(spec, tmp_path_factory.mktemp("circle") / "drive")
