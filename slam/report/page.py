"""The report of a run: one self-contained HTML file that opens offline."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from slam.errors import OutputError
from slam.record import RunRecord
from slam.report.cells import Cell, cell, estimate_row, flatten, loop_cells, provenance_rows
from slam.report.evidence import ImageSource, example_pairs, loop_details
from slam.report.pictures import draw_charts, draw_maps, draw_places
from slam.report.reading import format_value, kept, loop_outcome, metric_value, rejected, stage_times
from slam.report.tables import ERRORS, ESTIMATES

DENSE_PAGE = "dense.html"  # written beside the report by `revisit dense`
_TEMPLATES = Path(__file__).with_name("templates")
_FUNNEL = ("proposed", "verified", "kept", "true", "false", "precision", "recall")
_PLACES = {"recall_at_100_precision": "R@P100", "average_precision": "average precision"}


def write_report(
    record: RunRecord,
    path: Path,
    images: ImageSource | None = None,
    config: Mapping[str, object] | None = None,
    dense_page: str | None = None,
) -> None:
    """Write the report of a run.

    Args:
        record: record of the run.
        path: the HTML file to write.
        images: source of the images of loops, called from several threads at once; without it the page has none.
        config: the configuration, as nested mappings.
        dense_page: file name of the page of the dense map, which the report links to; None for runs that have no depth.

    Raises:
        OutputError: the file cannot be written.
    """
    page = render_report(record, images, config or {}, dense_page)
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot write the report ({error.strerror}); choose another folder") from error


def _no_image(_frame: int) -> None:
    """Return no image (an ImageSource)."""


def template_environment() -> Environment:
    """Return the template engine of our pages; it escapes every text that is put into them."""
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":"), "ensure_ascii": False}
    return environment


def render_report(
    record: RunRecord, images: ImageSource | None, config: Mapping[str, object], dense_page: str | None = None
) -> str:
    """Return the page as text; see `write_report`."""
    source = images or _no_image
    return (
        template_environment()
        .get_template("report.html.jinja")
        .render(
            record=record,
            headline=_headline(record),
            facts=_facts(record),
            headings=list(ERRORS.values()),
            estimates=[estimate_row(record, name) for name in ESTIMATES],
            notes=_notes(record),
            funnel=[(key, cell(record, f"loops.{key}", 2)) for key in _FUNNEL],
            recall=[(name, cell(record, f"places.{key}", 3)) for key, name in _PLACES.items()],
            maps=draw_maps(record),
            places=draw_places(record),
            charts=draw_charts(record),
            stages=[(stage, cell(record, f"memory_mb.{stage.name}", 1)) for stage in stage_times(record)],
            pairs=example_pairs(kept(record), source),
            counts={"kept": len(kept(record)), "rejected": len(rejected(record))},
            loop_log=[(row, loop_outcome(row), loop_cells(row)) for row in record.loops],
            loop_details=loop_details(record, source),
            dense_page=dense_page,
            settings=flatten(config),
            provenance=provenance_rows(record),
        )
    )


def _headline(record: RunRecord) -> str:
    closed = len(kept(record))
    loops = f"{closed} loop{'' if closed == 1 else 's'} closed" if closed else "No loop closed"
    before, after = (metric_value(record.metrics, f"{name}.ate_m") for name in ("odometry", "corrected"))
    if before is None or after is None:
        return f"{loops}."
    before, after = format_value(before, 2, " m"), format_value(after, 2, " m")
    return f"{loops}. Position error (ATE) {before} before, {after} after."


def _facts(record: RunRecord) -> list[tuple[str, Cell]]:
    return [
        ("frames", Cell(str(len(record.timestamps)))),
        ("distance travelled", cell(record, "path_length_m", 1, " m")),
        ("frames per second", cell(record, "frames_per_second", 1)),
        ("wall time", cell(record, "wall_seconds", 1, " s")),
        ("peak memory", cell(record, "peak_memory_mb", 0, " MB")),
        ("predicted motions", Cell(str(int(np.count_nonzero(record.predicted))))),
    ]


def _notes(record: RunRecord) -> list[tuple[str, str]]:
    notes = record.metrics.get("notes")
    return [(str(key), str(why)) for key, why in notes.items()] if isinstance(notes, Mapping) else []
