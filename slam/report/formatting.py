"""Values of a run's record as text: cells and rows of the report's tables, and the summary for the terminal."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from rich.markup import escape
from rich.table import Table

from slam.run_result import LoopRow, RunRecord

MISSING = "\N{EN DASH}"
_MIN_STATIC_RATIO = 0.0005  # of the image area, to be mentioned: less is not seen in the rounded share
ESTIMATES = ("odometry", "online", "corrected")
ERRORS = {
    "t_rel_percent": "t_rel [%]",
    "r_rel_deg_per_100m": "r_rel [deg/100 m]",
    "end_error_m": "end error [m]",
    "end_error_percent": "end error [%]",
}


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


@dataclass(frozen=True)
class StageTime:
    """Time of one stage of the pipeline.

    Attributes:
        name: name of the stage.
        median, p99: median and 99th percentile over the frames in which it ran, milliseconds.
        share: share of the total time, 0 to 1.
    """

    name: str
    median: float
    p99: float
    share: float


def metric_value(metrics: Mapping[str, object], key: str) -> object | None:
    """Return the value of a dotted key, such as `odometry.ate_m`; None if it is absent, null or NaN."""
    found: object = metrics
    for part in key.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return None if isinstance(found, float) and not math.isfinite(found) else found


def find_note(metrics: Mapping[str, object], key: str) -> str:
    """Return why a value is missing: the note on its dotted key or on the nearest group, else an empty text."""
    notes = metrics.get("notes")
    if not isinstance(notes, Mapping):
        return ""
    parts = key.split(".")
    names = [".".join(parts[:n]) for n in range(len(parts), 0, -1)] + [parts[-1]]
    return next((str(notes[name]) for name in names if notes.get(name)), "")


def is_scaled(metrics: Mapping[str, object], name: str) -> bool:
    """Return whether the estimate of this name was aligned with a scale, as monocular estimates are."""
    return "sim" in str(metric_value(metrics, f"{name}.ate_alignment")).lower()


def alignment_name(metrics: Mapping[str, object], name: str) -> str:
    """Return the name of the alignment of an estimate's ATE, as papers write it."""
    return "Sim(3)" if is_scaled(metrics, name) else "SE(3)"


def format_value(found: object | None, digits: int = 2, unit: str = "") -> str:
    """Return a value as text: a float with `digits` decimals, None and NaN as a dash."""
    if found is None or (isinstance(found, float) and not math.isfinite(found)):
        return MISSING
    if isinstance(found, bool):
        return "yes" if found else "no"
    if isinstance(found, float):
        return f"{found:.{digits}f}{unit}"
    return f"{found}{unit}"


def kept(record: RunRecord) -> list[LoopRow]:
    """Return the loops that are in the corrected graph."""
    return [row for row in record.loops if row.in_graph]


def rejected(record: RunRecord) -> list[LoopRow]:
    """Return the matches that the recogniser accepted and geometry or the back end rejected."""
    return [row for row in record.loops if row.accepted and not row.in_graph]


def loop_outcome(row: LoopRow) -> str:
    """Return the outcome of a row in one word: kept, dropped (by the back end), unverified or unlikely."""
    if row.in_graph:
        return "kept"
    if row.verified:
        return "dropped"
    return "unverified" if row.accepted else "unlikely"


def stage_times(record: RunRecord) -> list[StageTime]:
    """Return the time of each stage in the order of the pipeline; stages that never ran are left out."""
    stages = {name: ms[np.isfinite(ms) & (ms > 0)] for name, ms in record.stage_ms.items() if name != "total"}
    whole = sum(float(ms.sum()) for ms in stages.values()) or 1.0
    return [
        StageTime(name, float(np.median(ms)), float(np.percentile(ms, 99)), float(ms.sum()) / whole)
        for name, ms in stages.items()
        if len(ms)
    ]


