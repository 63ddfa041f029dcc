"""The figures of many runs side by side: rows, files and the table for the terminal."""

import shlex
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import asdict, astuple, dataclass, fields, replace
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.table import Table

from slam.benchmark.job import Job, Outcome
from slam.report.reading import format_value, metric_value
from slam.storage.metrics import write_metrics
from slam.storage.tables import write_table


@dataclass(frozen=True)
class Row:
    """One run of a benchmark, a line of `results.csv`; None for what is not known.

    Attributes:
        run: its name, and its folder's below `jobs`.
        source, paradigm, robust, seed: what it is a run of.
        frames: of the drive.
        path_length_m: of the way.
        odometry_ate_m, ate_m: root mean square position error before and after loops were closed, all poses aligned.
        t_rel_percent, r_rel_deg_per_100m: after, by the KITTI rule.
        loops_kept, loops_false: in the corrected graph, and those of them that are wrong.
        recall_at_100_precision, average_precision: of the recogniser by itself.
        frames_per_second, wall_seconds: of this run, while others ran beside it.
        peak_memory_mb: of the process, which may have done other runs before.
        error: why it failed; empty where it did not.
    """

    run: str
    source: str
    paradigm: str
    robust: str
    seed: int
    frames: object = None
    path_length_m: object = None
    odometry_ate_m: object = None
    ate_m: object = None
    t_rel_percent: object = None
    r_rel_deg_per_100m: object = None
    loops_kept: object = None
    loops_false: object = None
    recall_at_100_precision: object = None
    average_precision: object = None
    frames_per_second: object = None
    wall_seconds: object = None
    peak_memory_mb: object = None
    error: str = ""


# Where each value stands in metrics.json.
_KEYS = {
    "frames": "frames",
    "path_length_m": "path_length_m",
    "odometry_ate_m": "odometry.ate_m",
    "ate_m": "corrected.ate_m",
    "t_rel_percent": "corrected.t_rel_percent",
    "r_rel_deg_per_100m": "corrected.r_rel_deg_per_100m",
    "loops_kept": "loops.kept",
    "loops_false": "loops.false",
    "recall_at_100_precision": "places.recall_at_100_precision",
    "average_precision": "places.average_precision",
    "frames_per_second": "frames_per_second",
    "wall_seconds": "wall_seconds",
    "peak_memory_mb": "peak_memory_mb",
}

# What people read of a row: the field, its heading, digits after the point.
SHOWN = (
    ("odometry_ate_m", "odometry ATE [m]", 2),
    ("ate_m", "ATE [m]", 2),
    ("t_rel_percent", "t_rel [%]", 2),
    ("loops_kept", "loops", 0),
    ("loops_false", "false", 0),
    ("recall_at_100_precision", "R@P100", 3),
    ("frames_per_second", "frames/s", 1),
)

_WIDE = ("t_rel_percent", "frames_per_second")  # not in a terminal, where the names need the room


def make_row(job: Job, outcome: Outcome) -> Row:
    """What a table says of a job."""
    found = {name: metric_value(outcome.metrics, key) for name, key in _KEYS.items()}
    return Row(job.name, job.source_name, job.paradigm, job.robust, job.seed, error=outcome.error, **found)


def told(row: Row) -> str:
    """A row in one line."""
    if row.error:
        return f"{row.run}: failed: {row.error}"
    loops = f"{format_value(row.loops_kept)} loops kept, {format_value(row.loops_false)} of them false"
    recall = f"R@P100 {format_value(row.recall_at_100_precision, 3)}"
    ate = f"ATE {format_value(row.odometry_ate_m)} m by odometry, {format_value(row.ate_m)} m corrected"
    return f"{row.run}: {ate}; {loops}; {recall}"


def write_csv(folder: Path, rows: Iterable[Row]) -> None:
    """Write results.csv, a line for each row.

    Raises:
        OutputError: the file cannot be written.
    """
    write_table(folder / "results.csv", [field.name for field in fields(Row)], map(astuple, rows))


def write_json(folder: Path, rows: Iterable[Row], command: Sequence[str]) -> None:
    """Write results.json, an object for each row.

    Raises:
        OutputError: the file cannot be written.
    """
    runs = [asdict(row) for row in rows]
    write_metrics(folder / "results.json", {"command": shlex.join(["revisit", *command]), "runs": runs})


def medians(rows: Sequence[Row]) -> list[tuple[Row, int]]:
    """Rows that differ in their seed alone as one, with the median of each number and how many they are.

    Failed runs have no numbers, and are left out.
    """
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        if not row.error:
            groups.setdefault((row.source, row.paradigm, row.robust), []).append(row)
    return [(_median(group), len(group)) for group in groups.values()]


def _median(group: Sequence[Row]) -> Row:
    found: dict[str, Any] = {name: _middle([getattr(row, name) for row in group]) for name in _KEYS}
    return replace(group[0], **found)


def _middle(values: Sequence[object]) -> object:
    numbers = [number for number in values if isinstance(number, int | float)]
    return statistics.median(numbers) if numbers else None


def summary(rows: Sequence[Row]) -> Table:
    """The rows as a table for the terminal. What is not known is a dash."""
    table = Table(caption="ATE after alignment of all poses", caption_justify="left", box=None)
    table.add_column("run", overflow="fold")
    columns = [column for column in SHOWN if column[0] not in _WIDE]
    for _, heading, _ in columns:
        table.add_column(escape(heading), justify="right")
    for row in rows:
        table.add_row(escape(row.run), *(format_value(getattr(row, name), digits) for name, _, digits in columns))
    return table


def shown(row: Row) -> list[str]:
    """The numbers of a row as people read them, in the order of `SHOWN`."""
    return [format_value(getattr(row, name), digits) for name, _, digits in SHOWN]
