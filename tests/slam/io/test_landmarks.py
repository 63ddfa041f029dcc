"""Point clouds come back from their files, and Open3D reads them too."""

import resource
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slam.errors import DataError, OutputError
from slam.io.landmarks import read_cloud, write_cloud
from slam.run_result import PointCloud


def cloud_of(seed: int, count: int) -> PointCloud:
    rng = np.random.default_rng(seed)
    return PointCloud(rng.normal(scale=100.0, size=(count, 3)), rng.integers(0, 256, count, dtype=np.uint8))


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ply") / "map.ply"


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), count=st.integers(0, 50))
def test_a_cloud_comes_back_to_the_bit(file: Path, seed: int, count: int) -> None:
    cloud = cloud_of(seed, count)
    write_cloud(file, cloud)
    read = read_cloud(file)
    np.testing.assert_array_equal(read.points, cloud.points)
    np.testing.assert_array_equal(read.grey, cloud.grey)


def test_every_brightness_comes_back(file: Path) -> None:
    grey = np.arange(256).astype(np.uint8)
    write_cloud(file, PointCloud(np.zeros((256, 3)), grey))
    np.testing.assert_array_equal(read_cloud(file).grey, grey)


def test_comments_in_the_header_are_passed_over(file: Path) -> None:
    cloud = cloud_of(0, 10)
    write_cloud(file, cloud)
    file.write_bytes(file.read_bytes().replace(b"1.0\n", b"1.0\ncomment Created by Open3D\n"))
    np.testing.assert_array_equal(read_cloud(file).points, cloud.points)


def test_the_file_is_binary_and_nothing_else_is_left(tmp_path: Path) -> None:
    write_cloud(tmp_path / "map.ply", cloud_of(0, 10))
    assert (tmp_path / "map.ply").read_bytes().startswith(b"ply\nformat binary_little_endian 1.0\n")
    assert [item.name for item in tmp_path.iterdir()] == ["map.ply"]


def test_writing_into_a_missing_folder_is_the_users_to_mend(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"nowhere/map.ply: cannot be written"):
        write_cloud(tmp_path / "nowhere" / "map.ply", cloud_of(0, 10))


def test_a_full_disk_leaves_the_earlier_map(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "map.ply"
    write_cloud(path, cloud_of(0, 10))
    before = path.read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        with pytest.raises(OutputError, match=r"map.ply: cannot be written, File too large"):
            write_cloud(path, cloud_of(0, 5000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_bytes() == before


def test_a_missing_cloud_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"map.ply: expected a PLY file, found none"):
        read_cloud(tmp_path / "map.ply")


def test_another_file_is_named(tmp_path: Path) -> None:
    header = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
    for text in ("solid cube", header + "end_header\n1 2 3\n"):
        (tmp_path / "map.ply").write_text(text)
        with pytest.raises(DataError, match=r"map.ply: expected a PLY file of a run, found another header"):
            read_cloud(tmp_path / "map.ply")


def test_a_cloud_that_was_cut_short_is_named(file: Path) -> None:
    write_cloud(file, cloud_of(0, 10))
    file.write_bytes(file.read_bytes()[:-1])
    with pytest.raises(DataError, match=r"map.ply: expected 10 points of 27 bytes, found 269 bytes"):
        read_cloud(file)


def test_open3d_reads_the_same_cloud(file: Path) -> None:
    open3d = pytest.importorskip("open3d")
    write_cloud(file, cloud_of(3, 20))
    theirs, ours = open3d.io.read_point_cloud(file), read_cloud(file)
    np.testing.assert_array_equal(np.asarray(theirs.points), ours.points)
    np.testing.assert_array_equal(np.rint(255 * np.asarray(theirs.colors)[:, 0]), ours.grey)
