"""Values of a record as text: metrics with their notes, outcomes of loops, time of each stage."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from slam.record import LoopRow, RunRecord

MISSING = "\N{EN DASH}"


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


def stage_times(record: RunRecord) -> list[StageTime]:
    """Return the time of each stage in the order of the pipeline; stages that never ran are left out."""
    stages = {name: ms[np.isfinite(ms) & (ms > 0)] for name, ms in record.stage_ms.items() if name != "total"}
    whole = sum(float(ms.sum()) for ms in stages.values()) or 1.0
    return [
        StageTime(name, float(np.median(ms)), float(np.percentile(ms, 99)), float(ms.sum()) / whole)
        for name, ms in stages.items()
        if len(ms)
    ]
