"""Reading a record for people: values with their notes, the loops' fates, the time of each stage."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from slam.record import LoopRow, RunRecord

MISSING = "\N{EN DASH}"


def value(metrics: Mapping[str, object], key: str) -> object | None:
    """Look up a value by its dotted key, such as `odometry.ate_m`; None where it is absent, null or NaN."""
    found: object = metrics
    for part in key.split("."):
        found = found.get(part) if isinstance(found, Mapping) else None
    return None if isinstance(found, float) and not math.isfinite(found) else found


def note(metrics: Mapping[str, object], key: str) -> str:
    """Why a value could not be computed: the note on its dotted key or on the nearest group, or empty."""
    notes = metrics.get("notes")
    if not isinstance(notes, Mapping):
        return ""
    parts = key.split(".")
    names = [".".join(parts[:n]) for n in range(len(parts), 0, -1)] + [parts[-1]]
    return next((str(notes[name]) for name in names if notes.get(name)), "")


def scaled(metrics: Mapping[str, object], name: str) -> bool:
    """Whether the estimate of this name was aligned with a scale, as that of one camera is."""
    return "sim" in str(value(metrics, f"{name}.ate_alignment")).lower()


def alignment(metrics: Mapping[str, object], name: str) -> str:
    """Name the alignment of an estimate's ATE as papers write it."""
    return "Sim(3)" if scaled(metrics, name) else "SE(3)"


def text(found: object | None, digits: int = 2, unit: str = "") -> str:
    """Write a value for people: numbers with so many digits after the point, None as a dash."""
    if found is None or (isinstance(found, float) and not math.isfinite(found)):
        return MISSING
    if isinstance(found, bool):
        return "yes" if found else "no"
    if isinstance(found, float):
        return f"{found:.{digits}f}{unit}"
    return f"{found}{unit}"


def kept(record: RunRecord) -> list[LoopRow]:
    """Loops that stand in the corrected graph."""
    return [row for row in record.loops if row.in_graph]


def rejected(record: RunRecord) -> list[LoopRow]:
    """Return matches that the recogniser took for revisits and geometry or the back end turned down."""
    return [row for row in record.loops if row.accepted and not row.in_graph]


def verdict(row: LoopRow) -> str:
    """How far a ledger row got, in one word: kept, dropped (by the back end), unverified or unlikely."""
    if row.in_graph:
        return "kept"
    if row.verified:
        return "dropped"
    return "unverified" if row.accepted else "unlikely"


@dataclass(frozen=True)
class StageTime:
    """Time of one stage of the chain.

    Attributes:
        name: of the stage.
        median, p99: milliseconds over the frames in which it ran.
        share: of the whole time, 0 to 1.
    """

    name: str
    median: float
    p99: float
    share: float


def stage_times(record: RunRecord) -> list[StageTime]:
    """Time of each stage in the order of the chain; a stage that never ran is left out."""
    stages = {name: ms[np.isfinite(ms) & (ms > 0)] for name, ms in record.stage_ms.items() if name != "total"}
    whole = sum(float(ms.sum()) for ms in stages.values()) or 1.0
    return [
        StageTime(name, float(np.median(ms)), float(np.percentile(ms, 99)), float(ms.sum()) / whole)
        for name, ms in stages.items()
        if len(ms)
    ]