def summary_table(record: RunRecord) -> Table:
    """Summarise a run: errors of the three estimates, loops, speed. Unknown values are dashes."""
    table = Table(title=escape(record.name), caption=_caption(record), caption_justify="left")
    table.add_column("")
    for heading in ("ATE [m]", *ERRORS.values()):
        table.add_column(escape(heading), justify="right")
    for name in ESTIMATES:
        ate = format_value(metric_value(record.metrics, f"{name}.ate_m"))
        errors = [format_value(metric_value(record.metrics, f"{name}.{key}")) for key in ERRORS]
        table.add_row(name, ate, *errors)
    return table


def _caption(record: RunRecord) -> str:
    def text(key: str, digits: int = 2) -> str:
        return format_value(metric_value(record.metrics, key), digits)

    known = [name for name in ESTIMATES if metric_value(record.metrics, f"{name}.ate_m") is not None]
    alignments = sorted({alignment_name(record.metrics, name) for name in known})
    loops = ", ".join(f"{text(f'loops.{key}')} {key}" for key in ("proposed", "verified", "kept"))
    truth = ", ".join(f"{text(f'loops.{key}')} {key}" for key in ("true", "false"))
    recall = text("places.recall_at_100_precision", 3)
    stages = ", ".join(f"{stage.name} {stage.median:.1f}" for stage in stage_times(record))
    lines = [
        f"ATE after {' and '.join(alignments)} alignment of all poses" if known else "no ground truth",
        f"loops: {loops}; by ground truth {truth}",
        describe_loop_errors(record.metrics),
        describe_motions(record.metrics),
        f"places: R@P100 {recall}" if recall != MISSING else "",
        _events_and_delay(record),
        describe_static_ratio(record.metrics),
        f"{len(record.timestamps)} frames, {text('frames_per_second', 1)} per second",
        "\n".join(f"not the default: {setting}" for setting in changed_settings_text(record.metrics)),
        f"median ms per frame: {stages}" if stages else "",
    ]
    return escape("\n".join(line for line in lines if line))


def changed_settings_text(metrics: Mapping[str, object]) -> list[str]:
    """Return the settings that differ from the defaults, one line for each."""
    changed = metrics.get("changed_settings")
    if not isinstance(changed, Mapping):
        return []
    return [f"{name} = {each['value']} (default {each['default']})" for name, each in changed.items()]


def describe_loop_errors(metrics: Mapping[str, object]) -> str:
    """Return the errors of the kept loops by ground truth, in words; empty where they are not known."""
    quantities = (("translation_error_m", "m"), ("rotation_error_deg", "deg"))
    found = [(metric_value(metrics, f"loops.{name}"), unit) for name, unit in quantities]
    texts = [
        " / ".join(format_value(values[key], 3) for key in ("median", "p95", "max")) + f" {unit}"
        for values, unit in found
        if isinstance(values, Mapping)
    ]
    return f"error of the kept loops, median / 95 % / max: {', '.join(texts)}" if texts else ""


def _events_and_delay(record: RunRecord) -> str:
    names = ("events.found", "events.count", "delay_frames.median")
    found, count, delay = (metric_value(record.metrics, f"places.{name}") for name in names)
    events = "" if count is None else f"revisit events: {format_value(found)} of {format_value(count)} found"
    late = "" if delay is None else f"an answer comes {format_value(delay, 0)} images late (median)"
    return "; ".join(text for text in (events, late) if text)


def describe_motions(metrics: Mapping[str, object]) -> str:
    """Return how many motions were measured and how many predicted, and mostly why; empty where that is not known."""
    measured, predicted = (metric_value(metrics, f"motions.{name}") for name in ("measured", "predicted"))
    if not isinstance(measured, int) or not isinstance(predicted, int):
        return ""
    counts = f"{measured} of {measured + predicted} motions measured, {predicted} predicted"
    return f"{counts}, mostly: {metric_value(metrics, 'motions.commonest_reason')}" if predicted else counts


def describe_static_ratio(metrics: Mapping[str, object]) -> str:
    """Return the share of the images that was left out as static, in words; empty where there was none."""
    ratio = metric_value(metrics, "static_ratio")
    if not isinstance(ratio, float) or ratio < _MIN_STATIC_RATIO:
        return ""
    return f"{100 * ratio:.1f} % of the image area never changes while the camera moves, and is left out"


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
