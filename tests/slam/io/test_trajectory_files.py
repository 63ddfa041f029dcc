"""Trajectories survive their files, and other tools accept them."""

from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from odometry import se3
from slam.errors import DataError, OutputError
from slam.io.trajectory_files import read_kitti, read_tum, write_kitti, write_tum

tangents = arrays(
    np.float64,
    st.tuples(st.integers(1, 8), st.just(6)),
    elements=st.floats(-3.0, 3.0, allow_subnormal=False),
)
far = st.floats(0.0, 1e4)


def poses_of(xi: np.ndarray, scale: float = 1.0) -> np.ndarray:
    poses = np.stack([se3.exp(row) for row in xi])
    poses[:, :3, 3] *= scale
    return poses


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("trajectory") / "poses.txt"


@settings(max_examples=25, deadline=None)
@given(xi=tangents, scale=far)
def test_kitti_poses_come_back_to_the_bit(file: Path, xi: np.ndarray, scale: float) -> None:
    poses = poses_of(xi, scale)
    write_kitti(file, poses)
    np.testing.assert_array_equal(read_kitti(file), poses)


@settings(max_examples=25, deadline=None)
@given(xi=tangents, scale=far)
def test_tum_poses_come_back(file: Path, xi: np.ndarray, scale: float) -> None:
    poses, times = poses_of(xi, scale), np.arange(len(xi)) / 10 + 1.3e9
    write_tum(file, times, poses)
    read_times, read_poses = read_tum(file)
    np.testing.assert_array_equal(read_times, times)
    np.testing.assert_array_equal(read_poses[:, :3, 3], poses[:, :3, 3])
    np.testing.assert_allclose(read_poses, poses, atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(xi=tangents)
def test_evo_reads_the_same_kitti_poses(file: Path, xi: np.ndarray) -> None:
    poses = poses_of(xi)
    write_kitti(file, poses)
    np.testing.assert_allclose(file_interface.read_kitti_poses_file(file).poses_se3, poses, atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(xi=tangents)
def test_evo_reads_the_same_tum_poses(file: Path, xi: np.ndarray) -> None:
    poses, times = poses_of(xi), np.arange(len(xi)) / 10
    write_tum(file, times, poses)
    read = file_interface.read_tum_trajectory_file(file)
    np.testing.assert_array_equal(read.timestamps, times)
    np.testing.assert_allclose(read.poses_se3, poses, atol=1e-12)


def test_what_evo_writes_is_read(file: Path) -> None:
    poses = poses_of(np.random.default_rng(0).normal(size=(5, 6)))
    write_kitti(file, poses)
    file_interface.write_kitti_poses_file(file, file_interface.read_kitti_poses_file(file))
    np.testing.assert_allclose(read_kitti(file), poses, atol=1e-12)


def test_lines_have_single_blanks_and_none_at_the_end(tmp_path: Path) -> None:
    write_kitti(tmp_path / "poses.txt", np.eye(4)[None])
    text = (tmp_path / "poses.txt").read_bytes()
    assert text == b"1.0 0.0 0.0 0.0 0.0 1.0 0.0 0.0 0.0 0.0 1.0 0.0\n"


def test_comments_and_empty_lines_are_skipped(tmp_path: Path) -> None:
    (tmp_path / "drive.tum").write_text("# time x y z qx qy qz qw\n\n1.5 1 2 3 0 0 0 2\n")
    times, poses = read_tum(tmp_path / "drive.tum")
    assert times.tolist() == [1.5]
    np.testing.assert_array_equal(poses[0], se3.pose(np.eye(3), np.array([1.0, 2.0, 3.0])))


def test_real_ground_truth_is_read(test_data: Path) -> None:
    path = test_data / "kitti_poses" / "05.txt"
    np.testing.assert_array_equal(read_kitti(path), file_interface.read_kitti_poses_file(path).poses_se3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "drive.tum: expected lines of 8 numbers, found an empty file"),
        ("1 2 3\n", "drive.tum, line 1: expected 8 finite numbers, found 3"),
        ("# ok\n1 0 0 0 0 0 0 inf\n", "drive.tum, line 2: expected 8 finite numbers"),
        ("1 0 0 0 0 0 0 0\n", "drive.tum, pose 0: expected a unit quaternion, found one of length 0"),
    ],
)
def test_a_damaged_tum_file_is_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "drive.tum").write_text(text)
    with pytest.raises(DataError, match=message):
        read_tum(tmp_path / "drive.tum")


def test_a_folder_that_is_missing_cannot_be_written_to(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"nowhere/poses.txt: cannot be written, No such file"):
        write_kitti(tmp_path / "nowhere" / "poses.txt", np.eye(4)[None])
