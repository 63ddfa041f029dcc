"""The report of a run: one self-contained HTML file that opens offline, with tables, figures and the loop log."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from slam.errors import OutputError
from slam.report.charts import draw_error_over_distance, draw_inliers, draw_stage_times
from slam.report.formatting import (
    ERRORS,
    ESTIMATES,
    Cell,
    alignment_name,
    cell,
    changed_settings_text,
    describe_loop_errors,
    estimate_row,
    flatten,
    format_value,
    kept,
    loop_cells,
    loop_outcome,
    metric_value,
    provenance_rows,
    rejected,
    stage_times,
)
from slam.report.interactive_map import blend_data, draw_interactive_map, map_data
from slam.report.loop_details import ImageSource, example_pairs, loop_details, select_rows
from slam.report.place_recognition_figures import plot_matrix, plot_precision_recall, stage_curves, stage_figures
from slam.report.style import inline_svg
from slam.run_result import RunRecord

DENSE_PAGE = "dense.html"  # written beside the report by `revisit dense`
_TEMPLATES = Path(__file__).with_name("templates")
# Keys of the loops in metrics.json, from proposed to kept, and of place recognition, with its headings.
_FUNNEL = ("proposed", "verified", "kept", "true", "false", "precision", "recall")
_PLACES = {"recall_at_100_precision": "R@P100", "average_precision": "average precision"}
_MAP_WORDS = {
    "odometry": ("Before: odometry alone", "Each step adds an error, so places that are visited again do not fit."),
    "corrected": ("After: loops closed", "Closed loops pull trajectory and map into agreement."),
}
_MATRIX_TITLES = {"similarity": "Matrix of similarities or votes", "filtered": "Matrix after its filter"}


@dataclass(frozen=True)
class Picture:
    """A figure with title and caption.

    Attributes:
        title, caption: heading and explanation.
        svg: the drawing.
        data: data for zooming and for naming frames, see `map_data`; empty for figures without.
    """

    title: str
    caption: str
    svg: Markup
    data: Mapping[str, object] = field(default_factory=dict)


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
    shown = replace(record, loops=select_rows(record.loops))
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
            warnings=_warnings(record),
            funnel=[(key, cell(record, f"loops.{key}", 2)) for key in _FUNNEL],
            loop_errors=describe_loop_errors(record.metrics),
            recall=[(name, cell(record, f"places.{key}", 3)) for key, name in _PLACES.items()],
            maps=draw_maps(record),
            blend=blend_data(record),
            places=draw_places(record),
            charts=draw_charts(record),
            stages=[(stage, cell(record, f"memory_mb.{stage.name}", 1)) for stage in stage_times(record)],
            pairs=example_pairs(kept(record), source),
            counts={"kept": len(kept(record)), "rejected": len(rejected(record))},
            loop_log=[(row, loop_outcome(row), loop_cells(row)) for row in shown.loops],
            num_loops=len(record.loops),
            loop_details=loop_details(shown, source),
            dense_page=dense_page,
            settings=flatten(config),
            changed=changed_settings_text(record.metrics),
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
        ("motions measured", cell(record, "motions.measured")),
        ("motions predicted", _predicted(record)),
        ("static image area", _static_area(record)),
    ]


def _predicted(record: RunRecord) -> Cell:
    reason = metric_value(record.metrics, "motions.commonest_reason")
    return Cell(str(int(np.count_nonzero(record.predicted))), f"mostly: {reason}" if reason else "")


def _static_area(record: RunRecord) -> Cell:
    ratio = metric_value(record.metrics, "static_ratio")
    return Cell(f"{100 * ratio:.1f} %") if isinstance(ratio, float) else cell(record, "static_ratio")


def _notes(record: RunRecord) -> list[tuple[str, str]]:
    notes = record.metrics.get("notes")
    return [(str(key), str(why)) for key, why in notes.items()] if isinstance(notes, Mapping) else []


def _warnings(record: RunRecord) -> list[str]:
    warnings = record.metrics.get("warnings")
    return list(map(str, warnings)) if isinstance(warnings, list) else []


def draw_maps(record: RunRecord) -> list[Picture]:
    """Draw the plan views of odometry alone and of the corrected trajectory."""
    return [_draw_map(record, name, title, caption) for name, (title, caption) in _MAP_WORDS.items()]


def _draw_map(record: RunRecord, name: str, title: str, caption: str) -> Picture:
    accuracy = ""
    if record.ground_truth is not None:
        ate = cell(record, f"{name}.ate_m", 2, " m").text
        accuracy = f"ATE {ate}, {alignment_name(record.metrics, name)} alignment. "
    figure = draw_interactive_map(record, name)
    svg = inline_svg(figure, f"map-{name}", f"Plan view, {title}. {accuracy}")
    return Picture(title, accuracy + caption, svg, map_data(record, name, figure))


def draw_charts(record: RunRecord) -> list[Picture]:
    """Draw position error, inlier tracks and the time of each stage over the run."""
    drawn = (
        (
            "error",
            "Position error over distance",
            "Distance from the ground truth after alignment.",
            draw_error_over_distance,
        ),
        ("inliers", "Inlier tracks", "Tracks that agree with the motion of their frame.", draw_inliers),
        ("stages", "Time for each stage", "Bars are medians: half of the frames took less.", draw_stage_times),
    )
    figures = [(f"chart-{name}", title, caption, draw(record)) for name, title, caption, draw in drawn]
    return [_picture(name, title, caption, figure) for name, title, caption, figure in figures if figure is not None]


def draw_places(record: RunRecord) -> list[Picture]:
    """Draw the precision-recall curve of the recogniser, if there is ground truth, and its matrices."""
    pictures = []
    if record.curve is not None:
        full = record.curve.recall_at_full_precision
        caption = f"The circle marks R@P100 = {full:.3f}: the highest recall at which no detection is false."
        curves = stage_curves(record.place_stages, None) or {"all thresholds": record.curve}
        pictures.append(_picture("places-curve", "Precision over recall", caption, plot_precision_recall(curves, "")))
    pictures += [
        _picture(f"places-{name}", title, caption, figure)
        for name, title, caption, figure in stage_figures(record.place_stages, record.reliability)
    ]
    for stage, matrix in record.matrices.items():
        title = _MATRIX_TITLES.get(stage, stage)
        caption = "A line parallel to the diagonal is a stretch of the path that was visited again."
        pictures.append(_picture(f"places-{stage}", title, caption, plot_matrix(matrix)))
    return pictures


def _picture(name: str, title: str, caption: str, figure: Figure) -> Picture:
    return Picture(title, caption, inline_svg(figure, name, f"{title}. {caption}"))
