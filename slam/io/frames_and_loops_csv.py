"""The CSV tables of a run.

`frames.csv` has a line for each frame, `loops.csv` is the loop log with a line for each belief, `loop_stages.csv` has
the measurements of each stage, and `loop_events.csv` the decisions of the online pose graph about verified loops.
Unknown values (None, NaN) are empty cells, truth values are `true` and `false`, numbers keep every digit.
"""

import csv
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from slam.errors import DataError
from slam.io.files import atomic_writer
from slam.run_result import LoopEventRow, LoopRow, StageRow

Array = NDArray[np.float64]

LOOP_COLUMNS = tuple(field.name for field in fields(LoopRow))
STAGE_COLUMNS = tuple(field.name for field in fields(StageRow))
EVENT_COLUMNS = tuple(field.name for field in fields(LoopEventRow))
FRAME_COLUMNS = ("frame", "timestamp", "status", "reason", "inliers", "tracks", "residual_px")
_STAGE_SUFFIX = "_ms"


@dataclass(frozen=True)
class FrameTable:
    """The motion estimate of each frame, and the time of each stage.

    Attributes:
        timestamps: times, (N,), seconds.
        predicted: whether the motion was extrapolated instead of measured, (N,) bool.
        reasons: reasons of the prediction, N texts; empty for measured motions.
        inliers: counts of tracks that agree with the motion, (N,) int.
        tracks: counts of all tracks, (N,) int.
        residual_px: root mean square reprojection error of the inliers, (N,), pixels; NaN for predicted motions.
        stage_ms: milliseconds of each stage, (N,); NaN for frames in which it did not run.
    """

    timestamps: Array
    predicted: NDArray[np.bool_]
    reasons: tuple[str, ...]
    inliers: NDArray[np.int64]
    tracks: NDArray[np.int64]
    residual_px: Array
    stage_ms: Mapping[str, Array]

    def __len__(self) -> int:
        return len(self.timestamps)


def write_frames(path: Path, table: FrameTable) -> None:
    """Write frames.csv: FRAME_COLUMNS, then `<stage>_ms` for every stage, its blanks as underscores.

    Raises:
        OutputError: the file cannot be written.
    """
    status = ["predicted" if predicted else "measured" for predicted in table.predicted]
    columns = [table.timestamps, status, table.reasons, table.inliers, table.tracks, table.residual_px]
    columns += table.stage_ms.values()
    header = FRAME_COLUMNS + tuple(stage.replace(" ", "_") + _STAGE_SUFFIX for stage in table.stage_ms)
    write_table(path, header, zip(range(len(table)), *map(_to_list, columns), strict=True))


def read_frames(path: Path) -> FrameTable:
    """Read frames.csv.

    Raises:
        DataError: the file is missing, columns are missing, or a cell cannot be read.
    """
    header, rows = _read(path, FRAME_COLUMNS)
    stages = [name for name in header if name.endswith(_STAGE_SUFFIX)]

    def column(name: str, read: Callable[[str], object], kind: type) -> NDArray[Any]:
        return np.array([_cell(path, row, name, read) for row in rows], dtype=kind)

    return FrameTable(
        timestamps=column("timestamp", _float, float),
        predicted=column("status", lambda cell: {"predicted": True, "measured": False}[cell], bool),
        reasons=tuple(row["reason"] for row in rows),
        inliers=column("inliers", _integer, np.int64),
        tracks=column("tracks", _integer, np.int64),
        residual_px=column("residual_px", _float, float),
        stage_ms={name.removesuffix(_STAGE_SUFFIX): column(name, _float, float) for name in stages},
    )


def write_loops(path: Path, loops: Iterable[LoopRow]) -> None:
    """Write loops.csv, one line for each row of the loop log.

    Raises:
        OutputError: the file cannot be written.
    """
    write_table(path, LOOP_COLUMNS, map(astuple, loops))


def read_loops(path: Path) -> tuple[LoopRow, ...]:
    """Read loops.csv.

    Raises:
        DataError: the file is missing, columns are missing, or a cell cannot be read.
    """
    return _rows(path, LoopRow)


