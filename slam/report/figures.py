"""Figure 4.1 of one drive: where the robot thought it was, and where it was once its loops were closed."""

import io
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slam.errors import OutputError
from slam.evaluation.trajectory import Similarity
from slam.record import LoopRow, PointCloud, RunRecord
from slam.report import colours
from slam.report.alignment import anchored_truth, fit
from slam.report.ellipses import confidence_ellipses
from slam.report.letters import choose_fonts
from slam.report.reading import alignment, kept, rejected, scaled, text, value

Array = NDArray[np.float64]

INK = "#1a1a1a"
_NONE = np.empty((0, 0, 2))
_UNMOVED = Similarity(np.eye(3), np.zeros(3), 1.0)
_DOTS = 60_000  # landmarks drawn in a panel; more only make the picture heavier
_MARGIN = 0.07  # of the larger side, around the trajectories
_SURROUNDINGS = 10.0  # metres around the trajectories in which the map of a short drive lies
_SMALLEST = 4.0  # metres shown at least, for a robot that stood still
_NARROWEST = 0.6  # short over long side of a panel at least, for straight tracks
_AHEAD = 0.04  # the heading is shown to where the robot is so far from the start, of its largest distance
_ARROW = 26.0  # points


@dataclass(frozen=True)
class Panel:
    """What one panel shows, all in the frame of the first camera.

    Attributes:
        title, name, colour: of the estimate.
        positions: (N, 3) metres.
        landmarks: (M, 3) metres.
        truth: (N, 3) metres, or None.
        ellipses: (K, C, 2) metres, outlines of where the robot may be; none where that is not known.
    """

    title: str
    name: str
    colour: str
    positions: Array
    landmarks: Array
    truth: Array | None
    ellipses: Array


def before_after(record: RunRecord) -> Figure:
    """Draw the drive in plan view (x to the right, z up, metres) and its height: odometry alone, and corrected.

    Where there is ground truth both estimates are laid over it by the same alignment as their ATE.
    """
    both = both_panels(record)
    centre, half = window(both)
    figure, (left, right), profiles = _canvas(half[1] / half[0])
    for ax, panel in zip((left, right), both, strict=True):
        draw(ax, panel, record)
        frame_axes(ax, centre, half)
    for ax, panel in zip(profiles, both, strict=True):
        _draw_height(ax, panel)
    left.set_ylabel("z [m], forward at the start")
    profiles[0].set_ylabel("height [m]")
    figure.suptitle(record.name, color=INK, parse_math=False, fontweight="bold", y=0.985, va="top")
    handles, labels = right.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(labels), frameon=False, labelcolor=INK)
    return figure


def frame_axes(ax: Axes, centre: Array, half: Array) -> None:
    """Show what lies so far from a centre (2,), x and z in metres, as large up as across."""
    ax.set_aspect("equal", adjustable="box")
    (left, bottom), (right, top) = centre - half, centre + half
    ax.set(xlim=(left, right), ylim=(bottom, top))


def _canvas(tallness: float) -> tuple[Figure, list[Axes], list[Axes]]:
    """Make a figure whose two panels fit data of this height over width, with two profiles below them."""
    width, above, between, profile, below = 12.0, 0.95, 0.75, 1.3, 0.95  # inches
    plan = float(np.clip(5.5 * tallness, 3.3, 6.6))
    height = above + plan + between + profile + below
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(
        2,
        2,
        height_ratios=(plan, profile),
        left=0.06,
        right=0.985,
        bottom=below / height,
        top=1 - above / height,
        wspace=0.06,
        hspace=2 * between / (plan + profile),
    )
    rows = []
    for row in range(2):
        left = figure.add_subplot(grid[row, 0])
        right = figure.add_subplot(grid[row, 1], sharex=left, sharey=left)
        right.tick_params(labelleft=False)
        rows.append([left, right])
    return figure, rows[0], rows[1]


