"""The chapter's pictures of place recognition: matrices (Figures 4.7, 4.8, 4.9, 4.12) and curves (Figure 4.16)."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from place_recognition.evaluation.matrix import Matrix
from place_recognition.evaluation.precision_recall import PrecisionRecall
from slam.report import colours
from slam.report.figures import INK, new_figure, style_axes

Floats = NDArray[np.float32]
Ids = NDArray[np.int64]

_PANEL = 4.6  # inches
_CELLS = 600  # a side of a matrix as it is drawn: about the pixels of a panel
_SHADES = LinearSegmentedColormap.from_list("shades", ["#ffffff", "#9ecae9", colours.CORRECTED, colours.MOST])
_STAGES = {"similarity": "Similarity or votes", "filtered": "After the filter"}
# Colour and dashes of the curves: the dashes tell them apart where the colours do not.
_LINES = (
    (colours.CORRECTED, "-"),
    (colours.ODOMETRY, "--"),
    (colours.ACCEPTED, "-."),
    (colours.REJECTED, (0, (1, 1))),
    (colours.ONLINE, (0, (5, 1, 1, 1, 1, 1))),
    (INK, (0, (6, 3))),
)


def places_picture(
    title: str, matrices: Mapping[str, Matrix], detections: Ids, truth: NDArray[np.bool_] | None
) -> Figure:
    """Draw the matrices of a drive, before and after their filter, the detections, and the truth where there is one.

    Args:
        title: of the whole.
        matrices: by stage.
        detections: (K, 2) query and match.
        truth: (N, N), row = query, column = earlier image.
    """
    count = len(matrices) + 1 + (truth is not None)
    columns = 2 if count == 4 else count
    figure = new_figure(_PANEL * columns, (0.86 * _PANEL + 0.35) * -(-count // columns) + 0.35)
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


def matrix_picture(matrix: Matrix) -> Figure:
    """Draw one matrix alone."""
    figure = new_figure(_PANEL + 0.9, _PANEL)
    figure.set_layout_engine("compressed")  # the panel is square
    draw_matrix(figure.subplots(), matrix, "")
    return figure


def draw_matrix(ax: Axes, matrix: Matrix, title: str) -> None:
    """Draw a matrix of similarities, votes or filter responses: Figures 4.8 and 4.12."""
    _frame(ax, title, len(matrix.values) * matrix.step)
    rows, columns, cells = drawn_cells(matrix)
    if not np.isfinite(cells).any():
        ax.text(0.5, 0.5, "no images were compared", transform=ax.transAxes, ha="center", va="center", color=INK)
        return
    # Filter responses go far below zero where nothing matches: only what is above the middle tells anything.
    low, high = np.nanpercentile(cells, [50.0 if np.nanmin(cells) < 0 else 10.0, 99.8])
    mesh = ax.pcolormesh(
        columns, rows, cells, cmap=_SHADES, vmin=low, vmax=max(high, low + 1e-9), rasterized=True, shading="flat"
    )
    bar = ax.figure.colorbar(mesh, ax=ax, fraction=0.045, pad=0.02, extend="max")
    assert bar.solids is not None
    bar.solids.set_rasterized(True)  # like the matrix, as a dark page turns the colours of images round
    bar.set_label("the paradigm's own scale", color=INK)
    bar.ax.tick_params(colors=INK, labelsize=8)


def draw_detections(ax: Axes, detections: Ids, truth: NDArray[np.bool_] | None, images: int) -> None:
    """Draw the accepted matches: Figure 4.7; right and wrong ones apart where there is a truth."""
    _frame(ax, f"Detections: {len(detections)}", images)
    right = np.ones(len(detections), np.bool_) if truth is None else truth[detections[:, 0], detections[:, 1]]
    label = "accepted" if truth is None else f"true ({int(right.sum())})"
    ax.plot(*_columns_first(detections[right]), "o", color=colours.ACCEPTED, ms=2.4, mew=0, label=label)
    if truth is not None:
        wrong = detections[~right]
        ax.plot(*_columns_first(wrong), "x", color=colours.REJECTED, ms=7, mew=1.6, label=f"false ({len(wrong)})")
    ax.legend(loc="upper right", frameon=False, labelcolor=INK)


def draw_truth(ax: Axes, truth: NDArray[np.bool_]) -> None:
    """Draw which images show the same place: Figure 4.9."""
    _frame(ax, f"Ground truth: {int(truth.any(axis=1).sum())} revisits", len(truth))
    ax.plot(*_columns_first(np.argwhere(truth)), "s", color=colours.CORRECTED, ms=1.4, mew=0, rasterized=True)


def precision_recall_picture(curves: Mapping[str, PrecisionRecall], title: str) -> Figure:
    """Draw precision over recall with a circle at R@P100: Figure 4.16.

    Args:
        curves: by name; none where there is no ground truth.
        title: of the picture.
    """
    figure = new_figure(6.4, 4.8)
    ax = figure.subplots()
    style_axes(ax)
    ax.set(xlim=(-0.01, 1.01), ylim=(0.0, 1.03), xlabel="recall", ylabel="precision")
    ax.set_title(title, color=INK, parse_math=False, fontsize=11, fontweight="bold")
    for (name, curve), (colour, dashes) in zip(curves.items(), _LINES * len(curves), strict=False):
        full = curve.recall_at_full_precision
        ax.plot(curve.recall, curve.precision, color=colour, ls=dashes, lw=1.8, label=f"{name}: R@P100 {full:.3f}")
        ax.plot([full], [1.0 if full else 0.0], "o", color=colour, ms=9, mfc="none", mew=1.8, clip_on=False, zorder=5)
    if curves:
        title = "circle: highest recall without a false one"
        clear = {"edgecolor": "none", "facecolor": "none", "labelcolor": INK}
        legend = ax.legend(loc="lower left", title=title, title_fontsize=8, fontsize=9, **clear)
        legend.get_title().set_color(INK)
        for name_text in legend.get_texts():
            name_text.set_parse_math(False)
    else:
        ax.text(0.5, 0.5, "no ground truth, no curve", transform=ax.transAxes, ha="center", color=INK)
    return figure


def drawn_cells(matrix: Matrix) -> tuple[Ids, Ids, Floats]:
    """Cells (R, C) of a picture and the edges (R + 1,), (C + 1,) between them, images.

    A matrix of sequences has rows and columns for a few images only: each stands for the images up to the next one.
    Thin lines must survive where a cell holds many pairs, so the largest value of them is drawn.
    """
    finite = np.isfinite(matrix.values)
    rows, columns = _begins(finite, axis=1), _begins(finite, axis=0)
    ends = _end(rows, len(finite)), _end(columns, len(finite))
    rows, columns = rows[:: -(-len(rows) // _CELLS)], columns[:: -(-len(columns) // _CELLS)]
    cells = np.fmax.reduceat(np.fmax.reduceat(matrix.values, rows, axis=0), columns, axis=1)
    return np.append(rows, ends[0]) * matrix.step, np.append(columns, ends[1]) * matrix.step, cells


def _begins(finite: NDArray[np.bool_], axis: int) -> Ids:
    """Where each cell begins: at the rows (axis 1) or columns (axis 0) that are there if these are few, else at all."""
    there = np.flatnonzero(np.any(finite, axis=axis))
    if 2 * len(there) > len(finite) or not len(there):
        return np.arange(len(finite))
    return there if there[0] == 0 else np.insert(there, 0, 0)


def _end(begins: Ids, size: int) -> int:
    """Where the last cell ends: after as many images as a cell has at the most."""
    return min(int(begins[-1] + np.diff(begins).max(initial=1)), size)


def _frame(ax: Axes, title: str, images: int) -> None:
    style_axes(ax)
    ax.grid(False)
    ax.set(xlim=(0, images), ylim=(images, 0), xlabel="earlier image", ylabel="query image")
    ax.set_aspect("equal")
    ax.set_title(title, color=INK, parse_math=False, fontsize=11)


def _columns_first(pairs: Ids) -> tuple[Ids, Ids]:
    return pairs[:, 1], pairs[:, 0]
