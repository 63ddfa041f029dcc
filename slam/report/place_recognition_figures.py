"""Figures of place recognition: matrices (the chapter's Figures 4.7, 4.8, 4.9, 4.12) and curves (Figure 4.16)."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from place_recognition.evaluation.precision_recall import PrecisionRecall
from place_recognition.evaluation.similarity_matrix import SimilarityMatrix
from slam.report import colours
from slam.report.trajectory_figure import INK, new_figure, style_axes

Floats = NDArray[np.float32]
Ids = NDArray[np.int64]

_PANEL_INCHES = 4.6  # side of a panel
_MAX_CELLS = 600  # drawn along a side of a matrix: about the pixels of a panel
_SHADES = LinearSegmentedColormap.from_list("shades", ["#ffffff", "#9ecae9", colours.CORRECTED, colours.SCALE_END])
_STAGES = {"similarity": "Similarity or votes", "filtered": "After the filter"}
# Colour and dashes of the curves. The dashes distinguish them in print and for the colour-blind.
_LINES = (
    (colours.CORRECTED, "-"),
    (colours.ODOMETRY, "--"),
    (colours.ACCEPTED, "-."),
    (colours.REJECTED, (0, (1, 1))),
    (colours.ONLINE, (0, (5, 1, 1, 1, 1, 1))),
    (INK, (0, (6, 3))),
    (colours.GROUND_TRUTH, (0, (1, 2))),
)


def plot_places(
    title: str, matrices: Mapping[str, SimilarityMatrix], detections: Ids, truth: NDArray[np.bool_] | None
) -> Figure:
    """Plot the matrices of a run, before and after their filter, the detections, and the ground truth if known.

    Args:
        title: title of the figure.
        matrices: matrix of each stage.
        detections: (K, 2) query and match of each detection.
        truth: (N, N) True where two images show one place, row = query, column = earlier image; None if unknown.
    """
    count = len(matrices) + 1 + (truth is not None)
    columns = 2 if count == 4 else count
    figure = new_figure(_PANEL_INCHES * columns, (0.86 * _PANEL_INCHES + 0.35) * -(-count // columns) + 0.35)
    figure.set_layout_engine("compressed")  # the panels are square
    panels = list(figure.subplots(-(-count // columns), columns, squeeze=False).flat)
    for panel, (stage, matrix) in zip(panels, matrices.items(), strict=False):
        draw_matrix(panel, matrix, _STAGES.get(stage, stage))
    images = next(len(matrix.values) * matrix.step for matrix in matrices.values())
    draw_detections(panels[len(matrices)], detections, truth, images if truth is None else len(truth))
    if truth is not None:
        draw_truth(panels[-1], truth)
    figure.suptitle(title, color=INK, parse_math=False, fontweight="bold")
    return figure


def plot_matrix(matrix: SimilarityMatrix) -> Figure:
    """Plot one matrix."""
    figure = new_figure(_PANEL_INCHES + 0.9, _PANEL_INCHES)
    figure.set_layout_engine("compressed")  # the panel is square
    draw_matrix(figure.subplots(), matrix, "")
    return figure


def draw_matrix(ax: Axes, matrix: SimilarityMatrix, title: str) -> None:
    """Draw a matrix of similarities, votes or filter responses: Figures 4.8 and 4.12."""
    _format_axes(ax, title, len(matrix.values) * matrix.step)
    rows, columns, cells = reduce_to_cells(matrix)
    if not np.isfinite(cells).any():
        ax.text(0.5, 0.5, "no images were compared", transform=ax.transAxes, ha="center", va="center", color=INK)
        return
    # Filter responses go far below zero where nothing matches, so colours start at their median.
    low, high = np.nanpercentile(cells, [50.0 if np.nanmin(cells) < 0 else 10.0, 99.8])
    mesh = ax.pcolormesh(
        columns, rows, cells, cmap=_SHADES, vmin=low, vmax=max(high, low + 1e-9), rasterized=True, shading="flat"
    )
    bar = ax.figure.colorbar(mesh, ax=ax, fraction=0.045, pad=0.02, extend="max")
    assert bar.solids is not None
    bar.solids.set_rasterized(True)  # like the matrix: a dark page inverts the colours of images
    bar.set_label("the paradigm's own scale", color=INK)
    bar.ax.tick_params(colors=INK, labelsize=8)


def draw_detections(ax: Axes, detections: Ids, truth: NDArray[np.bool_] | None, images: int) -> None:
    """Draw the accepted matches: Figure 4.7; true and false ones in different colours if the truth is known."""
    _format_axes(ax, f"Detections: {len(detections)}", images)
    right = np.ones(len(detections), np.bool_) if truth is None else truth[detections[:, 0], detections[:, 1]]
    label = "accepted" if truth is None else f"true ({int(right.sum())})"
    ax.plot(*_columns_first(detections[right]), "o", color=colours.ACCEPTED, ms=2.4, mew=0, label=label)
    if truth is not None:
        wrong = detections[~right]
        ax.plot(*_columns_first(wrong), "x", color=colours.REJECTED, ms=7, mew=1.6, label=f"false ({len(wrong)})")
    ax.legend(loc="upper right", frameon=False, labelcolor=INK)


def draw_truth(ax: Axes, truth: NDArray[np.bool_]) -> None:
    """Draw which images show the same place: Figure 4.9."""
    _format_axes(ax, f"Ground truth: {int(truth.any(axis=1).sum())} revisits", len(truth))
    ax.plot(*_columns_first(np.argwhere(truth)), "s", color=colours.CORRECTED, ms=1.4, mew=0, rasterized=True)


def plot_precision_recall(curves: Mapping[str, PrecisionRecall], title: str) -> Figure:
    """Plot precision over recall with a circle at R@P100: Figure 4.16.

    Args:
        curves: precision-recall curves by name; empty without ground truth.
        title: title of the figure.
    """
    figure = new_figure(6.4, 4.8)
    ax = figure.subplots()
    draw_precision_recall(ax, curves)
    ax.set_title(title, color=INK, parse_math=False, fontsize=11, fontweight="bold")
    return figure


def draw_precision_recall(
    ax: Axes, curves: Mapping[str, PrecisionRecall | None], missing: str = "no ground truth, no curve"
) -> None:
    """Draw precision over recall with a circle at R@P100.

    Args:
        ax: axes to draw into.
        curves: precision-recall curves by name; None leaves a name out and its line style unused.
        missing: text for an empty panel.
    """
    style_axes(ax)
    ax.set(xlim=(-0.01, 1.01), ylim=(0.0, 1.03), xlabel="recall", ylabel="precision")
    for (name, curve), (colour, dashes) in zip(curves.items(), _LINES * len(curves), strict=False):
        if curve is None:
            continue
        full = curve.recall_at_full_precision
        ax.plot(curve.recall, curve.precision, color=colour, ls=dashes, lw=1.8, label=f"{name}: R@P100 {full:.3f}")
        ax.plot([full], [1.0 if full else 0.0], "o", color=colour, ms=9, mfc="none", mew=1.8, clip_on=False, zorder=5)
    if not ax.lines:
        ax.text(0.5, 0.5, missing, transform=ax.transAxes, ha="center", color=INK)
        return
    title = "circle: largest recall without a false match"
    clear = {"edgecolor": "none", "facecolor": "none", "labelcolor": INK}
    legend = ax.legend(loc="best", title=title, title_fontsize=8, fontsize=9, **clear)
    legend.get_title().set_color(INK)
    for name_text in legend.get_texts():
        name_text.set_parse_math(False)


def reduce_to_cells(matrix: SimilarityMatrix) -> tuple[Ids, Ids, Floats]:
    """Reduce a matrix to cells that can be drawn: edges (R + 1,) and (C + 1,) in images, and values (R, C).

    A matrix of sequences has rows and columns for a few images only: each stands for the images up to the next one.
    A cell that holds many pairs of images gets their largest value, so that thin lines stay visible.
    """
    finite = np.isfinite(matrix.values)
    rows, columns = _begins(finite, axis=1), _begins(finite, axis=0)
    ends = _end(rows, len(finite)), _end(columns, len(finite))
    rows, columns = rows[:: -(-len(rows) // _MAX_CELLS)], columns[:: -(-len(columns) // _MAX_CELLS)]
    cells = np.fmax.reduceat(np.fmax.reduceat(matrix.values, rows, axis=0), columns, axis=1)
    return np.append(rows, ends[0]) * matrix.step, np.append(columns, ends[1]) * matrix.step, cells


def _begins(finite: NDArray[np.bool_], axis: int) -> Ids:
    """Return the first row (axis 1) or column (axis 0) of each cell: those with values if at most half, else all."""
    there = np.flatnonzero(np.any(finite, axis=axis))
    if 2 * len(there) > len(finite) or not len(there):
        return np.arange(len(finite))
    return there if there[0] == 0 else np.insert(there, 0, 0)


def _end(begins: Ids, size: int) -> int:
    """Return the end of the last cell, which is as long as the longest of the others."""
    return min(int(begins[-1] + np.diff(begins).max(initial=1)), size)


def _format_axes(ax: Axes, title: str, images: int) -> None:
    style_axes(ax)
    ax.grid(False)
    ax.set(xlim=(0, images), ylim=(images, 0), xlabel="earlier image", ylabel="query image")
    ax.set_aspect("equal")
    ax.set_title(title, color=INK, parse_math=False, fontsize=11)


def _columns_first(pairs: Ids) -> tuple[Ids, Ids]:
    return pairs[:, 1], pairs[:, 0]
