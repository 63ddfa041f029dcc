"""Figure of a run before and after loop closing: plan view with map, trajectory and loops, and height profile.

Both estimates are aligned with the ground truth, if there is one. Confidence ellipses are drawn on request only: those
of a long drive would hide it.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from odometry.se3 import inverse
from slam.evaluation.trajectory_errors import Similarity, distances_along, umeyama
from slam.report import style
from slam.report.formatting import alignment_name, format_value, is_scaled, kept, metric_value, rejected
from slam.report.style import INK, simplify_line, style_axes, thin_dots
from slam.run_result import LoopRow, PointCloud, RunRecord

if TYPE_CHECKING:  # imported where it is used: a recording needs the alignment, and no figure before the drive ends
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_NO_ELLIPSES = np.empty((0, 0, 2))
_IDENTITY = Similarity(np.eye(3), np.zeros(3), 1.0)
# Alignment.
_MIN_ROUNDNESS = 1e-2  # a path with a lower ratio of second to first spread does not determine its roll
_LEVER = 1e-2  # length of the levers of `align_trajectory`, as a share of the mean distance from the centre
# Confidence ellipses.
_NUM_ELLIPSES = 24  # in a panel, evenly spread along the path
_SIGMAS_95 = np.sqrt(5.991)  # square root of the 95 % quantile of chi-square with 2 degrees of freedom
_NUM_CORNERS = 48  # of an ellipse
_PLAN = np.array([0, 2])  # rows of x and z
# Plan views and height profiles.
_MAX_LANDMARKS = 60_000  # drawn in a panel; more only make the file larger
_MARGIN = 0.07  # around the trajectories, as a share of the larger side
_MAX_MARGIN_M = 10.0  # around short trajectories, so that the map beside them is shown
_MIN_SIDE_M = 4.0  # shown at least, for a camera that stood still
_MIN_ASPECT = 0.6  # minimum ratio of short to long side of a panel, for straight paths
_HEADING_DISTANCE = 0.04  # the arrow points to the first position this far from the start, as a share of the largest
_ARROW_POINTS = 26.0
_MAX_LOOP_LINES = 150  # drawn of each kind, evenly chosen; the dots are those of all loops


@dataclass(frozen=True)
class Panel:
    """Contents of one panel, in the frame of the first camera.

    Attributes:
        title: heading of the panel.
        name: name of the estimate, `odometry` or `corrected`.
        colour: colour of its trajectory.
        positions: camera positions, (N, 3), metres.
        landmarks: map points, (M, 3), metres.
        truth: true positions, (N, 3), metres, or None.
        ellipses: outlines of the 95 % confidence regions, (K, C, 2), metres; K = 0 if covariances are unknown.
    """

    title: str
    name: str
    colour: str
    positions: Array
    landmarks: Array
    truth: Array | None
    ellipses: Array


def anchor_ground_truth(record: RunRecord) -> Array | None:
    """Return the ground truth (N, 4, 4), metres, moved to start at the odometry's first pose; None without one.

    In this frame, that of the first camera, x and z span the plan view, whatever frame the ground truth came in.
    """
    if record.ground_truth is None or not len(record.ground_truth):
        return None
    return np.asarray(record.odometry[0] @ inverse(record.ground_truth[0]) @ record.ground_truth)


def align_trajectory(estimate: Array, truth: Array, with_scale: bool = False) -> Similarity:
    """Return the least-squares transform from an estimate (N, 4, 4) to the truth (N, 4, 4).

    The positions of a straight path do not determine its roll, and a map drawn with a wrong roll may be upside down.
    For such paths the orientations of the cameras are used too, as points at a small lever on all sides of a camera.
    """
    p, q = estimate[:, :3, 3], truth[:, :3, 3]
    best = umeyama(p, q, "sim3" if with_scale else "se3")
    if min(_roundness(p), _roundness(q)) >= _MIN_ROUNDNESS:
        return best
    lever = max(_LEVER * float(np.linalg.norm(q - q.mean(axis=0), axis=1).mean()), 1e-3)
    R = umeyama(_around(estimate, lever / best.scale), _around(truth, lever)).R
    return Similarity(R, q.mean(axis=0) - best.scale * R @ p.mean(axis=0), best.scale)


def _around(poses: Array, lever: float) -> Array:
    sides = lever * np.concatenate([np.eye(3), -np.eye(3)])
    return np.concatenate([poses[:, :3, 3] + poses[:, :3, :3] @ side for side in sides])


def _roundness(positions: Array) -> float:
    """Return the ratio of second to first singular value of centred positions (N, 3): 0 for a line or a point."""
    spread = np.linalg.svd(positions - positions.mean(axis=0), compute_uv=False)
    return float(spread[1] / spread[0]) if len(spread) > 1 and spread[0] > 0 else 0.0


def position_errors(estimate: Array, truth: Array, with_scale: bool = False) -> Array:
    """Return the distances (N,), metres, between an estimate (N, 4, 4) after alignment and the truth (N, 4, 4)."""
    aligned = align_trajectory(estimate, truth, with_scale).apply(estimate[:, :3, 3])
    return np.asarray(np.linalg.norm(aligned - truth[:, :3, 3], axis=1))


def confidence_ellipses(poses: Array, covariances: Array, aligned: Similarity) -> Array:
    """Return outlines (K, 48, 2), x and z in metres, of the regions that hold the camera with 95 % confidence.

    Args:
        poses: T_world_camera, (N, 4, 4), metres.
        covariances: covariances of right perturbations, (N, 6, 6), rotation first.
        aligned: similarity from the frame of the poses to that of the picture.
    """
    distance_m = distances_along(poses)
    shown = np.unique(
        np.searchsorted(distance_m, np.linspace(0.0, distance_m[-1], _NUM_ELLIPSES + 1)[1:]).clip(
            max=len(distance_m) - 1
        )
    )
    R = aligned.scale * aligned.R @ poses[shown, :3, :3]
    plan = (R @ covariances[shown, 3:, 3:] @ np.swapaxes(R, 1, 2))[:, _PLAN[:, None], _PLAN]
    values, vectors = np.linalg.eigh(plan)
    angles = np.linspace(0.0, 2.0 * np.pi, _NUM_CORNERS)
    circle = np.stack([np.cos(angles), np.sin(angles)])
    outlines = vectors @ (_SIGMAS_95 * np.sqrt(values.clip(min=0.0))[:, :, None] * circle)
    centres = aligned.apply(poses[shown, :3, 3])[:, _PLAN]
    return centres[:, None, :] + np.swapaxes(outlines, 1, 2)


def draw_before_after(record: RunRecord) -> "Figure":
    """Draw plan views (x to the right, z up, metres) and heights of odometry alone and of the corrected trajectory.

    With ground truth, both estimates are aligned with it in the same way as for their ATE.
    """
    panels = make_panels(record)
    centre, half = shared_window(panels)
    figure, (left, right), profiles = _canvas(half[1] / half[0])
    for ax, panel in zip((left, right), panels, strict=True):
        draw_plan_view(ax, panel, record)
        set_limits(ax, centre, half)
    for ax, panel in zip(profiles, panels, strict=True):
        _draw_height(ax, panel)
    left.set_ylabel("z [m], forward at the start")
    profiles[0].set_ylabel("height [m]")
    figure.suptitle(record.name, color=INK, parse_math=False, fontweight="bold", y=0.985, va="top")
    handles, labels = right.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(labels), frameon=False, labelcolor=INK)
    return figure


def set_limits(ax: "Axes", centre: Array, half: Array) -> None:
    """Set the limits to centre (2,) +- half (2,), x and z in metres, with equal scale in both directions."""
    ax.set_aspect("equal", adjustable="box")
    (left, bottom), (right, top) = centre - half, centre + half
    ax.set(xlim=(left, right), ylim=(bottom, top))


def _canvas(tallness: float) -> tuple["Figure", list["Axes"], list["Axes"]]:
    """Make a figure of two panels for data with this ratio of height to width, and two profiles below them."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

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


