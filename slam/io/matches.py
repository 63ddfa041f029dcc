"""Files of place recognition: `matches.csv`, `precision_recall.csv`, `matrix.npz`; loops of other programs."""

import csv
import io
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from place_recognition.evaluation.precision_recall import PrecisionRecall
from place_recognition.recognizer import Belief, StageScores
from slam.errors import DataError
from slam.io.files import atomic_writer, read_text
from slam.io.frames_and_loops_csv import write_table

MATCH_COLUMNS = (
    "query",
    "match",
    "score",
    "accepted",
    "inliers",
    "verified",
    "probability",
    "candidates",
    "own_score",
    "geometry_match",
    "geometry_score",
    "answered_at",
)
CURVE_COLUMNS = ("threshold", "precision", "recall", "true_positives", "false_positives")
_NEEDED = MATCH_COLUMNS[:3]
_POSE_COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
_MIN_QUATERNION = 1e-6  # shorter ones have no direction


@dataclass(frozen=True)
class ProposedLoop:
    """A loop that another program proposes.

    Attributes:
        belief: query, match and score; accepted, unless the file says otherwise.
        T_match_query: (4, 4) query camera in the match camera's frame, metres; None where the file has no pose.
    """

    belief: Belief
    T_match_query: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class ProposedLoops:
    """The loops of a file.

    Attributes:
        by_query: the loops of each query, the surest first, in the order of the queries.
        remarks: what was left out or assumed, a sentence each.
    """

    by_query: dict[int, tuple[ProposedLoop, ...]]
    remarks: tuple[str, ...] = ()

    @property
    def best(self) -> dict[int, tuple[ProposedLoop, ...]]:
        """The surest loop of each query alone."""
        return {query: loops[:1] for query, loops in self.by_query.items()}


def write_matches(path: Path, beliefs: Iterable[Belief]) -> None:
    """Write matches.csv, a line for each belief; what is missing or not known is an empty cell.

    Raises:
        OutputError: the file cannot be written.
    """
    write_table(path, MATCH_COLUMNS, map(_row, beliefs))


def write_curve(path: Path, curve: PrecisionRecall | None) -> None:
    """Write precision_recall.csv, a line for each threshold, descending; without a curve only the header.

    Raises:
        OutputError: the file cannot be written.
    """
    columns: list[list[object]] = [[] for _ in CURVE_COLUMNS]
    if curve is not None:
        arrays = (curve.thresholds, curve.precision, curve.recall, curve.true_positives, curve.false_positives)
        columns = [list(array.tolist()) for array in arrays]
    write_table(path, CURVE_COLUMNS, zip(*columns, strict=True))


