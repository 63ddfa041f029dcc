"""Two files of poses become numbers to read or to parse."""

import json
from pathlib import Path

import numpy as np
import pytest

from odometry import se3
from slam.apps.evaluate import evaluate_trajectory_files
from slam.cli import app
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


def values_of(estimate: Path, truth: Path) -> dict:
    return json.loads(evaluate_trajectory_files(estimate, truth, json=True))


def test_the_order_of_the_lines_does_not_change_a_number(tmp_path: Path) -> None:
    times, poses = np.arange(300) / 10, stretched(drive(), 1.01)
    write_tum(tmp_path / "truth.tum", times, drive())
    write_tum(tmp_path / "sorted.tum", times, poses)
    order = np.r_[150:300, 0:150]
    write_tum(tmp_path / "sessions.tum", times[order], poses[order])
    expected = values_of(tmp_path / "sorted.tum", tmp_path / "truth.tum")
    found = values_of(tmp_path / "sessions.tum", tmp_path / "truth.tum")
    assert expected.pop("warnings") == []
    assert "sessions.tum: sorted by time, as 1 line is earlier than the one before (first in line 151)" in str(
        found.pop("warnings")
    )
    assert found == expected


@pytest.mark.parametrize("rate", [7.0, 3.0, 100.0])
def test_a_truth_of_another_rate_is_interpolated(tmp_path: Path, rate: float) -> None:
    motion = np.array([0.0, 0.01, 0.0, 0.0, 0.0, 10.0])  # a second's
    times, true_times = np.arange(300) / 10, 0.0043 + np.arange(rate * 31) / rate
    write_tum(tmp_path / "estimate.tum", times, np.array([se3.exp(t * motion) for t in times]))
    write_tum(tmp_path / "truth.tum", true_times, np.array([se3.exp(t * motion) for t in true_times]))
    values = values_of(tmp_path / "estimate.tum", tmp_path / "truth.tum")
    # The first pose is before the truth, but near enough to its first one.
    assert (values["poses"], values["estimated_poses"], values["matched_by"]) == (300, 300, "time")
    assert values["ate_m"] < 0.003  # of that one pose, which is 4 cm off


def test_few_poses_with_a_true_one_are_said_and_have_no_segment_errors(tmp_path: Path) -> None:
    times, true_times = np.arange(300) / 10, 0.003 + np.arange(30) * 1.01
    write_tum(tmp_path / "estimate.tum", times, drive())
    write_tum(tmp_path / "truth.tum", true_times, np.array([se3.exp(t * se3.log(drive(11)[10])) for t in true_times]))
    values = values_of(tmp_path / "estimate.tum", tmp_path / "truth.tum")
    assert (values["poses"], values["estimated_poses"]) == (6, 300)  # at 0, 9.1, 10.1, 19.2, 20.2 and 29.3 s
    assert values["t_rel_percent"] is None
    assert "6 poses are 59 m apart, segments need one in 10 m" in values["notes"]["t_rel_percent"]
    text = evaluate_trajectory_files(tmp_path / "estimate.tum", tmp_path / "truth.tum")
    assert text.startswith("6 of 300 poses, matched by time, ")
    assert "warning: " in text
    assert "6 of 300 poses have a true pose within 0.01 s or between two at most 0.5 s apart; 294 are left out" in text


def test_the_csv_of_euroc_is_a_truth(tmp_path: Path) -> None:
    times, lines = (
        1403636579763555584 + 100_000_000 * np.arange(300),
        ["#timestamp, p_x, p_y, p_z, q_w, q_x, q_y, q_z, v"],
    )
    write_tum(tmp_path / "estimate.tum", times / 1e9, drive())
    for time, row in zip(times, (tmp_path / "estimate.tum").read_text().splitlines(), strict=True):
        words = row.split()
        lines.append(",".join([str(time), *words[1:4], words[7], *words[4:7], "0"]))
    (tmp_path / "data.csv").write_text("\n".join(lines))
    values = values_of(tmp_path / "estimate.tum", tmp_path / "data.csv")
    assert (values["poses"], values["warnings"]) == (300, [])
    assert values["ate_m"] < 1e-6