def make_panels(record: RunRecord) -> tuple[Panel, Panel]:
    """Return the panels of odometry alone and of the corrected trajectory."""
    return (
        _panel(record, "Before: odometry alone", "odometry", record.map_before),
        _panel(record, "After: loops closed", "corrected", record.map_after),
    )


def _panel(record: RunRecord, heading: str, name: str, cloud: PointCloud) -> Panel:
    estimate = record.odometry if name == "odometry" else record.corrected
    covariances = record.odometry_covariances if name == "odometry" else record.corrected_covariances
    truth = anchor_ground_truth(record)
    aligned = _IDENTITY
    if truth is not None and len(estimate):
        aligned = align_trajectory(estimate, truth, is_scaled(record.metrics, name))
    points = np.asarray(cloud.points, dtype=np.float64).reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    return Panel(
        title=f"{heading}\n{_ate(record, name)}",
        name=name,
        colour=style.ODOMETRY if name == "odometry" else style.CORRECTED,
        positions=aligned.apply(estimate[:, :3, 3]),
        landmarks=aligned.apply(points[:: len(points) // _MAX_LANDMARKS + 1]),
        truth=None if truth is None else truth[:, :3, 3],
        ellipses=_NO_ELLIPSES if covariances is None else confidence_ellipses(estimate, covariances, aligned),
    )


def _ate(record: RunRecord, name: str) -> str:
    if record.ground_truth is None:
        return "no ground truth"
    ate = format_value(metric_value(record.metrics, f"{name}.ate_m"), 2, " m")
    return f"ATE {ate}, {alignment_name(record.metrics, name)} alignment"


def draw_plan_view(ax: "Axes", panel: Panel, record: RunRecord) -> None:
    """Draw the plan view of an estimate: map, trajectory, loops, start and end."""
    style_axes(ax)
    ax.set_title(panel.title, color=INK, fontsize=11, parse_math=False)
    ax.set_xlabel("x [m]")
    x, _, z = panel.landmarks.T
    ax.plot(x, z, ".", color=INK, ms=1.6, mew=0, alpha=0.45, rasterized=True, zorder=1)
    if panel.truth is not None:  # below the estimate, which is one clean line where both agree
        plan = panel.truth[:, [0, 2]]
        truth = plan[simplify_line(plan)].T
        ax.plot(*truth, ls=(0, (6, 5)), color=style.GROUND_TRUTH, lw=1.2, label="ground truth", zorder=2.8)
    for name, colour in (("odometry", style.ODOMETRY), ("corrected", style.CORRECTED)):
        shown = panel.positions[:, [0, 2]] if name == panel.name else np.empty((0, 2))
        ax.plot(*shown[simplify_line(shown)].T, "-", color=colour, lw=1.8, label=name, zorder=3)
    _draw_loops(ax, panel, kept(record), ("accepted loop", style.ACCEPTED, "-"))
    _draw_loops(ax, panel, rejected(record), ("rejected loop", style.REJECTED, ":"))
    _draw_ends(ax, panel)


def draw_ellipses(ax: "Axes", panel: Panel, gid: str) -> None:
    """Draw the confidence ellipses of a plan view as one element of this id."""
    from matplotlib.collections import LineCollection

    outlines = LineCollection(list(panel.ellipses), colors=panel.colour, lw=0.7, alpha=0.8, zorder=2.2, gid=gid)
    ax.add_collection(outlines, autolim=False)


def _draw_height(ax: "Axes", panel: Panel) -> None:
    """Draw the height over the distance travelled: drift that a plan view cannot show."""
    style_axes(ax)
    ax.set_xlabel("distance travelled [m]")
    if panel.truth is not None:
        truth = panel.truth
        ax.plot(_distances(truth), -truth[:, 1], ls=(0, (6, 5)), color=style.GROUND_TRUTH, lw=1.2, zorder=4)
    ax.plot(_distances(panel.positions), -panel.positions[:, 1], "-", color=panel.colour, lw=1.5, zorder=3)
    low, high = ax.get_ylim()
    if high - low < _MIN_SIDE_M:  # a flat path is not magnified into mountains
        ax.set_ylim((low + high - _MIN_SIDE_M) / 2, (low + high + _MIN_SIDE_M) / 2)


def _distances(positions: Array) -> Array:
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])[: len(positions)]


