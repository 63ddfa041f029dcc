"""Figures of place recognition: matrices (the chapter's Figures 4.7, 4.8, 4.9, 4.12) and curves (Figure 4.16)."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from place_recognition.evaluation.precision_recall import PrecisionRecall
from place_recognition.evaluation.similarity_matrix import SimilarityMatrix
from place_recognition.evaluation.stages import CANDIDATE_COUNTS, SURE_PROBABILITY, Reliability, StageResults
from slam.report import style
from slam.report.style import INK, new_figure, style_axes

Floats = NDArray[np.float32]
Ids = NDArray[np.int64]

_PANEL_INCHES = 4.6  # side of a panel
_MAX_CELLS = 600  # drawn along a side of a matrix: about the pixels of a panel
_SHADES = LinearSegmentedColormap.from_list("shades", ["#ffffff", "#9ecae9", style.CORRECTED, style.SCALE_END])
_STAGES = {"similarity": "Similarity or votes", "filtered": "After the filter"}
# Colour and dashes of the curves. The dashes distinguish them in print and for the colour-blind.
_LINES = (
    (style.CORRECTED, "-"),
    (style.ODOMETRY, "--"),
    (style.ACCEPTED, "-."),
    (style.REJECTED, (0, (1, 1))),
    (style.ONLINE, (0, (5, 1, 1, 1, 1, 1))),
    (INK, (0, (6, 3))),
    (style.GROUND_TRUTH, (0, (1, 2))),
)


def plot_places(
    title: str,
    matrices: Mapping[str, SimilarityMatrix],
    detections: Ids,
    truth: NDArray[np.bool_] | None,
    columns_are: str = "earlier image",
) -> Figure:
    """Plot the matrices of a run, before and after their filter, the detections, and the ground truth if known.

    Args:
        title: title of the figure.
        matrices: matrix of each stage.
        detections: (K, 2) query and match of each detection.
        truth: (N, N) True where two images show one place, row = query, column = earlier image; None if unknown.
        columns_are: what the columns are; with a reference recording the matrices and the truth are (N, M).
    """
    count = len(matrices) + 1 + (truth is not None)
    columns = 2 if count == 4 else count
    figure = new_figure(_PANEL_INCHES * columns, (0.86 * _PANEL_INCHES + 0.35) * -(-count // columns) + 0.35)
    figure.set_layout_engine("compressed")  # the panels are square
    panels = list(figure.subplots(-(-count // columns), columns, squeeze=False).flat)
    for panel, (stage, matrix) in zip(panels, matrices.items(), strict=False):
        draw_matrix(panel, matrix, _STAGES.get(stage, stage))
    rows, columns = next(np.array(matrix.values.shape) * matrix.step for matrix in matrices.values())
    shape = (int(rows), int(columns)) if truth is None else truth.shape
    draw_detections(panels[len(matrices)], detections, truth, shape)
    if truth is not None:
        draw_truth(panels[-1], truth)
    for panel in panels:
        panel.set_xlabel(columns_are)
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
    rows, columns = matrix.values.shape
    _format_axes(ax, title, (rows * matrix.step, columns * matrix.step))
    row_edges, column_edges, cells = reduce_to_cells(matrix)
    if not np.isfinite(cells).any():
        ax.text(0.5, 0.5, "no images were compared", transform=ax.transAxes, ha="center", va="center", color=INK)
        return
    # Filter responses go far below zero where nothing matches, so colours start at their median.
    low, high = np.nanpercentile(cells, [50.0 if np.nanmin(cells) < 0 else 10.0, 99.8])
    mesh = ax.pcolormesh(
        column_edges,
        row_edges,
        cells,
        cmap=_SHADES,
        vmin=low,
        vmax=max(high, low + 1e-9),
        rasterized=True,
        shading="flat",
    )
    bar = ax.figure.colorbar(mesh, ax=ax, fraction=0.045, pad=0.02, extend="max")
    assert bar.solids is not None
    bar.solids.set_rasterized(True)  # like the matrix: a dark page inverts the colours of images
    bar.set_label("the paradigm's own scale", color=INK)
    bar.ax.tick_params(colors=INK, labelsize=8)


def draw_detections(ax: Axes, detections: Ids, truth: NDArray[np.bool_] | None, shape: tuple[int, ...]) -> None:
    """Draw the accepted matches: Figure 4.7; true and false ones in different colours if the truth is known."""
    _format_axes(ax, f"Detections: {len(detections)}", shape)
    right = np.ones(len(detections), np.bool_) if truth is None else truth[detections[:, 0], detections[:, 1]]
    label = "accepted" if truth is None else f"true ({int(right.sum())})"
    ax.plot(*_columns_first(detections[right]), "o", color=style.ACCEPTED, ms=2.4, mew=0, label=label)
    if truth is not None:
        wrong = detections[~right]
        ax.plot(*_columns_first(wrong), "x", color=style.REJECTED, ms=7, mew=1.6, label=f"false ({len(wrong)})")
    ax.legend(loc="upper right", frameon=False, labelcolor=INK)


def draw_truth(ax: Axes, truth: NDArray[np.bool_]) -> None:
    """Draw which images show the same place: Figure 4.9."""
    _format_axes(ax, f"Ground truth: {int(truth.any(axis=1).sum())} revisits", truth.shape)
    ax.plot(*_columns_first(np.argwhere(truth)), "s", color=style.CORRECTED, ms=1.4, mew=0, rasterized=True)


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
    ends = _end(rows, finite.shape[0]), _end(columns, finite.shape[1])
    rows, columns = rows[:: -(-len(rows) // _MAX_CELLS)], columns[:: -(-len(columns) // _MAX_CELLS)]
    cells = np.fmax.reduceat(np.fmax.reduceat(matrix.values, rows, axis=0), columns, axis=1)
    return np.append(rows, ends[0]) * matrix.step, np.append(columns, ends[1]) * matrix.step, cells


def _begins(finite: NDArray[np.bool_], axis: int) -> Ids:
    """Return the first row (axis 1) or column (axis 0) of each cell: those with values if at most half, else all."""
    there = np.flatnonzero(np.any(finite, axis=axis))
    size = finite.shape[1 - axis]
    if 2 * len(there) > size or not len(there):
        return np.arange(size)
    return there if there[0] == 0 else np.insert(there, 0, 0)


def _end(begins: Ids, size: int) -> int:
    """Return the end of the last cell, which is as long as the longest of the others."""
    return min(int(begins[-1] + np.diff(begins).max(initial=1)), size)


def _format_axes(ax: Axes, title: str, shape: tuple[int, ...]) -> None:
    rows, columns = shape
    style_axes(ax)
    ax.grid(False)
    ax.set(xlim=(0, columns), ylim=(rows, 0), xlabel="earlier image", ylabel="query image")
    ax.set_aspect("equal")
    ax.set_title(title, color=INK, parse_math=False, fontsize=11)


def _columns_first(pairs: Ids) -> tuple[Ids, Ids]:
    return pairs[:, 1], pairs[:, 0]


CONTROL_NAME = "random images"
_PANEL = (4.9, 4.5)  # inches
_CURVES = {"temporal": "temporal model", "geometry": "geometry", "own": "own score"}
_BAR = 0.36  # width of a bar; two stand at each number of candidates
_MIN_AREA, _MAX_AREA = 30.0, 200.0  # of the points in the reliability diagram, square points of print


def plot_stages(
    stages: StageResults | None, control: StageResults | None, reliability: Reliability | None, title: str
) -> Figure:
    """Plot what each stage reaches, beside the control.

    Args:
        stages: results of the recogniser; None without ground truth.
        control: results of the control; None where it did not run.
        reliability: reliability of the probabilities; None where there are none.
        title: title of the figure.
    """
    figure = new_figure(3 * _PANEL[0], _PANEL[1])
    curves, candidates, probabilities = figure.subplots(1, 3)
    draw_precision_recall(curves, stage_curves(stages, control))
    draw_candidate_recall(candidates, stages, control)
    draw_reliability(probabilities, reliability)
    headings = ("Each stage by itself", "Candidates of the paradigm", "Reliability of the probability")
    for ax, heading in zip((curves, candidates, probabilities), headings, strict=True):
        ax.set_title(heading, color=INK, fontsize=11)
    figure.suptitle(title, color=INK, parse_math=False, fontweight="bold")
    return figure


def stage_figures(stages: StageResults | None, reliability: Reliability | None) -> list[tuple[str, str, str, Figure]]:
    """Plot the candidates and the probabilities of a run, as far as they are known: name, title, caption, figure."""
    figures = []
    if stages is not None and stages.candidate_recall:
        figure = new_figure(*_PANEL)
        draw_candidate_recall(figure.subplots(), stages, None)
        caption = "How often a true image is among the first candidates, before geometry and temporal model."
        figures.append(("candidates", "Candidates", caption, figure))
    if reliability is not None:
        figure = new_figure(*_PANEL)
        draw_reliability(figure.subplots(), reliability)
        caption = "On the dashed line a match given 0.9 is true nine times in ten."
        figures.append(("reliability", "Reliability", caption, figure))
    return figures


def stage_curves(stages: StageResults | None, control: StageResults | None) -> dict[str, PrecisionRecall]:
    """Return the curve of each stage by its name for people, the last stage first, then the control's last one."""
    if stages is None:
        return {}
    curves = {name: stages.curves[stage] for stage, name in _CURVES.items() if stage in stages.curves}
    return curves if control is None else curves | {CONTROL_NAME: control.curves["temporal"]}


