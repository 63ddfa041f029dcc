"""Charts of a run: position error over distance, inlier tracks in each frame, time of each stage."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slam.evaluation.trajectory_errors import distances_along
from slam.report import style
from slam.report.formatting import is_scaled, kept, stage_times
from slam.report.style import INK, new_figure, style_axes, thin_curve, thin_dots
from slam.report.trajectory_figure import anchor_ground_truth, position_errors
from slam.run_result import RunRecord

_ESTIMATES = (
    ("odometry", style.ODOMETRY, "-"),
    ("online", style.ONLINE, ":"),
    ("corrected", style.CORRECTED, "-"),
)
_WIDTH_INCH = 5.6  # text in a figure of this width can still be read on a phone
_BAR_HEIGHT_INCH = 0.32


def draw_error_over_distance(record: RunRecord) -> Figure | None:
    """Draw the position error after alignment over the distance travelled; None without ground truth."""
    truth = anchor_ground_truth(record)
    if truth is None:
        return None
    figure = new_figure(_WIDTH_INCH, 3.1)
    ax = figure.subplots()
    distance_m = distances_along(truth)
    for name, colour, dashes in _ESTIMATES:
        error = position_errors(getattr(record, name), truth, is_scaled(record.metrics, name))
        shown = thin_curve(error)
        ax.plot(distance_m[shown], error[shown], dashes, color=colour, lw=1.6, label=name)
    _mark_loops(record, distance_m, ax)
    _finish(ax, "distance travelled [m]", "position error [m]")
    return figure


def draw_inliers(record: RunRecord) -> Figure:
    """Draw the number of inlier tracks in each frame, and the frames whose motion was predicted."""
    figure = new_figure(_WIDTH_INCH, 2.6)
    ax = figure.subplots()
    frames = np.arange(len(record.inliers))
    shown = thin_curve(record.inliers.astype(np.float64))
    ax.plot(shown, record.inliers[shown], color=style.CORRECTED, lw=1.0, label="inlier tracks")
    predicted_frames = frames[record.predicted]
    predicted_frames = predicted_frames[thin_dots(predicted_frames[:, None].astype(np.float64))]
    if len(predicted_frames):
        ax.plot(
            predicted_frames,
            record.inliers[predicted_frames],
            "x",
            color=style.REJECTED,
            ms=5,
            label="motion predicted",
        )
    _finish(ax, "frame", "inliers")
    return figure


def draw_stage_times(record: RunRecord) -> Figure | None:
    """Draw median and 99th percentile of each stage, first stage on top; None where nothing was timed."""
    times = stage_times(record)[::-1]
    if not times:
        return None
    figure = new_figure(_WIDTH_INCH, 1.2 + _BAR_HEIGHT_INCH * len(times))
    ax = figure.subplots()
    rows = np.arange(len(times))
    ax.barh(rows, [t.median for t in times], height=0.62, color=style.CORRECTED, label="median")
    ax.plot([t.p99 for t in times], rows, "|", color=style.ODOMETRY, ms=13, mew=2.5, label="99th percentile")
    ax.set_yticks(rows, [t.name for t in times], parse_math=False)
    _finish(ax, "milliseconds per frame", "")
    return figure


def _mark_loops(record: RunRecord, distance_m: np.ndarray, ax: Axes) -> None:
    queries = np.array([row.query for row in kept(record)], np.int64)
    queries = queries[thin_dots(distance_m[queries, None])]
    ax.plot(
        distance_m[queries],
        np.zeros(len(queries)),
        "|",
        color=style.ACCEPTED,
        ms=9,
        mew=1.2,
        label="loop closed",
    )


def _finish(ax: Axes, xlabel: str, ylabel: str) -> None:
    ax.set(xlabel=xlabel, ylabel=ylabel)
    ax.set_xlim(left=0)
    if ylabel:
        ax.set_ylim(bottom=0)
    style_axes(ax)
    ax.figure.legend(loc="outside upper right", ncols=4, frameon=False, labelcolor=INK, columnspacing=1.0)
