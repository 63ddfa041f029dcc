"""The figures of the report as SVG, with title and caption."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from markupsafe import Markup
from matplotlib.figure import Figure

from slam.record import RunRecord
from slam.report.cells import cell
from slam.report.charts import draw_error_over_distance, draw_inliers, draw_stage_times
from slam.report.maps import draw_interactive_map, map_data
from slam.report.place_figures import plot_matrix, plot_precision_recall
from slam.report.reading import alignment_name
from slam.report.svg import inline_svg

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
        curve = plot_precision_recall({"all thresholds": record.curve}, "")
        pictures.append(_picture("places-curve", "Precision over recall", caption, curve))
    for stage, matrix in record.matrices.items():
        title = _MATRIX_TITLES.get(stage, stage)
        caption = "A line parallel to the diagonal is a stretch of the path that was visited again."
        pictures.append(_picture(f"places-{stage}", title, caption, plot_matrix(matrix)))
    return pictures


def _picture(name: str, title: str, caption: str, figure: Figure) -> Picture:
    return Picture(title, caption, inline_svg(figure, name, f"{title}. {caption}"))