def write_stages(path: Path, stages: Iterable[StageRow]) -> None:
    """Write loop_stages.csv, one line for each row of the loop log.

    Raises:
        OutputError: the file cannot be written.
    """
    write_table(path, STAGE_COLUMNS, map(astuple, stages))


def read_stages(path: Path) -> tuple[StageRow, ...]:
    """Read loop_stages.csv.

    Raises:
        DataError: the file is missing, columns are missing, or a cell cannot be read.
    """
    return _rows(path, StageRow)


def write_events(path: Path, events: Iterable[LoopEventRow]) -> None:
    """Write loop_events.csv, one line for each decision of the online pose graph about a loop.

    Raises:
        OutputError: the file cannot be written.
    """
    write_table(path, EVENT_COLUMNS, map(astuple, events))


def read_events(path: Path) -> tuple[LoopEventRow, ...]:
    """Read loop_events.csv.

    Raises:
        DataError: the file is missing, columns are missing, or a cell cannot be read.
    """
    return _rows(path, LoopEventRow)


_Row = TypeVar("_Row", LoopRow, StageRow, LoopEventRow)
_LATER_COLUMNS = ("translation_error_m", "rotation_error_deg")  # runs of earlier versions have none


def _rows(path: Path, kind: type[_Row]) -> tuple[_Row, ...]:
    """Return all lines of a table whose columns are the fields of a row class."""
    names = tuple(field.name for field in fields(kind) if field.name not in _LATER_COLUMNS)
    return tuple(kind(**_cells(path, row, kind)) for row in _read(path, names)[1])  # type: ignore[arg-type]


def _cells(path: Path, row: dict[str, str], kind: type[_Row]) -> dict[str, object]:
    readers: dict[object, Callable[[str], object]] = {
        int: int,
        int | None: lambda cell: int(cell) if cell else None,
        float: _float,
        bool: _bool,
        bool | None: lambda cell: _bool(cell) if cell else None,
        str: str,
    }
    written = (field for field in fields(kind) if field.name in row or field.name not in _LATER_COLUMNS)
    return {field.name: _cell(path, row, field.name, readers[field.type]) for field in written}


def _to_list(column: object) -> list[object]:
    return column.tolist() if isinstance(column, np.ndarray) else list(column)  # type: ignore[call-overload]


def write_table(path: Path, header: Sequence[str], rows: Iterable[Iterable[object]]) -> None:
    """Write a table as CSV; cells as described in the module's docstring.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_writer(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([_text(value) for value in row] for row in rows)


def _text(value: object) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(float(value))
    return " ".join(str(value).splitlines())  # one line per row, for grep and for readers that cannot parse line breaks


def _read(path: Path, columns: Sequence[str]) -> tuple[Sequence[str], list[dict[str, str]]]:
    try:
        with path.open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file, restval="", strict=True)
            rows, header = list(reader), reader.fieldnames or ()
    except (OSError, ValueError, csv.Error) as error:
        raise DataError(f"{path}: expected a table of a run, found {error}; run again") from None
    missing = [name for name in columns if name not in header]
    if missing:
        raise DataError(f"{path}: expected the columns {', '.join(columns)}, found no {missing[0]}; run again")
    return header, rows


def _cell(path: Path, row: dict[str, str], name: str, read: Callable[[str], object]) -> object:
    try:
        return read(row[name])
    except (KeyError, ValueError):
        where, cell = str(next(iter(row.values())))[:40], str(row.get(name))[:40]
        raise DataError(f"{path}, row {where}: expected {name} as a run writes it, found {cell!r}; run again") from None


def _integer(cell: str) -> int:
    value = int(cell)
    if abs(value) > np.iinfo(np.int64).max:
        raise ValueError(f"{cell}: beyond all bounds")
    return value


def _float(cell: str) -> float:
    return float(cell) if cell else math.nan


def _bool(cell: str) -> bool:
    return {"true": True, "false": False}[cell]
