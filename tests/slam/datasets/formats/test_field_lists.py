"""Lists of images and poses as people have them: headers, order, copies, gaps and units."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from slam.datasets.dataset import DatasetSpec
from slam.datasets.formats.image_sequence import read_times
from slam.datasets.formats.registry import open_dataset, open_for_odometry, open_images
from slam.datasets.time_sync import find_ticks_per_second, order_by_time
from slam.errors import DataError

from ..layouts import RATE, Taken, finely, taken, write_euroc, write_folders, write_tum_rgbd

CAM0, CAM1 = Path("mav0/cam0/data.csv"), Path("mav0/cam1/data.csv")
TRUTH = Path("mav0/state_groundtruth_estimate0/data.csv")


@pytest.fixture(scope="module")
def rough() -> Taken:
    return taken("radtan")


def edit_lines(path: Path, change: Callable[[list[str]], list[str]]) -> None:
    """Change the lines of a file that has one comment before its rows."""
    lines = path.read_text().splitlines()
    comments = [line for line in lines if line.startswith("#")]
    path.write_text("\n".join([*comments, *change(lines[len(comments) :])]) + "\n")


def assert_read(folder: Path, expected: Taken, *remarks: str) -> None:
    """All images in their order with their true poses, and these remarks."""
    for dataset in (open_dataset(folder), open_images(DatasetSpec(folder))):
        assert dataset.remarks == remarks
        np.testing.assert_allclose(dataset.timestamps, expected.times, atol=1e-5)
        assert dataset.ground_truth is not None
        np.testing.assert_allclose(dataset.ground_truth, expected.truth, atol=1e-5)


@pytest.mark.parametrize("header", ["timestamp [ns],filename", '"timestamp","filename"', "Timestamp , Filename"])
def test_a_first_line_of_words_is_a_header(tmp_path: Path, rough: Taken, header: str) -> None:
    root = write_euroc(tmp_path / "MH", rough)
    for path in (CAM0, CAM1, TRUTH):
        rows = (root / path).read_text().splitlines()[1:]
        (root / path).write_text("\ufeff" + "\r\n".join([header, *rows, "", ""]), newline="")
    assert_read(root, rough)


def test_lines_of_images_out_of_order_are_sorted_with_a_remark(tmp_path: Path, rough: Taken) -> None:
    root = write_euroc(tmp_path / "MH", rough)
    edit_lines(root / CAM0, lambda rows: [rows[0], rows[2], rows[1], *rows[3:]])
    assert_read(
        root, rough, "cam0/data.csv: 1 lines with an earlier time than the line before are sorted, the first is line 4"
    )
    frames = list(open_dataset(root))
    for frame, (left, _) in zip(frames, rough.pairs, strict=True):
        np.testing.assert_array_equal(frame.left, rough.ideal.left(left))


@pytest.mark.parametrize("time", ["nan", "0", ""])
def test_images_without_a_time_are_left_out_with_a_remark(tmp_path: Path, rough: Taken, time: str) -> None:
    root = write_euroc(tmp_path / "MH", rough)
    edit_lines(root / CAM1, lambda rows: [rows[0], f"{time},{rows[1].split(',')[1]}", *rows[2:]])
    drive = open_dataset(root)
    assert drive.remarks == (
        "cam1/data.csv: 1 lines without a time are left out, the first is line 3",
        "1 images without a partner in the other camera are left out",
    )
    assert len(drive) == 4


def test_an_image_that_is_listed_twice_is_read_once(tmp_path: Path, rough: Taken) -> None:
    root = write_tum_rgbd(tmp_path / "freiburg3", rough)
    edit_lines(root / "rgb.txt", lambda rows: [*rows[:3], rows[2], rows[2], *rows[3:]])
    drive = open_dataset(root)
    assert drive.remarks == (
        "freiburg3/rgb.txt: 2 lines with the time of another line are left out, the first is line 7",
    )
    np.testing.assert_array_equal(drive[3].left, rough.pairs[3][0])


BAD_TRUTH: dict[str, tuple[Callable[[list[str]], list[str]], str]] = {
    "doubled": (
        lambda rows: [*rows[:5], rows[4], *rows[5:]],
        "1 lines with the time of another line are left out, the first is line 7",
    ),
    "backward": (
        lambda rows: [*rows[:5], rows[6], rows[5], *rows[7:]],
        "1 lines with an earlier time than the line before are sorted, the first is line 8",
    ),
    "reversed": (
        lambda rows: rows[::-1],
        "40 lines with an earlier time than the line before are sorted, the first is line 3",
    ),
    "nan": (
        lambda rows: [*rows[:5], ",".join([rows[5].split(",")[0], *["nan"] * 16]), *rows[6:]],
        "1 lines without 8 finite numbers are left out, the first is line 7",
    ),
    "cut": (
        lambda rows: [*rows[:5], "1403,2", *rows[6:]],
        "1 lines without 8 finite numbers are left out, the first is line 7",
    ),
    "lost": (
        lambda rows: [*rows[:5], ",".join([*rows[5].split(",")[:4], "0,0,0,0"]), *rows[6:]],
        "1 poses without a rotation are left out, the first at 1403636580.025000 s",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", BAD_TRUTH)
def test_bad_lines_of_the_truth_are_left_out_with_a_remark(tmp_path: Path, rough: Taken, fault: str) -> None:
    root = write_euroc(tmp_path / "MH", rough)
    change, remark = BAD_TRUTH[fault]
    edit_lines(root / TRUTH, change)
    drive = open_dataset(root)
    assert drive.remarks == (f"state_groundtruth_estimate0/data.csv: {remark}",)
    assert drive.ground_truth is not None
    np.testing.assert_allclose(drive.ground_truth, rough.truth, atol=2e-3)  # one pose is interpolated


def test_a_tum_truth_with_a_header_and_a_copy_is_used(tmp_path: Path, rough: Taken) -> None:
    root = write_tum_rgbd(tmp_path / "freiburg3", rough)
    rows = (root / "groundtruth.txt").read_text().splitlines()
    header = "timestamp tx ty tz qx qy qz qw"
    (root / "groundtruth.txt").write_text("\n".join([header, *rows[:3], rows[2], "", *rows[3:]]))
    drive = open_for_odometry(DatasetSpec(root), mono=True)
    assert drive.remarks == (
        "freiburg3/groundtruth.txt: 1 lines with the time of another line are left out, the first is line 5",
    )
    np.testing.assert_allclose(drive.ground_truth, np.linalg.inv(rough.poses[0]) @ rough.poses, atol=1e-5)


@pytest.mark.parametrize(("ticks", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
def test_images_and_truth_may_count_in_different_units(tmp_path: Path, rough: Taken, ticks: float, unit: str) -> None:
    root = write_tum_rgbd(tmp_path / "freiburg3", rough)
    rows = [line.split() for line in (root / "groundtruth.txt").read_text().splitlines()]
    (root / "groundtruth.txt").write_text("\n".join(" ".join([f"{float(r[0]) * ticks:.0f}", *r[1:]]) for r in rows))
    drive = open_dataset(root)
    assert drive.remarks == (f"freiburg3/groundtruth.txt: the times are read as {unit}",)
    assert drive.ground_truth is not None
    assert len(drive) == 5


def test_a_table_of_euroc_in_seconds_is_read_in_seconds(tmp_path: Path, rough: Taken) -> None:
    root = write_euroc(tmp_path / "MH", rough)
    for path in (CAM0, CAM1):
        edit_lines(
            root / path, lambda rows: [f"{int(row.split(',')[0]) / 1e9:.6f},{row.split(',')[1]}" for row in rows]
        )
    remarks = [f"cam{k}/data.csv: the times are read as seconds" for k in (0, 1)]
    assert open_dataset(root).remarks == tuple(remarks)
    assert open_dataset(root).timestamps[0] == pytest.approx(rough.times[0])


def test_poses_that_are_counted_are_no_times(tmp_path: Path, rough: Taken) -> None:
    folder = write_folders(tmp_path / "mine", rough, fps=RATE, ground_truth="poses.txt")
    rows = [line.split() for line in write_tum_rgbd(tmp_path / "x", rough).joinpath("groundtruth.txt").open()]
    (folder / "poses.txt").write_text("\n".join(" ".join([str(k), *row[1:]]) for k, row in enumerate(rows)))
    drive = open_dataset(folder)
    assert drive.ground_truth is None
    assert "expected a time in seconds in each line, found 1, 2, 3, ... for images 0.05 s apart" in drive.remarks[0]


def test_poses_in_other_columns_are_named(tmp_path: Path, rough: Taken) -> None:
    folder = write_folders(tmp_path / "mine", rough, fps=RATE, ground_truth="poses.txt")
    (folder / "poses.txt").write_text("time x y z\n" + "0 1 2 3 0 0 0\n" * len(rough.poses))
    drive = open_dataset(folder)
    assert drive.ground_truth is None
    assert "poses.txt: expected KITTI poses (12 numbers a line) or TUM (8), found 7; export one" in drive.remarks[0]


@pytest.mark.parametrize(
    ("times", "expected", "found"),
    [
        ([0, 33, 67, 100], 1.0, 1e3),
        ([0, 33_333, 66_667], 1.0, 1e6),
        ([0, 33_333_333, 66_666_667], 1.0, 1e9),
        ([0.0, 0.033, 0.067], 1.0, 1.0),
        ([5000.0, 5000.1, 5000.2], 1.0, 1.0),  # a clock that began with the robot
        ([1.7e9, 1.7e9 + 60, 1.7e9 + 120], 1.0, 1.0),  # a picture a minute, with dates
        ([1.7e18], 1.0, 1e9),
        ([1.4e15, 1.4e15 + 2e5, 1.4e15 + 4e5], 1e9, 1e6),  # microseconds at 5 Hz where nanoseconds are expected
        ([3.6e12, 3.6e12 + 5e7, 3.6e12 + 1e8], 1e9, 1e9),  # an hour after the start, not a year
        ([], 1e9, 1e9),
        (list(range(0, 3000, 10)), 1.0, 1e3),  # 100 Hz: hundreds of images 10 s apart are rarer
        (list(range(0, 1500, 5)), 1.0, 1e3),
        (list(range(0, 300, 10)), 1.0, 1.0),
        (list(range(300)), 1.0, 1.0),  # a picture a second
        (list(range(1_600_000_000, 1_600_003_000, 10)), 1.0, 1.0),  # with dates
    ],
)
def test_the_unit_of_times_is_found_by_step_and_date(times: list[float], expected: float, found: float) -> None:
    assert find_ticks_per_second(np.array(times, float), expected) == found


def test_a_recording_may_begin_at_zero_and_a_clock_may_not() -> None:
    path = Path("a/times")
    assert order_by_time(path, np.array([0.0, 0.1, 0.2]), 1.0, [1, 2, 3]).rows.tolist() == [0, 1, 2]
    late = order_by_time(path, np.array([0.0, 1.6e9, 0.0, 1.6e9 + 0.1]), 1.0, [1, 2, 3, 4])
    assert (late.rows.tolist(), late.remarks) == (
        [1, 3],
        ("a/times: 2 lines without a time are left out, the first is line 1",),
    )


def test_finely_measured_truth_covers_the_images(rough: Taken) -> None:
    assert len(finely(rough)[0]) == 41  # the count that "reversed" above depends on


@pytest.mark.parametrize(
    ("count", "step_s", "remark"),
    [
        (300, 0.01, "a/times.txt: the times are read as milliseconds; if they are seconds, give --fps instead"),
        (30, 10.0, "a/times.txt: the times are read as seconds; if they are milliseconds, divide them by 1000"),
    ],
)
def test_times_in_steps_of_10_are_never_taken_in_silence(
    tmp_path: Path, count: int, step_s: float, remark: str
) -> None:
    path = tmp_path / "a" / "times.txt"
    path.parent.mkdir()
    path.write_text("".join(f"{10 * k}\n" for k in range(count)))
    times, remarks = read_times(path, count)
    np.testing.assert_allclose(np.diff(times), step_s)
    assert remarks == (remark,)


def test_times_with_decimal_commas_are_named(tmp_path: Path) -> None:
    (tmp_path / "times.txt").write_text("0\n0,033\n")
    with pytest.raises(DataError, match=r"times\.txt, line 2: expected decimal points, found decimal commas, '0,033'"):
        read_times(tmp_path / "times.txt", 2)


@pytest.mark.parametrize("write", [write_euroc, write_tum_rgbd])
def test_a_few_listed_images_that_are_missing_are_left_out(tmp_path: Path, write: Callable[..., Path]) -> None:
    drive = taken("radtan", 12)
    root = write(tmp_path / "freiburg1", drive)
    whole = open_images(DatasetSpec(root))
    table = next(path for path in (root / "mav0/cam0/data.csv", root / "rgb.txt") if path.is_file())
    files = sorted((root / "mav0/cam0/data" if write is write_euroc else root / "rgb").glob("*.png"))
    files[5].unlink()
    images = open_images(DatasetSpec(root))
    place = f"{table.parent.name}/{table.name}"
    assert f"{place}: 1 of 12 listed images are missing and left out, the first is {files[5].name}" in images.remarks
    np.testing.assert_array_equal(images.timestamps, np.delete(whole.timestamps, 5))
    np.testing.assert_array_equal(images[5], whole[6])
    files[7].unlink()
    with pytest.raises(
        DataError, match=rf"{table.name}: expected the image .*{files[5].name}, which .* 2 of 12 listed"
    ):
        open_images(DatasetSpec(root))
