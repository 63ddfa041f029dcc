"""The report of a run: one HTML file that opens anywhere, offline."""

import base64
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from numpy.typing import NDArray

from slam.errors import OutputError
from slam.record import DriveRecord, LoopRow
from slam.report.charts import error_over_way, inliers_per_frame, time_per_stage
from slam.report.figures import plan_view
from slam.report.reading import alignment, kept, note, rejected, stage_times, text, value, verdict
from slam.report.svg import inline_svg
from slam.report.tables import ERRORS, ESTIMATES

ImageSource = Callable[[int], NDArray[np.uint8] | None]
"""The left image (H, W) uint8 of a frame, or None where it is not at hand."""

_TEMPLATES = Path(__file__).with_name("templates")
_PAIRS = 3  # loops shown with their images
_PAIR_WIDTH = 620  # pixels


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


@dataclass(frozen=True)
class Picture:
    """A figure with its words.

    Attributes:
        title, caption: what it shows, and how to read it.
        svg: the drawing.
    """

    title: str
    caption: str
    svg: Markup


@dataclass(frozen=True)
class Pair:
    """A loop with its images.

    Attributes:
        row: of the ledger.
        query, match: images as data URIs.
    """

    row: LoopRow
    query: str
    match: str


def write_report(
    record: DriveRecord,
    path: Path,
    images: ImageSource | None = None,
    config: Mapping[str, object] | None = None,
) -> None:
    """Write the report of a run.

    Args:
        record: of the drive.
        path: the HTML file.
        images: gives the images of some closed loops; without it the page has none.
        config: the configuration, nested.

    Raises:
        OutputError: the file cannot be written.
    """
    page = render(record, images, config or {})
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot write the report ({error.strerror}); choose another folder") from error


def render(record: DriveRecord, images: ImageSource | None, config: Mapping[str, object]) -> str:
    """Return the page as text; everything that is not ours is escaped by the template engine."""
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    return environment.get_template("report.html.jinja").render(
        record=record,
        verdict=_verdict(record),
        facts=_facts(record),
        headings=list(ERRORS.values()),
        estimates=[_estimate(record, name) for name in ESTIMATES],
        notes=_notes(record),
        funnel=[(key, cell(record, f"loops.{key}", 2)) for key in _FUNNEL],
        places=[(name, cell(record, f"places.{key}", 3)) for key, name in _PLACES.items()],
        maps=_maps(record),
        charts=_charts(record),
        stages=stage_times(record),
        pairs=[] if images is None else _pairs(record, images),
        counts={"kept": len(kept(record)), "rejected": len(rejected(record))},
        ledger=[(row, verdict(row), _ledger_cells(row)) for row in record.loops],
        settings=_flat(config),
        origin=_origin(record),
    )


def cell(record: DriveRecord, key: str, digits: int = 2, unit: str = "") -> Cell:
    """Return the value of a dotted key of the metrics with its note."""
    found = value(record.metrics, key)
    missing = "" if found is not None else note(record.metrics, key) or "not computed"
    return Cell(text(found, digits, unit), missing)


_FUNNEL = ("proposed", "verified", "kept", "true", "false", "precision", "recall")

_PLACES = {"recall_at_100_precision": "R@P100", "average_precision": "average precision"}


def _verdict(record: DriveRecord) -> str:
    closed = len(kept(record))
    loops = f"{closed} loop{'' if closed == 1 else 's'} closed" if closed else "No loop closed"
    before, after = (value(record.metrics, f"{name}.ate_m") for name in ("odometry", "corrected"))
    if before is None or after is None:
        return f"{loops}."
    return f"{loops}. Position error (ATE) {text(before, 2, ' m')} before, {text(after, 2, ' m')} after."


def _facts(record: DriveRecord) -> list[tuple[str, Cell]]:
    return [
        ("frames", Cell(str(len(record.timestamps)))),
        ("way driven", cell(record, "path_length_m", 1, " m")),
        ("frames a second", cell(record, "frames_per_second", 1)),
        ("wall time", cell(record, "wall_seconds", 1, " s")),
        ("peak memory", cell(record, "peak_memory_mb", 0, " MB")),
        ("predicted motions", Cell(str(int(np.count_nonzero(record.predicted))))),
    ]


def _estimate(record: DriveRecord, name: str) -> Estimate:
    cells = [cell(record, f"{name}.{key}") for key in ("ate_m", *ERRORS)]
    return Estimate(name, alignment(record.metrics, name), cells)


def _notes(record: DriveRecord) -> list[tuple[str, str]]:
    notes = record.metrics.get("notes")
    return [(str(key), str(why)) for key, why in notes.items()] if isinstance(notes, Mapping) else []


def _maps(record: DriveRecord) -> list[Picture]:
    named = (
        (
            "odometry",
            "Before: odometry alone",
            "Each step adds its error, so the map of a second visit lies askew.",
        ),
        ("corrected", "After: loops closed", "Recognised places pull the trajectory and its map together."),
    )
    pictures = []
    for name, title, caption in named:
        ate = cell(record, f"{name}.ate_m", 2, " m")
        told = (
            f"ATE {ate.text}, {alignment(record.metrics, name)} alignment. " if record.ground_truth is not None else ""
        )
        drawn = inline_svg(plan_view(record, name), f"map-{name}", f"Plan view, {title}. {told}")
        pictures.append(Picture(title, told + caption, drawn))
    return pictures


def _charts(record: DriveRecord) -> list[Picture]:
    drawn = (
        (
            "error",
            "Position error over the way",
            "Distance from the ground truth after alignment.",
            error_over_way,
        ),
        (
            "inliers",
            "Inlier tracks",
            "Tracks that agreed with the motion, frame by frame.",
            inliers_per_frame,
        ),
        ("stages", "Time for each stage", "Half of the frames took less than the bar.", time_per_stage),
    )
    figures = [(name, title, caption, draw(record)) for name, title, caption, draw in drawn]
    return [
        Picture(title, caption, inline_svg(figure, f"chart-{name}", f"{title}. {caption}"))
        for name, title, caption, figure in figures
        if figure is not None
    ]


def _pairs(record: DriveRecord, images: ImageSource) -> list[Pair]:
    rows = kept(record)
    chosen = [rows[k] for k in sorted({round(k) for k in np.linspace(0, len(rows) - 1, _PAIRS)})] if rows else []
    found = [(row, images(row.query), images(row.match)) for row in chosen]
    return [Pair(row, _uri(a), _uri(b)) for row, a, b in found if a is not None and b is not None]


def _uri(image: NDArray[np.uint8]) -> str:
    scale = min(1.0, _PAIR_WIDTH / image.shape[1])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 80])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


def _ledger_cells(row: LoopRow) -> list[Cell]:
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


def _flat(nested: Mapping[str, object], prefix: str = "") -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for key, found in nested.items():
        if isinstance(found, Mapping):
            rows += _flat(found, f"{prefix}{key}.")
        else:
            rows.append((f"{prefix}{key}", text(found, 6) if found is None else str(found)))
    return rows


def _origin(record: DriveRecord) -> list[tuple[str, str]]:
    plain = [(key, text(value(record.metrics, key))) for key in ("source", "sequence", "seed", "command")]
    versions = record.metrics.get("versions")
    return plain + (_flat(versions, "version of ") if isinstance(versions, Mapping) else [])