def test_other_axes_are_said(tmp_path: Path) -> None:
    poses, turn = np.array([se3.exp(np.array([0, 0.02 * k, 0, 0, 0, 0])) for k in range(300)]), np.eye(4)
    poses[:, :3, 3] = np.cumsum(poses[:, :3, 2], axis=0)
    turn[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    write_kitti(tmp_path / "camera.txt", poses)
    write_kitti(tmp_path / "vehicle.txt", poses @ se3.inverse(turn))
    values = values_of(tmp_path / "camera.txt", tmp_path / "vehicle.txt")
    assert "the axes of the poses differ by 120 degrees" in values["warnings"][0]
    assert values["ate_m"] < 1e-9
    assert values_of(tmp_path / "camera.txt", tmp_path / "camera.txt")["warnings"] == []


def test_lines_left_out_explain_a_count_that_does_not_agree(tmp_path: Path, truth: Path) -> None:
    write_tum(tmp_path / "a.tum", np.arange(300.0), drive())
    lines = (tmp_path / "a.tum").read_text().splitlines()
    lines[7] = "7.0 nan nan nan nan nan nan nan"
    (tmp_path / "a.tum").write_text("\n".join(lines))
    with pytest.raises(DataError, match=r"found 299; .* passed over 1 line without a pose .* \(first in line 8\)"):
        evaluate_trajectory_files(tmp_path / "a.tum", truth)


def test_a_warning_is_printed_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "drive [one].tum"
    write_tum(path, np.arange(300.0)[::-1], drive())
    assert app._exit_code(lambda: app.app(["evaluate", "trajectory", str(path), str(path)])) == 0
    assert f"warning: {path}: sorted by time, as 299 lines are earlier" in capsys.readouterr().out


def test_the_truth_of_a_vehicle_is_moved_to_its_camera_by_the_calibration_beside(tmp_path: Path) -> None:
    T_body_camera = se3.exp(np.array([0.3, -1.2, 0.8, 0.1, -0.2, 0.3]))
    times = 1.4e9 + np.arange(200) / 8
    write_tum(tmp_path / "camera.tum", times, drive(200))
    write_tum(tmp_path / "body.tum", times, drive(200) @ se3.inverse(T_body_camera))
    for folder in ("cam0", "state_groundtruth_estimate0"):
        (tmp_path / folder).mkdir()
    rows = [line.split() for line in (tmp_path / "body.tum").read_text().splitlines()]
    lines = [",".join([str(round(float(w[0]) * 1e9)), *w[1:4], w[7], *w[4:7]]) for w in rows]
    truth = tmp_path / "state_groundtruth_estimate0" / "data.csv"
    truth.write_text("\n".join(["#timestamp,p_x,p_y,p_z,q_w,q_x,q_y,q_z", *lines]))
    numbers = ", ".join(map(repr, T_body_camera.ravel().tolist()))
    (tmp_path / "cam0" / "sensor.yaml").write_text(
        f"T_BS:\n  data: [{numbers}]\nintrinsics: [400, 400, 300, 200]\ndistortion_coefficients: []\n"
    )
    values = values_of(tmp_path / "camera.tum", truth)
    assert values["end_error_m"] < 1e-6
    assert values["t_rel_percent"] < 1e-6
    assert "poses of the vehicle, moved to the left camera" in values["warnings"][0]


def test_the_other_file_tells_milliseconds_at_100_hz_from_steps_of_10_s(tmp_path: Path) -> None:
    times, true_times = np.arange(300) / 10, np.arange(3000) / 100
    motion = se3.log(drive(2)[1]) * 10
    write_tum(tmp_path / "estimate.tum", times, stretched(np.array([se3.exp(t * motion) for t in times]), 1.01))
    poses = np.array([se3.exp(t * motion) for t in true_times])
    write_tum(tmp_path / "seconds.tum", true_times, poses)
    write_tum(tmp_path / "thousandths.tum", np.arange(3000.0) * 10, poses)
    right = values_of(tmp_path / "estimate.tum", tmp_path / "seconds.tum")
    found = values_of(tmp_path / "estimate.tum", tmp_path / "thousandths.tum")
    assert found["ate_m"] == pytest.approx(right["ate_m"])
    assert (found["poses"], right["warnings"]) == (300, [])
    assert found["warnings"] == [
        f"{tmp_path}/thousandths.tum: the times are 0 to 29990 in steps of 10 and fit the others only if divided by"
        " 1000, and were"
    ]
    swapped = values_of(tmp_path / "thousandths.tum", tmp_path / "estimate.tum")
    assert (swapped["poses"], swapped["ate_m"]) == (2991, pytest.approx(right["ate_m"], rel=0.02))


def test_poses_that_match_by_chance_give_no_errors(tmp_path: Path) -> None:
    write_tum(tmp_path / "a.tum", np.arange(300) / 10, drive())
    write_tum(tmp_path / "b.tum", np.arange(300) * 7.0, drive())
    with pytest.raises(DataError, match=r"found 5 of 300, from 0.000 to 29.900 s against 0.000 to 2093.000 s"):
        evaluate_trajectory_files(tmp_path / "a.tum", tmp_path / "b.tum")
