"""Trajectories of other programs: KITTI, TUM and EuRoC's csv, with or without a header, in whatever order.

What cannot be a pose is left out, times are put in order and into seconds, and a remark says so: a tracker writes nan
while it is lost, several sessions are written one after the other, recorders count nanoseconds or milliseconds. KITTI's
poses have no times; there a line stands for an image, so none may be left out.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.errors import DataError
from slam.io.files import PassedOver, check_decimal_points, read_lines
from slam.io.trajectory_files import kitti_poses, tum_poses

Array = NDArray[np.float64]

_KITTI_COLUMNS, _TUM_COLUMNS = 12, 8
_TUM_ORDER = (0, 1, 2, 3, 4, 5, 6, 7)  # time, position, quaternion with w last
_EUROC_ORDER = (0, 1, 2, 3, 5, 6, 7, 4)  # EuRoC has w first
_MIN_QUATERNION = 1e-6  # shorter ones have no direction
# Units of time, by the size of a time since 1970 (seconds reach 1e11 in the year 5138), else by the usual step: poses
# more than 10 s apart are no trajectory, so such steps are counted in something smaller than seconds.
_UNITS_BY_TIME = ((1e17, 1e9, "nanoseconds"), (1e14, 1e6, "microseconds"), (1e11, 1e3, "milliseconds"))
_UNITS_BY_STEP = ((3e6, 1e9, "nanoseconds"), (3e3, 1e6, "microseconds"), (10.5, 1e3, "milliseconds"))
_ORIENTATION = r"q|rot|orient"  # how names of the columns of a quaternion begin
_NO_POSE = "without a pose (nan, or a quaternion of length zero)"


@dataclass(frozen=True)
class Trajectory:
    """Poses T_world_camera (or of a vehicle's body) of a file.

    Attributes:
        times: (N,) seconds, increasing; None for poses without times.
        poses: (N, 4, 4), metres, in the order of their times; without times in the file's.
        remarks: what was left out or changed, a sentence each.
        num_left_out: lines that are not among the poses.
    """

    times: Array | None
    poses: Array
    remarks: tuple[str, ...] = ()
    num_left_out: int = 0


@dataclass
class _PoseTable:
    """The numbers of a file.

    Attributes:
        path: the file.
        has_commas: whether commas or semicolons separate the cells.
        header: names of the columns; empty if there are none.
        rows: cells of each line.
        lines: number of each line in the file.
    """

    path: Path
    has_commas: bool = False
    header: list[str] = field(default_factory=list)
    rows: list[list[float]] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)

    @property
    def numbers(self) -> Array:
        """All cells (N, columns)."""
        return np.array(self.rows, np.float64)


def read_trajectory(path: Path) -> Trajectory:
    """Read KITTI poses, TUM or EuRoC's csv, told apart by the columns.

    Raises:
        DataError: the file is missing, has other columns or a damaged line, or no pose.
    """
    table = _read_table(path)
    columns = len(table.rows[0]) if table.rows else 0
    order = _order_of_columns(table, columns)
    if order is not None:
        return _timed(table, order)
    if columns == _KITTI_COLUMNS:
        _check_finite(table)
        return Trajectory(None, kitti_poses(path, table.numbers))
    raise DataError(
        f"{path}: expected KITTI poses (12 numbers a line) or TUM (8), found {columns}; export one of them,"
        " or EuRoC's csv"
    )


def _read_table(path: Path) -> _PoseTable:
    table, words_seen = _PoseTable(path), False
    for number, line in enumerate(read_lines(path), start=1):
        text = line.strip()
        if text.startswith("#"):
            table.header = table.header if table.rows else _cells(text.lstrip("# "))
            continue
        if len(text.split()) > 1 or ";" in text:  # else commas separate the cells
            check_decimal_points(path, number, text)
        cells = _cells(text)
        if not any(cells):
            continue
        if not table.rows and not words_seen and not any(map(_is_number, cells)):
            table.header, words_seen = cells, True  # as pandas writes it, without #
            continue
        _add_row(table, number, text, cells)
    return table


def _cells(text: str) -> list[str]:
    if "," in text or ";" in text:
        return re.split(r"\s*[,;]\s*", text.rstrip(",; \t"))
    return text.split()


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _add_row(table: _PoseTable, number: int, text: str, cells: list[str]) -> None:
    columns = len(table.rows[0]) if table.rows else len(cells)
    expected = f"{table.path}, line {number}: expected {columns} finite number{'s' if columns > 1 else ''}"
    if len(cells) != columns:
        raise DataError(
            f"{expected} as in the lines before, found {len(cells)}; copy the file again or remove the line"
        )
    if not all(map(_is_number, cells)):
        remedy = "copy the file again" if table.rows else "put # before a header"
        raise DataError(f"{expected}, found {text[:60]!r}; {remedy}")
    table.has_commas = "," in text or ";" in text
    table.rows.append([float(cell) for cell in cells])
    table.lines.append(number)


def _check_finite(table: _PoseTable) -> None:
    for row in np.flatnonzero(~np.isfinite(table.numbers).all(axis=1))[:1]:
        raise DataError(
            f"{table.path}, line {table.lines[row]}: expected {_KITTI_COLUMNS} finite numbers, found nan or inf;"
            " correct that line, or export poses with times (TUM)"
        )


def _order_of_columns(table: _PoseTable, columns: int) -> tuple[int, ...] | None:
    """Return the columns of time, x, y, z, qx, qy, qz and qw; None for a table that has no times."""
    named = _named_order(table.header) if len(table.header) == columns else None
    if named is not None:
        return named
    if table.has_commas and columns >= _TUM_COLUMNS and table.rows[0][0] >= _UNITS_BY_TIME[0][0]:
        return _EUROC_ORDER
    return _TUM_ORDER if columns == _TUM_COLUMNS else None


def _named_order(header: list[str]) -> tuple[int, ...] | None:
    """Return the order that the names of the columns state, if they name a quaternion."""
    names = [re.sub(r"\[.*?\]", "", name).strip().lower() for name in header]
    quaternion = [_column(names, rf"({_ORIENTATION}).*{axis}") for axis in "xyzw"]
    if None in quaternion:
        return None
    position = [_column(names, rf"(?!{_ORIENTATION}).*{axis}") for axis in "xyz"]
    time = _column(names, r".*(time|stamp).*")
    found = [0 if time is None else time, *([1, 2, 3] if None in position else position), *quaternion]
    order = tuple(column for column in found if column is not None)
    return order if len(set(order)) == _TUM_COLUMNS else None


def _column(names: list[str], pattern: str) -> int | None:
    return next((k for k, name in enumerate(names) if re.fullmatch(pattern, name)), None)


def _timed(table: _PoseTable, order: tuple[int, ...]) -> Trajectory:
    rows = table.numbers[:, list(order)]
    passed_over = PassedOver()
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers that are left out, or refused later
        is_pose = np.isfinite(rows).all(axis=1) & (np.linalg.norm(rows[:, 4:], axis=1) >= _MIN_QUATERNION)
    for row in np.flatnonzero(~is_pose):
        passed_over.add(_NO_POSE, table.lines[row])
    if not is_pose.any():
        raise DataError(f"{table.path}: expected poses, found {passed_over.describe(_NO_POSE)}; export them again")
    lines, rows = np.array(table.lines)[is_pose], rows[is_pose]
    times, scaled = _in_seconds(rows[:, 0])
    scaled = [] if table.has_commas else scaled  # csv files count nanoseconds, by the format
    kept, sorted_remark = _increasing(times, lines, passed_over)
    remarks = [f"passed over {passed_over.describe(what)}" for what in passed_over.names()]
    remarks = [*_describe_order(table, order), *scaled, *sorted_remark, *remarks]
    return Trajectory(
        times=times[kept],
        poses=tum_poses(table.path, rows[kept, 1:]),
        remarks=tuple(f"{table.path}: {remark}" for remark in remarks),
        num_left_out=len(table.rows) - len(kept),
    )


def _describe_order(table: _PoseTable, order: tuple[int, ...]) -> list[str]:
    """Say which order of the quaternion was assumed where the file does not say it and two are in use."""
    if not table.has_commas or _named_order(table.header) is not None:
        return []
    first = "w first, as EuRoC has it" if order == _EUROC_ORDER else "w last, as TUM has it"
    return [f"no header names the columns of the quaternion; it is read with {first}"]


def _in_seconds(times: Array) -> tuple[Array, list[str]]:
    """Return times (N,) in seconds, and a remark where they were in another unit."""
    steps = np.diff(np.unique(times))
    sizes = (
        (float(np.median(np.abs(times))), _UNITS_BY_TIME),
        (float(np.median(steps)) if len(steps) else 0.0, _UNITS_BY_STEP),
    )
    for size, units in sizes:
        for limit, per_second, name in units:
            if size >= limit:
                return times / per_second, [f"the times are {name} and were divided by {per_second:g}"]
    return times, []


def _increasing(times: Array, lines: NDArray[np.int64], passed_over: PassedOver) -> tuple[NDArray[np.int64], list[str]]:
    """Return the rows in the order of time, each time once, and a remark where the file has another order."""
    order = np.argsort(times, kind="stable")
    is_copy = np.append(False, np.diff(times[order]) == 0)
    for row in np.sort(order[is_copy]):
        passed_over.add("with the time of an earlier line", int(lines[row]))
    backward = np.flatnonzero(np.diff(times) < 0)
    remarks = []
    if len(backward):
        first = lines[backward[0] + 1]
        lines_are = "lines are" if len(backward) > 1 else "line is"
        remarks = [
            f"sorted by time, as {len(backward)} {lines_are} earlier than the one before (first in line {first})"
        ]
    return order[~is_copy], remarks
