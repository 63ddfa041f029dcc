"""Values of a run's record as the cells and rows of the report's tables."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from slam.record import LoopRow, RunRecord
from slam.report.reading import alignment_name, find_note, format_value, metric_value
from slam.report.tables import ERRORS


@dataclass(frozen=True)
class Cell:
    """A value in a table.

    Attributes:
        text: text that is shown.
        note: reason why the value is missing; empty if it is there.
        order: key by which its column is sorted.
    """

    text: str
    note: str = ""
    order: float | str = ""


@dataclass(frozen=True)
class Estimate:
    """One row of the table of trajectory errors.

    Attributes:
        name: `odometry`, `online` or `corrected`.
        alignment: alignment of its ATE.
        cells: ATE, then the errors in the order of `ERRORS`.
    """

    name: str
    alignment: str
    cells: list[Cell]


def cell(record: RunRecord, key: str, digits: int = 2, unit: str = "") -> Cell:
    """Return the value of a dotted key of the metrics, with the reason if it is missing."""
    found = metric_value(record.metrics, key)
    missing = "" if found is not None else find_note(record.metrics, key) or "not computed"
    return Cell(format_value(found, digits, unit), missing)


def estimate_row(record: RunRecord, name: str) -> Estimate:
    """Return the errors of the estimate of a name."""
    cells = [cell(record, f"{name}.{key}") for key in ("ate_m", *ERRORS)]
    return Estimate(name, alignment_name(record.metrics, name), cells)


def loop_cells(row: LoopRow) -> list[Cell]:
    """Return the numbers of a row of the loop log, and its ground truth last."""
    truth = None if row.truth is None else ("true" if row.truth else "false")
    numbers = [
        Cell(str(row.query), order=row.query),
        Cell(str(row.match), order=row.match),
        _number_cell(row.score, 3),
        Cell(str(row.matches), order=row.matches),
        Cell(str(row.inliers), order=row.inliers),
        _number_cell(row.weight, 2),
        _number_cell(row.residual, 2),
    ]
    return [*numbers, Cell(format_value(truth), order=truth or "")]


def _number_cell(found: float, digits: int) -> Cell:
    if not math.isfinite(found):
        return Cell(format_value(None))
    return Cell(f"{found:.{digits}f}", order=found)


def flatten(nested: Mapping[str, object], prefix: str = "") -> list[tuple[str, str]]:
    """Flatten nested values to pairs of dotted name and text."""
    rows: list[tuple[str, str]] = []
    for key, found in nested.items():
        if isinstance(found, Mapping):
            rows += flatten(found, f"{prefix}{key}.")
        else:
            rows.append((f"{prefix}{key}", format_value(found, 6) if found is None else str(found)))
    return rows


def provenance_rows(record: RunRecord) -> list[tuple[str, str]]:
    """Return source, seed, command and versions: what is needed to make the run again."""
    plain = [
        (key, format_value(metric_value(record.metrics, key))) for key in ("source", "sequence", "seed", "command")
    ]
    versions = record.metrics.get("versions")
    return plain + (flatten(versions, "version of ") if isinstance(versions, Mapping) else [])