def write_matrix(path: Path, arrays: Mapping[str, NDArray[np.generic]]) -> None:
    """Write matrix.npz, compressed: the same arrays give the same bytes, as numpy dates no entry.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_writer(path, "wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def read_matches(path: Path) -> tuple[Belief, ...]:
    """Read beliefs, by query, from matches.csv or any table with the columns query, match and score, in any case.

    A table without the column accepted or verified counts all its matches as such; what the other columns hold is not
    known where they are missing.

    Raises:
        DataError: the file is missing, columns are missing, a cell is not a number, a match or candidate is not earlier
            than its query, an answer is, or a query has two lines.
    """
    beliefs: dict[int, Belief] = {}
    for number, row in _rows(path):
        belief = _belief(f"{path}, line {number}", row)
        if belief.query in beliefs:
            raise DataError(
                f"{path}, line {number}: expected one line for each query, found a second for {belief.query};"
                " keep the best"
            )
        beliefs[belief.query] = belief
    return tuple(beliefs[query] for query in sorted(beliefs))


def read_proposed_loops(path: Path) -> ProposedLoops:
    """Read the loops that another program proposes, in any order.

    A table with the columns query and match, and perhaps score, and the pose of the query camera in the match camera's
    frame as x, y, z, qx, qy, qz, qw. A query may have several lines. A matches.csv of `revisit` may be given as well:
    what it does not accept is not proposed.

    Raises:
        DataError: as `read_matches`, or a pose is incomplete or no pose.
    """
    found: dict[int, list[ProposedLoop]] = {}
    rows, has_score = _rows(path, MATCH_COLUMNS[:2]), False
    for number, row in rows:
        where = f"{path}, line {number}"
        has_score = has_score or bool(row.get("score"))
        loop = ProposedLoop(_belief(where, row | {"score": row.get("score") or "1"}), _pose(where, row))
        found.setdefault(loop.belief.query, []).append(loop)
    remarks = [] if has_score or not rows else ["no column score: all proposals count as equally sure"]
    by_query = {query: tuple(sorted(found[query], key=lambda loop: -loop.belief.score)) for query in sorted(found)}
    return ProposedLoops(by_query, tuple(f"{path}: {remark}" for remark in remarks))


def _pose(where: str, row: dict[str, str]) -> NDArray[np.float64] | None:
    """Read T_match_query (4, 4) of a line; None where its cells are empty."""
    given = [name for name in _POSE_COLUMNS if row.get(name)]
    if not given:
        return None
    missing = [name for name in _POSE_COLUMNS if name not in given]
    if missing:
        raise DataError(f"{where}: expected a pose x, y, z, qx, qy, qz, qw, found no {missing[0]}; complete that line")
    values = np.array([_number(where, row, name) for name in _POSE_COLUMNS])
    if np.linalg.norm(values[3:]) < _MIN_QUATERNION:
        raise DataError(f"{where}: expected a quaternion, found one of length zero; correct that line")
    T_match_query = np.eye(4)
    T_match_query[:3, :3] = Rotation.from_quat(values[3:]).as_matrix()
    T_match_query[:3, 3] = values[:3]
    return T_match_query


def _rows(path: Path, needed: tuple[str, ...] = _NEEDED) -> list[tuple[int, dict[str, str]]]:
    try:
        lines = io.StringIO(read_text(path), newline="")
        separator = _separator(lines.readline())
        lines.seek(0)
        reader = csv.DictReader(lines, restval="", strict=True, skipinitialspace=True, delimiter=separator)
        reader.fieldnames = header = [name.strip().lower() for name in reader.fieldnames or ()]
        rows = [(reader.line_num, row) for row in reader]
    except FileNotFoundError:
        raise DataError(f"{path}: expected a table of matches, found none; check the path") from None
    except (OSError, ValueError, csv.Error) as error:
        raise DataError(f"{path}: expected a table of matches (CSV), found {error}; write it again") from None
    missing = [name for name in needed if name not in header]
    if missing:
        found = ", ".join(header) or "an empty file"
        raise DataError(f"{path}: expected the columns {', '.join(needed)}, found {found[:80]}; name them in line 1")
    return rows


def _separator(header: str) -> str:
    """Return what separates the names of the columns: spreadsheets of many countries write semicolons."""
    return max(",;\t", key=header.count)  # of equally many the first


def _row(belief: Belief) -> list[object]:
    stages = belief.stages
    return [
        *(getattr(belief, name) for name in MATCH_COLUMNS[:7]),
        " ".join(map(str, stages.candidates)),
        stages.own_score,
        stages.geometry_match,
        stages.geometry_score,
        belief.answered_at,
    ]


def _belief(where: str, row: dict[str, str]) -> Belief:
    query = _index(where, row, "query")
    match, answered_at = _earlier(where, row, "match", query), _optional_index(where, row, "answered_at")
    if answered_at is not None and answered_at < query:
        raise DataError(f"{where}: expected answered_at from query {query} on, found {answered_at}; correct that line")
    verified = _truth_value(where, row, "verified")
    return Belief(
        query=query,
        match=match,
        score=_number(where, row, "score") if match is not None else 0.0,
        accepted=match is not None and verified and _truth_value(where, row, "accepted"),
        inliers=_optional_index(where, row, "inliers"),
        verified=verified,
        probability=_probability(where, row),
        stages=StageScores(
            candidates=tuple(
                _check_earlier(where, "candidate", _whole(where, "candidates", cell), query)
                for cell in (row.get("candidates") or "").split()
            ),
            own_score=_number(where, row, "own_score") if row.get("own_score") else None,
            geometry_match=_earlier(where, row, "geometry_match", query),
            geometry_score=_number(where, row, "geometry_score") if row.get("geometry_score") else None,
        ),
        answered_at=answered_at,
    )


def _earlier(where: str, row: dict[str, str], name: str, query: int) -> int | None:
    """Read the id of an image earlier than the query; None for an empty cell."""
    found = _optional_index(where, row, name)
    return None if found is None else _check_earlier(where, name, found, query)


def _check_earlier(where: str, name: str, found: int, query: int) -> int:
    if found >= query:
        raise DataError(f"{where}: expected a {name} earlier than query {query}, found {found}; swap or correct them")
    return found


def _optional_index(where: str, row: dict[str, str], name: str) -> int | None:
    return _index(where, row, name) if row.get(name) else None


def _index(where: str, row: dict[str, str], name: str) -> int:
    return _whole(where, name, row[name])


def _whole(where: str, name: str, cell: str) -> int:
    try:
        value = float(cell)  # other programs write 12.0
    except ValueError:
        value = -1.0
    if not (value >= 0 and math.isfinite(value) and value.is_integer()):
        raise DataError(f"{where}: expected {name} to be a whole number from 0, found {cell!r}; correct that line")
    return int(value)


def _probability(where: str, row: dict[str, str]) -> float | None:
    if not row.get("probability"):
        return None
    value = _number(where, row, "probability")
    if not 0.0 <= value <= 1.0:
        raise DataError(f"{where}: expected a probability from 0 to 1, found {value:g}; correct that line")
    return value


def _number(where: str, row: dict[str, str], name: str) -> float:
    try:
        value = float(row[name])
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise DataError(f"{where}: expected a finite {name}, found {row[name]!r}; correct that line")
    return value


def _truth_value(where: str, row: dict[str, str], name: str) -> bool:
    cell = (row.get(name) or "true").strip().lower()
    values = {"true": True, "false": False, "1": True, "0": False}
    if cell not in values:
        raise DataError(f"{where}: expected {name} to be true or false, found {row[name]!r}; correct that line")
    return values[cell]
