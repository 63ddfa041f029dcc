"""Trajectories of other programs give the same poses whatever their layout, and what was changed is said."""

import codecs
from pathlib import Path

import numpy as np
import pytest

from odometry import se3
from slam.errors import DataError
from slam.io.trajectory_files import write_kitti, write_tum
from slam.io.trajectory_reader import Trajectory, read_trajectory

COUNT = 6
TIMES = 1.4e9 + np.arange(COUNT) / 8  # exact in binary and in nanoseconds
POSES = np.array([se3.exp(row) for row in np.random.default_rng(0).normal(size=(COUNT, 6))])


def rows_of(folder: Path) -> list[list[str]]:
    """Words of a TUM file: time, position, quaternion with w last."""
    write_tum(folder / "plain.tum", TIMES, POSES)
    return [line.split() for line in (folder / "plain.tum").read_text().splitlines()]


def read(folder: Path, lines: list[str], name: str = "a.txt") -> Trajectory:
    (folder / name).write_text("\n".join(lines) + "\n")
    return read_trajectory(folder / name)


def assert_same(found: Trajectory, rows: slice | list[int] = slice(None)) -> None:
    assert found.times is not None
    np.testing.assert_allclose(found.times, TIMES[rows], rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.poses, POSES[rows], atol=1e-12)


def test_kitti_has_no_times_and_keeps_its_order(tmp_path: Path) -> None:
    write_kitti(tmp_path / "a.txt", POSES)
    found = read_trajectory(tmp_path / "a.txt")
    assert found.times is None
    np.testing.assert_array_equal(found.poses, POSES)


@pytest.mark.parametrize("separator", [" ", "\t", ",", ", ", ";", "  "])
@pytest.mark.parametrize(
    "header", [[], ["# anything"], ["timestamp tx ty tz qx qy qz qw"], ["#t,x,y,z,qx,qy,qz,qw", ""]]
)
def test_separators_and_headers_do_not_matter(tmp_path: Path, separator: str, header: list[str]) -> None:
    found = read(tmp_path, header + [separator.join(row) for row in rows_of(tmp_path)])
    assert_same(found)
    assert found.num_left_out == 0


@pytest.mark.parametrize(
    ("header", "order"),
    [
        ("timestamp,tx,ty,tz,qw,qx,qy,qz", [0, 1, 2, 3, 7, 4, 5, 6]),
        ("#timestamp [ns], p_R_x [m], p_R_y [m], p_R_z [m], q_w [], q_x [], q_y [], q_z []", [0, 1, 2, 3, 7, 4, 5, 6]),
        ("orientation.x;orientation.y;orientation.z;orientation.w;x;y;z;time", [4, 5, 6, 7, 1, 2, 3, 0]),
    ],
)
def test_a_header_says_which_column_is_what(tmp_path: Path, header: str, order: list[int]) -> None:
    found = read(tmp_path, [header, *(",".join(row[k] for k in order) for row in rows_of(tmp_path))])
    assert_same(found)
    assert found.remarks == ()


def nanoseconds(row: list[str]) -> str:
    return str(round(float(row[0]) * 1e9))


@pytest.mark.parametrize("more", [[], ["0"] * 9, [""]])
def test_the_csv_of_euroc_counts_nanoseconds_and_has_w_first(tmp_path: Path, more: list[str]) -> None:
    rows = rows_of(tmp_path)
    found = read(tmp_path, [",".join([nanoseconds(row), *row[1:4], row[7], *row[4:7], *more]) for row in rows])
    assert_same(found)
    remark = "no header names the columns of the quaternion; it is read with w first, as EuRoC has it"
    assert found.remarks == (f"{tmp_path / 'a.txt'}: {remark}",)


@pytest.mark.parametrize(("factor", "unit"), [(1e9, "nanoseconds"), (1e6, "microseconds"), (1e3, "milliseconds")])
def test_other_units_since_1970_become_seconds(tmp_path: Path, factor: float, unit: str) -> None:
    found = read(tmp_path, [" ".join([repr(float(row[0]) * factor), *row[1:]]) for row in rows_of(tmp_path)])
    assert_same(found)
    assert found.remarks == (f"{tmp_path / 'a.txt'}: the times are {unit} and were divided by {factor:g}",)


