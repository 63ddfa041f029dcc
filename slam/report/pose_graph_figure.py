"""Figure of a pose graph before and after optimisation, with its kept and its rejected loops."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from slam.evaluation.pose_graph_errors import align_positions
from slam.pose_graph.optimization.edges import Edges
from slam.pose_graph.robust.problem import BackEndResult, LoopProblem
from slam.report import style
from slam.report.style import INK, new_figure, style_axes

Array = NDArray[np.float64]

_MAX_INK = 60.0  # opacity of all loops of a kind together, in opaque loops: many loops are drawn fainter
_MAX_LOOPS = 3000  # drawn of each kind; more only blacken the picture


def draw_pose_graph(name: str, problem: LoopProblem, result: BackEndResult, truth: Array | None) -> Figure:
    """Draw odometry alone beside the optimised graph, metres.

    Args:
        name: title of the figure.
        problem: the problem that was optimised.
        result: poses and kept loops of the back end.
        truth: (N, n - 1) true positions, metres, to which the estimates are aligned; or None.
    """
    figure = new_figure(12.0, 6.4)
    axes = figure.subplots(1, 2)
    parts = (
        (axes[0], "Before: odometry alone", "odometry", style.ODOMETRY, problem.start),
        (axes[1], "After: loops closed", "corrected", style.CORRECTED, result.poses),
    )
    plane = _plane(result.poses[:, :-1, -1] if truth is None else truth)
    for ax, title, label, colour, poses in parts:
        positions = poses[:, :-1, -1] if truth is None else align_positions(poses[:, :-1, -1], truth)
        positions = positions @ plane
        _draw_loops(ax, positions, problem.loops[~result.kept], ("left out", style.REJECTED, ":"))
        _draw_loops(ax, positions, problem.loops[result.kept], ("kept", style.ACCEPTED, "-"))
        if truth is not None:  # above the estimate, dashed, so that both are seen where they agree
            ax.plot(
                *(truth @ plane).T,
                ls=(0, (6, 5)),
                color=style.GROUND_TRUTH,
                lw=1.2,
                label="ground truth",
                zorder=4,
            )
        ax.plot(*positions.T, "-", color=colour, lw=1.4, label=label, zorder=3)
        ax.set_title(title, color=INK, fontsize=11)
        _set_limits(ax, positions)
    found = {label: handle for ax in axes for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    figure.legend(
        found.values(), found.keys(), loc="outside lower center", ncols=len(found), frameon=False, labelcolor=INK
    )
    figure.suptitle(name, color=INK, parse_math=False, fontweight="bold")
    return figure


def _set_limits(ax: Axes, positions: Array) -> None:
    """Set the limits so that the whole trajectory is shown, whatever else is drawn."""
    style_axes(ax)
    low, high = positions.min(axis=0), positions.max(axis=0)
    half = np.maximum(0.55 * (high - low), 0.25 * float((high - low).max()) + 1e-3)
    (left, bottom), (right, top) = (low + high) / 2 - half, (low + high) / 2 + half
    ax.set(xlim=(left, right), ylim=(bottom, top), xlabel="[m]", ylabel="[m]")
    ax.set_aspect("equal", adjustable="box")


def _draw_loops(ax: Axes, positions: Array, loops: Edges, look: tuple[str, str, str]) -> None:
    name, colour, dashes = look
    drawn = loops[:: len(loops) // _MAX_LOOPS + 1] if len(loops) else loops
    alpha = float(np.clip(_MAX_INK / max(len(drawn), 1), 0.08, 0.6))
    lines = np.stack([positions[drawn.first], positions[drawn.second]], axis=1)
    ax.add_collection(LineCollection(list(lines), colors=colour, lw=0.7, ls=dashes, alpha=alpha, zorder=2))
    ax.plot([], [], color=colour, lw=1.5, ls=dashes, label=f"loops {name} ({len(loops)})")


def _plane(positions: Array) -> Array:
    """Return the two axes (d, 2) that are drawn: those of the plane, or the two in which a 3D graph extends most."""
    d = positions.shape[1]
    if d == 2:
        return np.eye(2)
    widest = np.sort(np.argsort(-np.ptp(positions, axis=0), kind="stable")[:2])
    return np.asarray(np.eye(d)[:, widest])
