"""Plan views that the page can zoom into, and that tell which frame is where."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from numpy.typing import NDArray

from slam.record import RunRecord
from slam.report.alignment import anchored_truth, position_error
from slam.report.figures import both_panels, draw, frame_axes, new_figure, window
from slam.report.reading import scaled

Array = NDArray[np.float64]

_POINTS_PER_INCH = 72  # the unit of a drawing


def plan_view(record: RunRecord, name: str) -> Figure:
    """Draw one panel of `before_after` alone, of `odometry` or `corrected`, without legend."""
    panels = both_panels(record)
    centre, half = window(panels)
    figure = new_figure(5.6, float(np.clip(4.9 * half[1] / half[0], 3.3, 6.6)) + 0.5)
    ax = figure.subplots()
    draw(ax, next(panel for panel in panels if panel.name == name), record)
    frame_axes(ax, centre, half)
    ax.set_title("")
    ax.set_ylabel("z [m]")
    _name_contents(figure)
    return figure


def _name_contents(figure: Figure) -> None:
    """Give what lies in the map, and not around it, ids by which the page finds it."""
    (ax,) = figure.axes
    arrows = [text.arrow_patch for text in ax.texts if isinstance(text, Annotation) and text.arrow_patch]
    for number, artist in enumerate([*ax.lines, *ax.collections, *arrows]):
        artist.set_gid(f"inside-{number}")


def map_data(record: RunRecord, name: str, figure: Figure) -> dict[str, object]:
    """What the page needs to know of a plan view that has been drawn.

    Returns:
        box: x, y, width and height of the map in the drawing, its own units, y down.
        window: x and z of its lower left and upper right corner, metres.
        at: x and z of each frame, metres.
        error: distance of each frame from the ground truth after alignment, metres; empty where there is none.
    """
    (ax,) = figure.axes
    width, height = figure.get_size_inches() * _POINTS_PER_INCH
    box = ax.get_position()
    panel = next(panel for panel in both_panels(record) if panel.name == name)
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    return {
        "box": _rounded([box.x0 * width, (1 - box.y1) * height, box.width * width, box.height * height]),
        "window": _rounded([left, bottom, right, top]),
        "at": _rounded(panel.positions[:, [0, 2]]),
        "error": _rounded(_errors(record, name)),
    }


def _errors(record: RunRecord, name: str) -> Array:
    truth = anchored_truth(record)
    if truth is None:
        return np.empty(0)
    return position_error(getattr(record, name), truth, scaled(record.metrics, name))


def _rounded(values: object) -> list[object]:
    """Numbers as lists, to a hundredth."""
    return list(np.round(np.asarray(values, dtype=np.float64), 2).tolist())