@pytest.mark.parametrize(("factor", "unit"), [(1e9, "nanoseconds"), (1e6, "microseconds"), (1e3, "milliseconds")])
def test_other_units_since_the_start_become_seconds(tmp_path: Path, factor: float, unit: str) -> None:
    found = read(tmp_path, [" ".join([repr(k / 8 * factor), *row[1:]]) for k, row in enumerate(rows_of(tmp_path))])
    np.testing.assert_allclose(found.times, np.arange(COUNT) / 8)  # type: ignore[arg-type]
    assert unit in found.remarks[0]


@pytest.mark.parametrize("step", [0.005, 0.1, 1.0, 10.0])
def test_seconds_stay_seconds(tmp_path: Path, step: float) -> None:
    write_tum(tmp_path / "a.tum", np.arange(COUNT) * step, POSES)
    found = read_trajectory(tmp_path / "a.tum")
    np.testing.assert_array_equal(found.times, np.arange(COUNT) * step)  # type: ignore[arg-type]
    assert found.remarks == ()


def test_times_that_go_back_are_sorted_with_a_remark(tmp_path: Path) -> None:
    lines = [" ".join(row) for row in rows_of(tmp_path)]
    found = read(tmp_path, ["# two sessions", *lines[3:], *lines[:3]])
    assert_same(found)
    assert found.remarks[0].endswith("sorted by time, as 1 line is earlier than the one before (first in line 5)")
    assert_same(read(tmp_path, lines[::-1]))


def test_a_second_line_of_one_time_is_left_out_with_a_remark(tmp_path: Path) -> None:
    lines = [" ".join(row) for row in rows_of(tmp_path)]
    other = " ".join([lines[2].split()[0], "9", "9", "9", "0", "0", "0", "1"])
    found = read(tmp_path, [*lines[:3], other, *lines[3:], lines[0]])
    assert_same(found)
    assert found.remarks[-1].endswith("passed over 2 lines with the time of an earlier line (first in line 4)")
    assert found.num_left_out == 2


@pytest.mark.parametrize("lost", ["nan nan nan nan nan nan nan", "1 2 3 0 0 0 0", "1 2 inf 0 0 0 1"])
def test_lines_without_a_pose_are_left_out_with_a_remark(tmp_path: Path, lost: str) -> None:
    lines = [" ".join(row) for row in rows_of(tmp_path)]
    lines[1], lines[4] = (f"{lines[k].split()[0]} {lost}" for k in (1, 4))
    found = read(tmp_path, lines)
    assert_same(found, [0, 2, 3, 5])
    assert (
        "passed over 2 lines without a pose (nan, or a quaternion of length zero) (first in line 2)" in found.remarks[0]
    )


def test_a_file_in_utf_16_and_one_with_a_mark_are_read(tmp_path: Path) -> None:
    text = "\r\n".join(" ".join(row) for row in rows_of(tmp_path))
    for data in (codecs.BOM_UTF8 + text.encode(), codecs.BOM_UTF16_LE + text.encode("utf-16-le")):
        (tmp_path / "a.txt").write_bytes(data)
        assert_same(read_trajectory(tmp_path / "a.txt"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "found 0; export one of them"),
        ("1 2 3\n", "expected KITTI poses .12 numbers a line. or TUM .8., found 3"),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0\n", "line 2: expected 8 finite numbers as in the lines before, found 7"),
        ("1 0 0 0 0 0 0 1\n2 0 0 zero 0 0 0 1\n", "line 2: expected 8 finite numbers, found '2 0 0 zero"),
        ("t0 1 0 0 0 0 0 0 1\n", "line 1: expected 9 finite numbers, found 't0 1.*; put # before a header"),
        ("nan 0 0 0 0 0 0 1\n", "expected poses, found 1 line without a pose"),
        (
            "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 nan 0 1 0 0 0 0 1 0\n",
            "line 2: expected 12 finite numbers, found nan or inf",
        ),
        (
            "1600000000,5 0,25 -0,5 0 0,0 0 0 1,0\n",
            "line 1: expected decimal points, found decimal commas, '1600000000,5 0,25.*; write decimal points",
        ),
        ("0;0;0;0;0;0;0;1\n1,5;0,25;0;0;0;0;0;1\n", "line 2: expected decimal points, found decimal commas"),
        ("1 1e13 0 0 0 0 0 1\n", "pose 0: expected a position in metres"),
    ],
)
def test_what_is_no_trajectory_is_named_with_its_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "a.txt").write_text(text)
    with pytest.raises(DataError, match=rf"a\.txt.*{message}"):
        read_trajectory(tmp_path / "a.txt")
