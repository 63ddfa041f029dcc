"""Values of a record as the cells of tables."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from slam.record import LoopRow, RunRecord
from slam.report.reading import alignment, note, text, value
from slam.report.tables import ERRORS


@dataclass(frozen=True)
class Cell:
    """A value in a table.

    Attributes:
        text: as shown.
        note: why there is none; empty where there is one.
        order: what a column is sorted by.
    """

    text: str
    note: str = ""
    order: float | str = ""


@dataclass(frozen=True)
class Estimate:
    """One row of the table of errors.

    Attributes:
        name: odometry, online or corrected.
        alignment: of its ATE.
        cells: ATE, then `ERRORS` in order.
    """

    name: str
    alignment: str
    cells: list[Cell]


def cell(record: RunRecord, key: str, digits: int = 2, unit: str = "") -> Cell:
    """Return the value of a dotted key of the metrics with its note."""
    found = value(record.metrics, key)
    missing = "" if found is not None else note(record.metrics, key) or "not computed"
    return Cell(text(found, digits, unit), missing)


def estimate(record: RunRecord, name: str) -> Estimate:
    """The errors of one estimate by its name."""
    cells = [cell(record, f"{name}.{key}") for key in ("ate_m", *ERRORS)]
    return Estimate(name, alignment(record.metrics, name), cells)


def ledger_cells(row: LoopRow) -> list[Cell]:
    """The numbers of a row of the ledger, and its truth last."""
    truth = None if row.truth is None else ("true" if row.truth else "false")
    numbers = [
        Cell(str(row.query), order=row.query),
        Cell(str(row.match), order=row.match),
        _number(row.score, 3),
        Cell(str(row.matches), order=row.matches),
        Cell(str(row.inliers), order=row.inliers),
        _number(row.weight, 2),
        _number(row.residual, 2),
    ]
    return [*numbers, Cell(text(truth), order=truth or "")]


def _number(found: float, digits: int) -> Cell:
    if not math.isfinite(found):
        return Cell(text(None))
    return Cell(f"{found:.{digits}f}", order=found)


def flat(nested: Mapping[str, object], prefix: str = "") -> list[tuple[str, str]]:
    """Nested values by their dotted names."""
    rows: list[tuple[str, str]] = []
    for key, found in nested.items():
        if isinstance(found, Mapping):
            rows += flat(found, f"{prefix}{key}.")
        else:
            rows.append((f"{prefix}{key}", text(found, 6) if found is None else str(found)))
    return rows


def origin(record: RunRecord) -> list[tuple[str, str]]:
    """Where the numbers come from."""
    plain = [(key, text(value(record.metrics, key))) for key in ("source", "sequence", "seed", "command")]
    versions = record.metrics.get("versions")
    return plain + (flat(versions, "version of ") if isinstance(versions, Mapping) else [])
