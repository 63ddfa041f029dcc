"""The ground truth of revisits is that of its file, and its description holds every number of the rule."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from odometry import se3
from slam.errors import DataError
from slam.evaluation.loops import LoopRule, find_revisits, is_same_place, is_true_loop, revisit_matrix
from slam.evaluation.revisit_truth_files import (
    RevisitTruth,
    check_truth_size,
    describe_rule,
    read_revisit_truth,
    revisit_truth_from_poses,
)
from slam.io.trajectory_files import write_kitti, write_tum

LAP = 40
COUNT = 2 * LAP


@pytest.fixture
def laps() -> np.ndarray:
    """Two laps of a circle of 200 m, with the second shifted by half a frame."""
    motion = se3.exp(np.array([0.0, 2 * np.pi / (LAP - 0.5), 0.0, 0.0, 0.0, 5.0]))
    return np.array([np.linalg.matrix_power(motion, k) for k in range(COUNT)])


def test_kitti_and_tum_poses_give_the_same_truth(tmp_path: Path, laps: np.ndarray) -> None:
    write_kitti(tmp_path / "poses.txt", laps)
    write_tum(tmp_path / "poses.tum", np.arange(COUNT) / 10, laps)
    by_kitti, by_tum = (read_revisit_truth(tmp_path / name) for name in ("poses.txt", "poses.tum"))
    np.testing.assert_array_equal(by_kitti.required_matrix, by_tum.required_matrix)
    np.testing.assert_array_equal(by_kitti.required_matrix, revisit_truth_from_poses(laps, "poses").required_matrix)
    assert by_kitti.required_matrix.any()


def test_a_matrix_comes_back_as_it_was_written(tmp_path: Path) -> None:
    matrix = np.tril(np.random.default_rng(0).random((9, 9)) > 0.7, -1)
    np.savez(tmp_path / "loops.npz", truth=matrix)
    truth = read_revisit_truth(tmp_path / "loops.npz")
    np.testing.assert_array_equal(truth.required_matrix, matrix)
    assert truth.origin == str(tmp_path / "loops.npz")


def test_a_revisit_is_an_earlier_image_and_no_neighbour(laps: np.ndarray) -> None:
    matrix = revisit_matrix(laps)
    assert not np.triu(matrix).any()
    query, match = np.nonzero(matrix)
    assert (query - match).min() > LAP // 2
    assert all(is_same_place(laps, int(q), int(m)) for q, m in zip(query, match, strict=True))
    np.testing.assert_array_equal(find_revisits(laps), matrix.any(axis=1))


def test_the_truth_does_not_depend_on_the_world_frame(laps: np.ndarray) -> None:
    T = se3.exp(np.array([0.3, -0.2, 0.1, 4.0, 5.0, -6.0]))
    np.testing.assert_array_equal(revisit_matrix(T @ laps), revisit_matrix(laps))
    for query, match in ((50, 10), (60, 20), (70, 10)):
        T_match_query = se3.inverse(laps[match]) @ laps[query] @ se3.exp(np.full(6, 0.05))
        found = [is_true_loop(poses, query, match, T_match_query) for poses in (laps, T @ laps)]
        assert found == [True, True]


def test_a_loop_and_its_inverse_are_both_true_or_both_false(laps: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    for size in (0.01, 0.5, 10.0):
        T_match_query = se3.inverse(laps[10]) @ laps[50] @ se3.exp(size * np.array([0, 0, 0, *rng.normal(size=3)]))
        forward = is_true_loop(laps, 50, 10, T_match_query)
        assert forward == is_true_loop(laps, 10, 50, se3.inverse(T_match_query)) == (size < 1.0)


def test_the_description_has_every_number_of_the_rule(laps: np.ndarray) -> None:
    rule = LoopRule().revisit
    names = [name for name, value in vars(rule).items() if isinstance(value, float)]
    changed = replace(rule, **{name: 3.25 + number for number, name in enumerate(names)})
    assert set(re.findall(r"\d+\.25", describe_rule(changed))) == {f"{3.25 + n}" for n in range(len(names))}
    assert "nearest image" in describe_rule(replace(rule, is_one_to_one=True))
    assert describe_rule(rule) in revisit_truth_from_poses(laps, "poses").origin


def test_a_truth_of_another_size_is_refused_and_an_unknown_one_is_not() -> None:
    check_truth_size(RevisitTruth(None, "none"), 7, Path("drive"))
    check_truth_size(RevisitTruth(np.zeros((7, 7), np.bool_), "a"), 7, Path("drive"))
    with pytest.raises(DataError, match=r"expected a truth of 8 images as in drive, found 7"):
        check_truth_size(RevisitTruth(np.zeros((7, 7), np.bool_), "a"), 8, Path("drive"))


def test_the_times_of_the_images_show_that_a_truth_is_in_milliseconds(tmp_path: Path, laps: np.ndarray) -> None:
    write_tum(tmp_path / "poses.tum", np.arange(COUNT) * 10.0, laps)
    truth = read_revisit_truth(tmp_path / "poses.tum", image_times=np.arange(COUNT) / 100)
    np.testing.assert_array_equal(truth.required_matrix, revisit_truth_from_poses(laps, "poses").required_matrix)
    assert "the times are 0 to 790 in steps of 10 and fit the others only if divided by 1000" in truth.remarks[0]
    assert "matched by time with the 80 images" in truth.remarks[1]