def draw_candidate_recall(ax: Axes, stages: StageResults | None, control: StageResults | None) -> None:
    """Draw how often a true image is among the first candidates, beside the control."""
    _format(ax, "candidates of a query", "recall: share with a true image among them")
    ax.set(xticks=range(len(CANDIDATE_COUNTS)), xticklabels=CANDIDATE_COUNTS, ylim=(0.0, 1.2), yticks=np.arange(6) / 5)
    ax.grid(False, axis="x")
    if stages is None or not stages.candidate_recall:
        _write(ax, "no ground truth" if stages is None else "no candidates are reported")
        return
    _draw_bars(ax, stages.candidate_recall, -_BAR / 2, style.CORRECTED, "the paradigm", "")
    if control is not None and control.candidate_recall:
        _draw_bars(ax, control.candidate_recall, _BAR / 2, style.REJECTED, CONTROL_NAME, "///")
    clear = {"edgecolor": "none", "facecolor": "none", "labelcolor": INK}
    ax.legend(loc="upper center", ncols=2, fontsize=9, **clear)


def draw_reliability(ax: Axes, reliability: Reliability | None) -> None:
    """Draw the share of true matches over their probability: on the diagonal probabilities mean what they say."""
    _format(ax, "mean probability of the matches", "share of them that is true")
    ax.set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.3), yticks=np.arange(6) / 5)
    if reliability is None:
        _write(ax, "no probabilities, or no ground truth")
        return
    ax.plot([0, 1], [0, 1], "--", color=style.GROUND_TRUTH, lw=1.2)
    filled = reliability.counts > 0
    counts = reliability.counts[filled]
    areas = _MIN_AREA + (_MAX_AREA - _MIN_AREA) * np.log(counts) / max(float(np.log(counts.max())), 1.0)
    means, shares = reliability.mean_probabilities[filled], reliability.true_shares[filled]
    ax.plot(means, shares, "-", color=style.CORRECTED, lw=1.0, alpha=0.6)
    ax.scatter(means, shares, s=areas, color=style.CORRECTED, alpha=0.8, linewidths=0, zorder=3)
    text = (
        f"calibration error {reliability.expected_calibration_error:.3f}\n"
        f"false from {SURE_PROBABILITY} on: {reliability.sure_false} of {reliability.sure}\n"
        f"a larger point: more of the {counts.sum()} matches"
    )
    ax.text(0.02, 0.98, text, transform=ax.transAxes, ha="left", va="top", color=INK, fontsize=9)


def _draw_bars(ax: Axes, recall: Mapping[int, float], shift: float, colour: str, label: str, hatch: str) -> None:
    heights = [recall[count] for count in CANDIDATE_COUNTS]
    face = "none" if hatch else colour
    bars = ax.bar(
        np.arange(len(heights)) + shift, heights, _BAR, label=label, facecolor=face, edgecolor=colour, hatch=hatch
    )
    ax.bar_label(bars, [f"{height:.2f}" for height in heights], padding=2, fontsize=9, color=INK)


def _format(ax: Axes, xlabel: str, ylabel: str) -> None:
    style_axes(ax)
    ax.set_axisbelow(True)
    ax.set(xlabel=xlabel, ylabel=ylabel)


def _write(ax: Axes, text: str) -> None:
    ax.text(0.5, 0.5, text, transform=ax.transAxes, ha="center", color=INK)
