"""Smaller pictures of a run: error over the way, tracks in each frame, time of each stage."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slam.evaluation.trajectory import distances_along
from slam.record import RunRecord
from slam.report import colours
from slam.report.alignment import anchored_truth, position_error
from slam.report.figures import INK, new_figure, style
from slam.report.reading import kept, scaled, stage_times

_ESTIMATES = (
    ("odometry", colours.ODOMETRY, "-"),
    ("online", colours.ONLINE, ":"),
    ("corrected", colours.CORRECTED, "-"),
)
_WIDTH = 5.6  # inches; of this width the writing can still be read on a phone
_BAR = 0.32  # inches of height for each stage


def error_over_way(record: RunRecord) -> Figure | None:
    """Draw the distance from the ground truth after alignment over the way driven; None without truth."""
    truth = anchored_truth(record)
    if truth is None:
        return None
    figure = new_figure(_WIDTH, 3.1)
    ax = figure.subplots()
    way = distances_along(truth)
    for name, colour, dashes in _ESTIMATES:
        error = position_error(getattr(record, name), truth, scaled(record.metrics, name))
        ax.plot(way, error, dashes, color=colour, lw=1.6, label=name)
    _mark_loops(record, way, ax)
    _finish(ax, "way driven [m]", "position error [m]")
    return figure


def inliers_per_frame(record: RunRecord) -> Figure:
    """Draw how many tracks agreed with the motion in each frame, and where it had to be predicted."""
    figure = new_figure(_WIDTH, 2.6)
    ax = figure.subplots()
    frames = np.arange(len(record.inliers))
    ax.plot(frames, record.inliers, color=colours.CORRECTED, lw=1.0, label="inlier tracks")
    guessed = frames[record.predicted]
    if len(guessed):
        ax.plot(guessed, record.inliers[guessed], "x", color=colours.REJECTED, ms=5, label="motion predicted")
    _finish(ax, "frame", "inliers")
    return figure


def time_per_stage(record: RunRecord) -> Figure | None:
    """Draw median and 99th percentile of each stage, first stage on top; None where nothing was timed."""
    times = stage_times(record)[::-1]
    if not times:
        return None
    figure = new_figure(_WIDTH, 1.2 + _BAR * len(times))
    ax = figure.subplots()
    rows = np.arange(len(times))
    ax.barh(rows, [t.median for t in times], height=0.62, color=colours.CORRECTED, label="median")
    ax.plot([t.p99 for t in times], rows, "|", color=colours.ODOMETRY, ms=13, mew=2.5, label="99th percentile")
    ax.set_yticks(rows, [t.name for t in times], parse_math=False)
    _finish(ax, "milliseconds a frame", "")
    return figure


def _mark_loops(record: RunRecord, way: np.ndarray, ax: Axes) -> None:
    queries = [row.query for row in kept(record)]
    ax.plot(way[queries], np.zeros(len(queries)), "|", color=colours.ACCEPTED, ms=9, mew=1.2, label="loop closed")


def _finish(ax: Axes, xlabel: str, ylabel: str) -> None:
    ax.set(xlabel=xlabel, ylabel=ylabel)
    ax.set_xlim(left=0)
    if ylabel:
        ax.set_ylim(bottom=0)
    style(ax)
    ax.figure.legend(loc="outside upper right", ncols=4, frameon=False, labelcolor=INK, columnspacing=1.0)
