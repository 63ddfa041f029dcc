"""Two files of poses become numbers to read or to parse."""

import json
from pathlib import Path

import numpy as np
import pytest

from odometry import se3
from slam.apps.evaluate import evaluate_trajectory_files
from slam.errors import DataError
from slam.io.trajectory_files import write_kitti, write_tum


def drive(count: int = 300, step: float = 1.0) -> np.ndarray:
    motion = se3.exp(np.array([0.0, 0.001, 0.0, 0.0, 0.0, step]))
    return np.array([np.linalg.matrix_power(motion, k) for k in range(count)])


def stretched(poses: np.ndarray, factor: float) -> np.ndarray:
    out = poses.copy()
    out[:, :3, 3] *= factor
    return out


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    write_kitti(tmp_path / "truth.txt", drive())
    return tmp_path / "truth.txt"


@pytest.fixture
def estimate(tmp_path: Path) -> Path:
    write_kitti(tmp_path / "estimate.txt", stretched(drive(), 1.01))
    return tmp_path / "estimate.txt"


def test_numbers_carry_their_unit_and_alignment(estimate: Path, truth: Path) -> None:
    text = evaluate_trajectory_files(estimate, truth)
    assert text.startswith("300 poses, 299.0 m\n")
    for words in (
        "ATE, metres",
        "after SE(3) alignment",
        "t_rel, per cent",
        "degrees per 100 m",
        "of the path length",
    ):
        assert words in text


def test_json_has_the_names_of_the_metrics(estimate: Path, truth: Path) -> None:
    values = json.loads(evaluate_trajectory_files(estimate, truth, json=True))
    assert values["t_rel_percent"] == pytest.approx(1.0, rel=0.02)
    assert (values["poses"], values["ate_alignment"], values["notes"]) == (300, "se3", {})


def test_one_camera_is_aligned_with_scale(estimate: Path, truth: Path) -> None:
    values = json.loads(evaluate_trajectory_files(estimate, truth, mono=True, json=True))
    assert values["ate_m"] == pytest.approx(0.0, abs=1e-9)
    assert values["ate_alignment"] == "sim3"


def test_a_short_drive_gives_the_reason_instead_of_a_number(tmp_path: Path) -> None:
    write_kitti(tmp_path / "short.txt", drive(20))
    text = evaluate_trajectory_files(tmp_path / "short.txt", tmp_path / "short.txt")
    assert "the drive is 19.0 m long, segments need 100 m" in text


def test_tum_and_kitti_may_be_compared(tmp_path: Path, truth: Path) -> None:
    write_tum(tmp_path / "estimate.tum", np.arange(300) / 10, drive())
    assert json.loads(evaluate_trajectory_files(tmp_path / "estimate.tum", truth, json=True))["ate_m"] < 1e-9


def test_two_tum_files_are_matched_by_time(tmp_path: Path) -> None:
    poses, times = drive(), np.arange(300) / 10
    write_tum(tmp_path / "truth.tum", times, poses)
    write_tum(tmp_path / "key_frames.tum", times[5:250:7] + 0.004, poses[5:250:7])
    values = json.loads(evaluate_trajectory_files(tmp_path / "key_frames.tum", tmp_path / "truth.tum", json=True))
    assert values["poses"] == 35
    assert values["ate_m"] == pytest.approx(0.0, abs=1e-9)


def test_a_reference_serves_only_its_nearest_pose(tmp_path: Path) -> None:
    poses = drive(4)
    write_tum(tmp_path / "truth.tum", np.array([0.0, 1.0]), poses[[0, 2]])
    write_tum(tmp_path / "estimate.tum", np.array([0.0, 0.998, 1.001, 5.0]), poses)
    values = json.loads(evaluate_trajectory_files(tmp_path / "estimate.tum", tmp_path / "truth.tum", json=True))
    assert values["poses"] == 2
    assert values["end_error_m"] == pytest.approx(0.0, abs=1e-9)


def test_tum_files_of_different_times_are_refused(tmp_path: Path) -> None:
    write_tum(tmp_path / "a.tum", np.arange(5.0), drive(5))
    write_tum(tmp_path / "b.tum", np.arange(5.0) + 100, drive(5))
    with pytest.raises(DataError, match=r"a.tum: expected times within 0.01 s .*b.tum, found 0 of 5"):
        evaluate_trajectory_files(tmp_path / "a.tum", tmp_path / "b.tum")


def test_different_numbers_of_poses_are_refused(tmp_path: Path, truth: Path) -> None:
    write_kitti(tmp_path / "a.txt", drive(5))
    with pytest.raises(DataError, match=r"a.txt: expected 300 poses as in .*truth.txt, found 5"):
        evaluate_trajectory_files(tmp_path / "a.txt", truth)


@pytest.mark.parametrize(("text", "columns"), [("", 0), ("# only this\n", 0), ("1 2 3\n", 3)])
def test_other_files_are_named(tmp_path: Path, truth: Path, text: str, columns: int) -> None:
    (tmp_path / "a.txt").write_text(text)
    message = rf"a.txt: expected KITTI poses \(12 numbers a line\) or TUM \(8\), found {columns}"
    with pytest.raises(DataError, match=message):
        evaluate_trajectory_files(tmp_path / "a.txt", truth)
