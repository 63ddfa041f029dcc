"""covariances.npz holds what the record knows, byte by byte the same each time."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slam.errors import OutputError
from slam.io.trajectory_files import write_covariances

from ..report import fabricate

KNOWN = replace(
    fabricate.record(20), odometry_covariances=np.ones((20, 6, 6)), corrected_covariances=np.full((20, 6, 6), 0.5)
)


def test_both_come_back(tmp_path: Path) -> None:
    write_covariances(tmp_path / "covariances.npz", KNOWN)
    with np.load(tmp_path / "covariances.npz") as file:
        np.testing.assert_array_equal(file["odometry"], KNOWN.odometry_covariances)
        np.testing.assert_array_equal(file["corrected"], KNOWN.corrected_covariances)


def test_what_is_not_known_is_left_out(tmp_path: Path) -> None:
    write_covariances(tmp_path / "covariances.npz", replace(KNOWN, odometry_covariances=None))
    with np.load(tmp_path / "covariances.npz") as file:
        assert file.files == ["corrected"]


def test_the_same_record_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a.npz", "b.npz"):
        write_covariances(tmp_path / name, KNOWN)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_folder_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="nowhere"):
        write_covariances(tmp_path / "nowhere" / "covariances.npz", KNOWN)
