"""Plan views as SVG with the data that the page needs to zoom into them and to name frames."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from numpy.typing import NDArray

from slam.report.formatting import format_value, is_scaled, kept, metric_value
from slam.report.style import new_figure, simplify_line
from slam.report.trajectory_figure import (
    Panel,
    anchor_ground_truth,
    draw_ellipses,
    draw_plan_view,
    make_panels,
    position_errors,
    set_limits,
    shared_window,
)
from slam.run_result import RunRecord

Array = NDArray[np.float64]

_MAX_BLENDED_LANDMARKS, _MAX_BLENDED_LOOPS = 4000, 300  # more make the page larger, and its movement slower
_ELLIPSES_ID = "inside-ellipses"  # shown by the style sheet when the page's box is checked
_POINTS_PER_INCH = 72  # the unit of a drawing


def draw_interactive_map(record: RunRecord, name: str) -> Figure:
    """Draw the plan view of `odometry` or `corrected` alone, without legend."""
    panels = make_panels(record)
    centre, half = shared_window(panels)
    figure = new_figure(5.6, float(np.clip(4.9 * half[1] / half[0], 3.3, 6.6)) + 0.5)
    ax = figure.subplots()
    panel = next(panel for panel in panels if panel.name == name)
    draw_plan_view(ax, panel, record)
    set_limits(ax, centre, half)
    ax.set_title("")
    ax.set_ylabel("z [m]")
    _set_content_ids(figure)
    draw_ellipses(ax, panel, _ELLIPSES_ID)
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
        frames: numbers of the frames that are shown: all, or those of lines simplified to less than a pixel.
        at: x and z of each of them, metres.
        error: distance of each from the ground truth after alignment, metres; empty without ground truth.
    """
    (ax,) = figure.axes
    width, height = figure.get_size_inches() * _POINTS_PER_INCH
    box = ax.get_position()
    panels = make_panels(record)
    panel, shown = next(panel for panel in panels if panel.name == name), _shown_frames(panels)
    error = _errors(record, name)
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    return {
        "box": _rounded([box.x0 * width, (1 - box.y1) * height, box.width * width, box.height * height]),
        "window": _rounded([left, bottom, right, top]),
        "frames": shown.tolist(),
        "at": _rounded(panel.positions[shown][:, [0, 2]]),
        "error": _rounded(error[shown] if len(error) else error),
    }


def _shown_frames(panels: tuple[Panel, Panel]) -> NDArray[np.int64]:
    """Return the frames (K,) by which both trajectories are drawn."""
    return simplify_line(np.hstack([panel.positions[:, [0, 2]] for panel in panels]))


def blend_data(record: RunRecord) -> dict[str, object]:
    """Return what the page's script moves from before to after, besides the trajectories of the two plan views.

    Returns:
        truth: x and z of the ground truth, metres; empty without one.
        loops: query and match of kept loops, evenly chosen if there are many, counted in the frames that are shown.
        dots: x and z of the same landmarks `before` and `after`, metres; none where the two maps have not the same.
        errors: what to say of either end: its ATE, or nothing.
    """
    before, after = make_panels(record)
    loops = np.array([(row.query, row.match) for row in kept(record)], np.int64).reshape(-1, 2)
    loops = loops[:: len(loops) // _MAX_BLENDED_LOOPS + 1]
    truth = np.empty((0, 2)) if before.truth is None else before.truth[:, [0, 2]]
    return {
        "truth": _rounded(truth[simplify_line(truth)]),
        "loops": np.searchsorted(_shown_frames((before, after)), loops).tolist(),
        "dots": dict(zip(("before", "after"), map(_rounded, _same_landmarks(record, before, after)), strict=True)),
        "errors": [_describe_error(record, panel.name) for panel in (before, after)],
    }


def _same_landmarks(record: RunRecord, before: Panel, after: Panel) -> tuple[Array, Array]:
    """Return x and z (M, 2), metres, of the landmarks that are in both panels near the trajectories."""
    first, second = before.landmarks, after.landmarks
    if len(first) != len(second) or len(record.map_before.points) != len(record.map_after.points):
        return np.empty((0, 2)), np.empty((0, 2))
    centre, half = shared_window((before, after))
    pairs = np.stack([first, second])[:, :, [0, 2]]
    shown = pairs[:, (np.abs(pairs - centre) <= half).all(axis=(0, 2))]
    chosen = shown[:, :: shown.shape[1] // _MAX_BLENDED_LANDMARKS + 1]
    return chosen[0], chosen[1]


def _describe_error(record: RunRecord, name: str) -> str:
    ate = metric_value(record.metrics, f"{name}.ate_m")
    return "" if ate is None else f": ATE {format_value(ate, 2, ' m')}"


def _errors(record: RunRecord, name: str) -> Array:
    truth = anchor_ground_truth(record)
    if truth is None:
        return np.empty(0)
    return position_errors(getattr(record, name), truth, is_scaled(record.metrics, name))


def _rounded(values: object) -> list[object]:
    """Return numbers as nested lists, rounded to a hundredth to keep the page small."""
    return list(np.round(np.asarray(values, dtype=np.float64), 2).tolist())
