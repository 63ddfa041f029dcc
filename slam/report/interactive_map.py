"""Plan views as SVG with the data that the page needs to zoom into them and to name frames."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from numpy.typing import NDArray

from slam.report.formatting import is_scaled
from slam.report.style import new_figure
from slam.report.trajectory_figure import (
    anchor_ground_truth,
    draw_plan_view,
    make_panels,
    position_errors,
    set_limits,
    shared_window,
)
from slam.run_result import RunRecord

Array = NDArray[np.float64]

_POINTS_PER_INCH = 72  # the unit of a drawing


def draw_interactive_map(record: RunRecord, name: str) -> Figure:
    """Draw the plan view of `odometry` or `corrected` alone, without legend."""
    panels = make_panels(record)
    centre, half = shared_window(panels)
    figure = new_figure(5.6, float(np.clip(4.9 * half[1] / half[0], 3.3, 6.6)) + 0.5)
    ax = figure.subplots()
    draw_plan_view(ax, next(panel for panel in panels if panel.name == name), record)
    set_limits(ax, centre, half)
    ax.set_title("")
    ax.set_ylabel("z [m]")
    _set_content_ids(figure)
    return figure


def _set_content_ids(figure: Figure) -> None:
    """Give the contents of the map ids by which the page finds them; axes and labels have none."""
    (ax,) = figure.axes
    arrows = [text.arrow_patch for text in ax.texts if isinstance(text, Annotation) and text.arrow_patch]
    for number, artist in enumerate([*ax.lines, *ax.collections, *arrows]):
        artist.set_gid(f"inside-{number}")


def map_data(record: RunRecord, name: str, figure: Figure) -> dict[str, object]:
    """Return the data of a drawn plan view for the page's script.

    Returns:
        box: x, y, width and height of the map within the drawing, points, y down.
        window: x and z of the lower left and of the upper right corner, metres.
        at: x and z of each frame, metres.
        error: distance of each frame from the ground truth after alignment, metres; empty without ground truth.
    """
    (ax,) = figure.axes
    width, height = figure.get_size_inches() * _POINTS_PER_INCH
    box = ax.get_position()
    panel = next(panel for panel in make_panels(record) if panel.name == name)
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    return {
        "box": _rounded([box.x0 * width, (1 - box.y1) * height, box.width * width, box.height * height]),
        "window": _rounded([left, bottom, right, top]),
        "at": _rounded(panel.positions[:, [0, 2]]),
        "error": _rounded(_errors(record, name)),
    }


def _errors(record: RunRecord, name: str) -> Array:
    truth = anchor_ground_truth(record)
    if truth is None:
        return np.empty(0)
    return position_errors(getattr(record, name), truth, is_scaled(record.metrics, name))


def _rounded(values: object) -> list[object]:
    """Return numbers as nested lists, rounded to a hundredth to keep the page small."""
    return list(np.round(np.asarray(values, dtype=np.float64), 2).tolist())
