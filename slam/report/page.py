"""The report of a run: one HTML file that opens anywhere, offline."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from slam.errors import OutputError
from slam.record import RunRecord
from slam.report.cells import Cell, cell, estimate, flat, ledger_cells, origin
from slam.report.evidence import ImageSource, evidence, some_pairs
from slam.report.pictures import charts, maps, places
from slam.report.reading import kept, rejected, stage_times, text, value, verdict
from slam.report.tables import ERRORS, ESTIMATES

_TEMPLATES = Path(__file__).with_name("templates")


def write_report(
    record: RunRecord,
    path: Path,
    images: ImageSource | None = None,
    config: Mapping[str, object] | None = None,
) -> None:
    """Write the report of a run.

    Args:
        record: of the drive.
        path: the HTML file.
        images: gives the images of the loops, from several threads at once; without it the page has none.
        config: the configuration, nested.

    Raises:
        OutputError: the file cannot be written.
    """
    page = render(record, images, config or {})
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot write the report ({error.strerror}); choose another folder") from error


def _no_image(_frame: int) -> None:
    """Have no image at hand (an ImageSource)."""


def environment() -> Environment:
    """Where our pages come from; what is not ours is escaped in them."""
    found = Environment(
        loader=FileSystemLoader(_TEMPLATES), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    found.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "ensure_ascii": False}
    return found


def render(record: RunRecord, images: ImageSource | None, config: Mapping[str, object]) -> str:
    """Return the page as text; everything that is not ours is escaped by the template engine."""
    source = images or _no_image
    return (
        environment()
        .get_template("report.html.jinja")
        .render(
            record=record,
            verdict=_verdict(record),
            facts=_facts(record),
            headings=list(ERRORS.values()),
            estimates=[estimate(record, name) for name in ESTIMATES],
            notes=_notes(record),
            funnel=[(key, cell(record, f"loops.{key}", 2)) for key in _FUNNEL],
            recall=[(name, cell(record, f"places.{key}", 3)) for key, name in _PLACES.items()],
            maps=maps(record),
            places=places(record),
            charts=charts(record),
            stages=[(stage, cell(record, f"memory_mb.{stage.name}", 1)) for stage in stage_times(record)],
            pairs=some_pairs(kept(record), source),
            counts={"kept": len(kept(record)), "rejected": len(rejected(record))},
            ledger=[(row, verdict(row), ledger_cells(row)) for row in record.loops],
            evidence=evidence(record, source),
            settings=flat(config),
            origin=origin(record),
        )
    )


_FUNNEL = ("proposed", "verified", "kept", "true", "false", "precision", "recall")

_PLACES = {"recall_at_100_precision": "R@P100", "average_precision": "average precision"}


def _verdict(record: RunRecord) -> str:
    closed = len(kept(record))
    loops = f"{closed} loop{'' if closed == 1 else 's'} closed" if closed else "No loop closed"
    before, after = (value(record.metrics, f"{name}.ate_m") for name in ("odometry", "corrected"))
    if before is None or after is None:
        return f"{loops}."
    return f"{loops}. Position error (ATE) {text(before, 2, ' m')} before, {text(after, 2, ' m')} after."


def _facts(record: RunRecord) -> list[tuple[str, Cell]]:
    return [
        ("frames", Cell(str(len(record.timestamps)))),
        ("way driven", cell(record, "path_length_m", 1, " m")),
        ("frames a second", cell(record, "frames_per_second", 1)),
        ("wall time", cell(record, "wall_seconds", 1, " s")),
        ("peak memory", cell(record, "peak_memory_mb", 0, " MB")),
        ("predicted motions", Cell(str(int(np.count_nonzero(record.predicted))))),
    ]


def _notes(record: RunRecord) -> list[tuple[str, str]]:
    notes = record.metrics.get("notes")
    return [(str(key), str(why)) for key, why in notes.items()] if isinstance(notes, Mapping) else []