def _draw_loops(ax: "Axes", panel: Panel, rows: list[LoopRow], look: tuple[str, str, str]) -> None:
    from matplotlib.collections import LineCollection

    label, colour, dashes = look
    pairs = np.array([(row.query, row.match) for row in rows], dtype=np.int64).reshape(-1, 2)
    ends = panel.positions[:, [0, 2]][pairs]
    name = f"{label} ({len(pairs)})"
    drawn = ends[:: len(ends) // _MAX_LOOP_LINES + 1]
    ax.add_collection(LineCollection(list(drawn), colors=colour, lw=0.8, ls=dashes, alpha=0.7, zorder=2.5))
    ax.plot([], [], color=colour, lw=1.5, ls=dashes, label=name)
    # the line of a well closed loop is too short to be seen; a dot under the trajectory is wider than it
    ax.plot(*ends[thin_dots(ends[:, 0]), 0].T, ".", color=colour, ms=8, alpha=0.25, mew=0, zorder=2)


def _draw_ends(ax: "Axes", panel: Panel) -> None:
    if not len(panel.positions):
        return
    plan = panel.positions[:, [0, 2]]
    away = np.linalg.norm(plan - plan[0], axis=1)
    ax.plot(*plan[0], "o", color=INK, mfc="none", ms=8, mew=1.5, ls="none", label="start and heading", zorder=7)
    if away.max() > 0:
        ahead = plan[int(np.argmax(away > _HEADING_DISTANCE * away.max()))] - plan[0]
        tip = ahead / np.linalg.norm(ahead) * _ARROW_POINTS
        arrow = {"arrowstyle": "<|-", "color": INK, "lw": 1.5, "shrinkA": 0, "shrinkB": 5}
        ax.plot(*plan[-1], "s", color=INK, mfc="white", ms=6, mew=1.5, ls="none", label="end", zorder=6)
        ax.annotate("", xy=plan[0], xytext=tip, textcoords="offset points", arrowprops=arrow, zorder=7)


def shared_window(panels: tuple[Panel, Panel]) -> tuple[Array, Array]:
    """Return centre (2,) and half size (2,), metres, that show both trajectories; landmarks may be far outliers."""
    shown = [panel.positions for panel in panels] + [panel.truth for panel in panels if panel.truth is not None]
    plan = np.concatenate([np.zeros((1, 2)), *(positions[:, [0, 2]] for positions in shown)])
    plan = plan[np.isfinite(plan).all(axis=1)]
    low, high = plan.min(axis=0), plan.max(axis=0)
    side = max(float((high - low).max()), _MIN_SIDE_M)
    return (low + high) / 2, np.maximum((high - low) / 2, side * _MIN_ASPECT / 2) + max(
        _MARGIN * side, min(_MAX_MARGIN_M, side / 3)
    )
