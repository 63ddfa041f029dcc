"""The drawings of the report, with their words."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from markupsafe import Markup
from matplotlib.figure import Figure

from slam.record import RunRecord
from slam.report.cells import cell
from slam.report.charts import error_over_way, inliers_per_frame, time_per_stage
from slam.report.maps import map_data, plan_view
from slam.report.place_figures import plot_matrix, plot_precision_recall
from slam.report.reading import alignment
from slam.report.svg import inline_svg


@dataclass(frozen=True)
class Picture:
    """A figure with its words.

    Attributes:
        title, caption: what it shows, and how to read it.
        svg: the drawing.
        data: what the page needs to zoom into it and to name its frames; empty where it cannot.
    """

    title: str
    caption: str
    svg: Markup
    data: Mapping[str, object] = field(default_factory=dict)


def maps(record: RunRecord) -> list[Picture]:
    """Plan views by odometry alone, and corrected."""
    named = (
        ("odometry", "Before: odometry alone", "Each step adds its error, so the map of a second visit lies askew."),
        ("corrected", "After: loops closed", "Recognised places pull the trajectory and its map together."),
    )
    return [_map(record, *words) for words in named]


def _map(record: RunRecord, name: str, title: str, caption: str) -> Picture:
    ate, told = cell(record, f"{name}.ate_m", 2, " m"), ""
    if record.ground_truth is not None:
        told = f"ATE {ate.text}, {alignment(record.metrics, name)} alignment. "
    figure = plan_view(record, name)
    drawn = inline_svg(figure, f"map-{name}", f"Plan view, {title}. {told}")
    return Picture(title, told + caption, drawn, map_data(record, name, figure))


def charts(record: RunRecord) -> list[Picture]:
    """What changed over the drive, and where the time went."""
    drawn = (
        ("error", "Position error over the way", "Distance from the ground truth after alignment.", error_over_way),
        ("inliers", "Inlier tracks", "Tracks that agreed with the motion, frame by frame.", inliers_per_frame),
        ("stages", "Time for each stage", "Half of the frames took less than the bar.", time_per_stage),
    )
    figures = [(f"chart-{name}", title, caption, draw(record)) for name, title, caption, draw in drawn]
    return [_picture(name, title, caption, figure) for name, title, caption, figure in figures if figure is not None]


def places(record: RunRecord) -> list[Picture]:
    """How the recogniser ranks: its curve, where there is ground truth, and its matrices."""
    pictures = []
    if record.curve is not None:
        full = record.curve.recall_at_full_precision
        caption = f"The circle marks R@P100 = {full:.3f}: the highest recall at which no detection is false."
        curve = plot_precision_recall({"all thresholds": record.curve}, "")
        pictures.append(_picture("places-curve", "Precision over recall", caption, curve))
    for stage, matrix in record.matrices.items():
        title = _STAGES.get(stage, stage)
        caption = "A line beside the diagonal is a stretch of the way that was driven again."
        pictures.append(_picture(f"places-{stage}", title, caption, plot_matrix(matrix)))
    return pictures


_STAGES = {"similarity": "Matrix of similarities or votes", "filtered": "Matrix after its filter"}


def _picture(name: str, title: str, caption: str, figure: Figure) -> Picture:
    return Picture(title, caption, inline_svg(figure, name, f"{title}. {caption}"))