def new_figure(width: float, height: float) -> Figure:
    """Make an empty figure of so many inches that shares no state with others."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def style(ax: Axes) -> None:
    """Give axes the look that all pictures share."""
    ax.grid(True, linewidth=0.5, alpha=0.25, color=INK)
    ax.tick_params(colors=INK, labelsize=9)
    ax.xaxis.label.set_color(INK)
    ax.yaxis.label.set_color(INK)
    for side, spine in ax.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(INK)


def both_panels(record: RunRecord) -> tuple[Panel, Panel]:
    """By odometry alone, and corrected."""
    return (
        _panel(record, "Before: odometry alone", "odometry", record.map_before),
        _panel(record, "After: loops closed", "corrected", record.map_after),
    )


def _panel(record: RunRecord, heading: str, name: str, cloud: PointCloud) -> Panel:
    estimate = record.odometry if name == "odometry" else record.corrected
    covariances = record.odometry_covariances if name == "odometry" else record.corrected_covariances
    truth = anchored_truth(record)
    aligned = _UNMOVED
    if truth is not None and len(estimate):
        aligned = fit(estimate, truth, scaled(record.metrics, name))
    points = np.asarray(cloud.points, dtype=np.float64).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    return Panel(
        title=f"{heading}\n{_ate(record, name)}",
        name=name,
        colour=colours.ODOMETRY if name == "odometry" else colours.CORRECTED,
        positions=aligned.apply(estimate[:, :3, 3]),
        landmarks=aligned.apply(points[:: len(points) // _DOTS + 1]),
        truth=None if truth is None else truth[:, :3, 3],
        ellipses=_NONE if covariances is None else confidence_ellipses(estimate, covariances, aligned),
    )


def _ate(record: RunRecord, name: str) -> str:
    if record.ground_truth is None:
        return "no ground truth"
    ate = text(value(record.metrics, f"{name}.ate_m"), 2, " m")
    return f"ATE {ate}, {alignment(record.metrics, name)} alignment"


def draw(ax: Axes, panel: Panel, record: RunRecord) -> None:
    """Draw the plan view of an estimate: map, trajectory, how sure it is, loops, start."""
    style(ax)
    ax.set_title(panel.title, color=INK, fontsize=11, parse_math=False)
    ax.set_xlabel("x [m]")
    x, _, z = panel.landmarks.T
    ax.plot(x, z, ".", color=INK, ms=1.6, mew=0, alpha=0.45, rasterized=True, zorder=1)
    if panel.truth is not None:
        truth = panel.truth[:, [0, 2]].T
        ax.plot(*truth, ls=(0, (6, 5)), color=colours.GROUND_TRUTH, lw=1.2, label="ground truth", zorder=4)
    for name, colour in (("odometry", colours.ODOMETRY), ("corrected", colours.CORRECTED)):
        shown = panel.positions[:, [0, 2]] if name == panel.name else np.empty((0, 2))
        ax.plot(*shown.T, "-", color=colour, lw=1.8, label=name, zorder=3)
    _draw_ellipses(ax, panel)
    _draw_loops(ax, panel, kept(record), ("accepted loop", colours.ACCEPTED, "-"))
    _draw_loops(ax, panel, rejected(record), ("rejected loop", colours.REJECTED, ":"))
    _draw_start(ax, panel)


def _draw_ellipses(ax: Axes, panel: Panel) -> None:
    outlines = LineCollection(list(panel.ellipses), colors=panel.colour, lw=0.8, alpha=0.55, zorder=2.2)
    ax.add_collection(outlines, autolim=False)
    if len(panel.ellipses):
        ax.plot([], [], "o", mfc="none", color=panel.colour, ms=9, mew=0.8, label="95 % confidence")


def _draw_height(ax: Axes, panel: Panel) -> None:
    """Height over the way driven: drift that a plan view cannot show."""
    style(ax)
    ax.set_xlabel("way driven [m]")
    if panel.truth is not None:
        truth = panel.truth
        ax.plot(_way(truth), -truth[:, 1], ls=(0, (6, 5)), color=colours.GROUND_TRUTH, lw=1.2, zorder=4)
    ax.plot(_way(panel.positions), -panel.positions[:, 1], "-", color=panel.colour, lw=1.5, zorder=3)
    low, high = ax.get_ylim()
    if high - low < _SMALLEST:  # a flat drive is not magnified into mountains
        ax.set_ylim((low + high - _SMALLEST) / 2, (low + high + _SMALLEST) / 2)


def _way(positions: Array) -> Array:
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])[: len(positions)]


def _draw_loops(ax: Axes, panel: Panel, rows: list[LoopRow], look: tuple[str, str, str]) -> None:
    label, colour, dashes = look
    pairs = np.array([(row.query, row.match) for row in rows], dtype=np.int64).reshape(-1, 2)
    ends = panel.positions[:, [0, 2]][pairs]
    name = f"{label} ({len(pairs)})"
    ax.add_collection(LineCollection(list(ends), colors=colour, lw=1.0, ls=dashes, alpha=0.8, zorder=2.5))
    ax.plot([], [], color=colour, lw=1.5, ls=dashes, label=name)
    # a loop that closed well is too short to see as a line; its dot peeps out from under the trajectory
    ax.plot(*ends[:, 0].T, ".", color=colour, ms=8, alpha=0.5, mew=0, zorder=2)


def _draw_start(ax: Axes, panel: Panel) -> None:
    if not len(panel.positions):
        return
    plan = panel.positions[:, [0, 2]]
    away = np.linalg.norm(plan - plan[0], axis=1)
    ax.plot(*plan[0], "o", color=INK, mfc="none", ms=8, mew=1.5, ls="none", label="start and heading", zorder=7)
    if away.max() > 0:
        ahead = plan[int(np.argmax(away > _AHEAD * away.max()))] - plan[0]
        tip = ahead / np.linalg.norm(ahead) * _ARROW
        arrow = {"arrowstyle": "<|-", "color": INK, "lw": 1.5, "shrinkA": 0, "shrinkB": 5}
        ax.annotate("", xy=plan[0], xytext=tip, textcoords="offset points", arrowprops=arrow, zorder=7)


def window(both: tuple[Panel, Panel]) -> tuple[Array, Array]:
    """Centre (2,) and half size (2,), metres, of both panels: trajectories only, as landmarks stray."""
    shown = [panel.positions for panel in both] + [panel.truth for panel in both if panel.truth is not None]
    plan = np.concatenate([np.zeros((1, 2)), *(positions[:, [0, 2]] for positions in shown)])
    plan = plan[np.isfinite(plan).all(axis=1)]
    low, high = plan.min(axis=0), plan.max(axis=0)
    side = max(float((high - low).max()), _SMALLEST)
    return (low + high) / 2, np.maximum((high - low) / 2, side * _NARROWEST / 2) + max(
        _MARGIN * side, min(_SURROUNDINGS, side / 3)
    )


def save_png(figure: Figure, path: Path) -> None:
    """Write a figure as PNG: the same figure gives the same bytes, whatever the day.

    Raises:
        OutputError: the file cannot be written.
    """
    try:
        path.write_bytes(png(figure))
    except OSError as error:
        raise OutputError(f"{path}: cannot write the picture ({error.strerror}); choose another folder") from error


def png(figure: Figure) -> bytes:
    """Render a figure as PNG on white, without the date and version that matplotlib would add."""
    buffer = io.BytesIO()
    render(figure, buffer, format="png", dpi=130, facecolor="white", metadata={"Software": None})
    return buffer.getvalue()


def render(figure: Figure, buffer: IO[Any], **how: Any) -> None:
    """Write a figure to a buffer as `Figure.savefig` does; letters that no font has become boxes."""
    choose_fonts(figure)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph")
        figure.savefig(buffer, **how)
